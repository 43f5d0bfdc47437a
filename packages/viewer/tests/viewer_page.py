"""The page of the browser viewer in a real browser, for tests."""

import shutil
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress

import pytest
from mjlab_viewer import BrowserViewer
from playwright.sync_api import Browser, Locator, Page, ViewportSize, sync_playwright

# Chromium without a GPU, a sandbox or a network.
FLAGS = """--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-quic --no-first-run
--disable-background-networking --disable-component-update --disable-sync""".split()
SIZE = ViewportSize(width=760, height=560)
PATIENCE = 300.0
"""Limit for anything on a page [s]: far beyond what the busiest machine takes, and below the time limit of a test."""


@contextmanager
def headless_chromium() -> Generator[Browser]:
  """The machine's own Chromium; skips the test where there is none."""
  executable = shutil.which("chromium") or shutil.which("chromium-browser")
  if executable is None:
    pytest.skip("needs Chromium (on Debian: apt install chromium)")
  with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=executable, args=FLAGS)
    yield browser
    browser.close()


@contextmanager
def closing_pages(browser: Browser) -> Generator[Browser]:
  """Close the pages that a test opened: one that stays connects to the next server on its port."""
  try:
    yield browser
  finally:
    for context in browser.contexts:
      context.close()


def eventually(holds: Callable[[], object], what: str = "", seconds: float = PATIENCE) -> None:
  """Waits until something holds; the browser is slow where it has no GPU."""
  end = time.monotonic() + seconds
  while not holds():
    assert time.monotonic() < end, what or "it did not happen"
    # A screenshot costs a busy machine as much as a frame.
    time.sleep(0.2)


@contextmanager
def stepping(viewer: BrowserViewer) -> Generator[None]:
  """Runs a viewer's loop in a thread of its own, as it does in a process of its own; closes the viewer at the end."""
  is_over = threading.Event()
  # Whatever it does, it does not keep the tests from ending.
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
  """Open an empty page without slow transitions; without a limit of its own, Playwright gives up after 30 s."""
  page = browser.new_page(viewport=SIZE, reduced_motion="reduce")
  page.add_init_script(STILL)
  page.set_default_timeout(1000 * PATIENCE)
  return page


def opened(browser: Browser, url: str) -> Page:
  page = patient_page(browser)
  page.goto(url)
  page.get_by_role("button", name="Reset").wait_for()
  return page


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
