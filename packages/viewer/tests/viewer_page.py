"""The page of the browser viewer, with and without a real browser, for tests."""

import io
import shutil
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest
from mjlab_viewer import BrowserViewer, Playback, Snapshot, ZeroPolicy
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, ViewportSize, sync_playwright
from viewer_env import BoxEnv

# Chromium without a GPU, a sandbox or a network.
FLAGS = """--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-quic --no-first-run
--disable-background-networking --disable-component-update --disable-sync""".split()
SIZE = ViewportSize(width=760, height=560)
PATIENCE = 300.0
"""Limit for anything on a page [s]: far beyond what the busiest machine takes, and below the time limit of a test."""


@contextmanager
def headless_chromium() -> Generator[Browser]:
  """Start the installed Chromium, or skip the test without one."""
  executable = shutil.which("chromium") or shutil.which("chromium-browser")
  if executable is None:
    pytest.skip("needs Chromium (on Debian: apt install chromium)")
  with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=executable, args=FLAGS)
    yield browser
    browser.close()


@contextmanager
def closing_pages(browser: Browser) -> Generator[Browser]:
  """Close the pages of a test: an open page connects to the next server on its port."""
  try:
    yield browser
  finally:
    for context in browser.contexts:
      context.close()


def eventually(holds: Callable[[], object], what: str = "", seconds: float = PATIENCE) -> None:
  """Wait until something holds; a browser without a GPU is slow."""
  end = time.monotonic() + seconds
  while not holds():
    assert time.monotonic() < end, what or "it did not happen"
    # A screenshot costs a busy machine as much as a frame.
    time.sleep(0.2)


@contextmanager
def stepping(viewer: BrowserViewer) -> Generator[None]:
  """Run the loop of a viewer in a separate thread, and close the viewer at the end."""
  is_over = threading.Event()
  # A daemon does not keep the tests from ending.
  thread = threading.Thread(target=viewer.run, args=(is_over.is_set,), daemon=True)
  thread.start()
  try:
    yield
  except BaseException:
    playback = viewer.playback
    print(f"loop runs: {thread.is_alive()}, clients: {len(viewer.server.get_clients())}, error: {viewer.error}")
    if playback is not None:
      print(f"paused: {playback.paused}, steps: {playback.step_count}, error: {playback.error}")
    raise
  finally:
    is_over.set()
    thread.join(PATIENCE)
    viewer.close()
    assert not thread.is_alive(), "the viewer's loop does not end"


# A click is lost if its target moves between press and release. Transitions still end with their event.
STILL = """addEventListener("DOMContentLoaded", () => {
  const style = document.createElement("style");
  style.textContent = "*, ::before, ::after { transition-duration: 1ms !important; transition-delay: 0s !important }";
  document.head.append(style);
})"""


def patient_page(browser: Browser) -> Page:
  """Open an empty page without slow transitions; the default limit of Playwright is 30 s."""
  page = browser.new_page(viewport=SIZE, reduced_motion="reduce")
  page.add_init_script(STILL)
  page.set_default_timeout(1000 * PATIENCE)
  return page


def opened(browser: Browser, url: str) -> Page:
  page = patient_page(browser)
  page.goto(url)
  page.get_by_role("button", name="Reset").wait_for()
  return page


def pixels(page: Page) -> np.ndarray:
  """Return the page left of its controls, int (height, width, 3)."""
  return np.asarray(Image.open(io.BytesIO(page.screenshot()))).astype(int)[:, :340, :3]


def is_red(image: np.ndarray) -> np.ndarray:
  return (image[..., 0] > 90) & (image[..., 0] > 2 * image[..., 1:].max(axis=2))


def press_until(button: Locator, holds: Callable[[], object]) -> None:
  """Press a button until something holds; a press while the connection is down is lost."""
  for _ in range(10):
    button.click()
    with suppress(AssertionError):
      return eventually(holds, seconds=PATIENCE / 10)
  raise AssertionError("the button does nothing")


def row(page: Page, label: str) -> Locator:
  return page.locator(f'xpath=//label[text()="{label}"]/ancestor::div[contains(@class,"mantine-Flex-root")][1]')


def slide(page: Page, label: str, value: float) -> None:
  field = row(page, label).locator("input[inputmode]")
  field.fill(f"{value:g}")
  field.press("Enter")


def choose(page: Page, label: str, option: str) -> None:
  row(page, label).locator("input").first.click()
  page.get_by_role("option", name=option, exact=True).click()


class Served:
  """A viewer of boxes without a browser, whose loop the test runs."""

  def __init__(self, env: BoxEnv, viewer: BrowserViewer) -> None:
    assert viewer.playback is not None
    assert viewer._controls is not None
    self.env, self.viewer, self.playback, self.controls = env, viewer, viewer.playback, viewer._controls
    self.inputs: dict[str, Any] = inputs_of(viewer)

  def show(self) -> None:
    """Show a frame, due or not."""
    self.viewer._due["frame"] = 0.0
    self.viewer.update()

  def status(self) -> str:
    self.controls.show_status()
    return self.controls._status.content

  @property
  def shown(self) -> Snapshot:
    assert self.viewer.scene.shown is not None
    return self.viewer.scene.shown


def inputs_of(viewer: BrowserViewer) -> dict[str, Any]:
  """Return the inputs of the page by label."""
  return {handle.label: handle for handle in viewer.server.gui._gui_input_handle_from_uuid.values()}


@contextmanager
def served(
  env: BoxEnv, policy: Any = None, clock: Callable[[], float] = time.monotonic, **options: Any
) -> Generator[Served]:
  """Serve a page of boxes, by default with actions of zero."""
  playback = Playback(env, policy or ZeroPolicy(env.num_envs, 1, env.sim.device), clock=clock)
  with BrowserViewer(env, playback=playback, port=8300, **options) as viewer:
    yield Served(env, viewer)
