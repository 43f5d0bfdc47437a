"""The pages that commands serve."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from types import MethodType
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab import cli
from mjlab.cli.shared import _watching
from mjlab_command import running
from mjlab_sim import NanGuard, NanGuardCfg, Simulation, SimulationCfg
from mjlab_viewer import BrowserViewer
from playwright.sync_api import Browser, Locator, Page
from viewer_page import eventually, is_red, opened, pixels, slide, stepping

DECIMATION = 2


@contextmanager
def page_of(chromium: Browser, folder: Path, command: str, *arguments: str) -> Generator[Page]:
  """Open the page that a command serves, and interrupt the command at the end, which must not have complained."""
  code = f"import sys; from mjlab.cli import {command} as run; sys.exit(run(sys.argv[1:]))"
  with running(code, *arguments, folder=folder, OMP_NUM_THREADS="1", PYTHONWARNINGS="error") as process:
    page = opened(chromium, process.wait_for(r"open (http://\S+) ")[1])
    yield page
    page.close()
    assert process.interrupt().strip() == ""


def seen(page: Page) -> np.ndarray:
  """Return the page left of the controls and below the notice, int (height, width, 3)."""
  return pixels(page)[140:460]


def red(page: Page) -> int:
  return is_red(seen(page)).sum()


def row(page: Page, label: str) -> Locator:
  return page.locator(
    f'xpath=//label[starts-with(., "{label}")]/ancestor::div[contains(@class,"mantine-Flex-root")][1]'
  )


def dump(folder: Path) -> Path:
  """Write a dump of two red boxes, the second of which gets an infinite velocity."""
  spec = mujoco.MjSpec.from_string("""
    <mujoco>
      <statistic extent="2"/>
      <worldbody>
        <light pos="0 0 4" dir="0 0 -1"/>
        <geom name="floor" type="plane" size="5 5 .1" rgba=".5 .5 .5 1"/>
        <body name="box" pos="0 0 .5"><freejoint name="float"/>
          <geom type="box" size=".2 .2 .2" rgba=".9 .1 .1 1"/></body>
      </worldbody>
    </mujoco>""")
  sim = Simulation(2, spec, SimulationCfg(timestep=0.01, num_threads=1), "cpu")
  guard = NanGuard(sim, DECIMATION, NanGuardCfg(output_dir=str(folder)))
  for step in range(2):
    for substep in range(DECIMATION):
      if (step, substep) == (1, 1):
        sim.data.qvel[1, 0] = torch.inf
      guard.record(substep)
      sim.step()
    guard.keep(~torch.isfinite(sim.data.qpos).all(dim=1))
  guard.report()
  sim.close()
  (path,) = folder.iterdir()
  return path


@pytest.mark.slow
def test_viz_nan_shows_the_robot_and_steps_through_what_was_stored(chromium: Browser, tmp_path: Path) -> None:
  path = dump(tmp_path / "nan_dumps")
  with page_of(chromium, tmp_path, "viz_nan", str(path), "--viewer", "browser", "--port", "8710") as page:
    eventually(lambda: red(page) > 300, "the robot is not seen")
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play", exact=True).wait_for()
    page.get_by_role("button", name="Reset").click()
    for when in (
      "world 1 of the run, before physics step 1 of 2 of environment step 1",
      "world 1 of the run, before physics step 2 of 2 of environment step 1",
      "world 1 of the run, before physics step 1 of 2 of environment step 2",
      "world 1 of the run, before physics step 2 of 2 of environment step 2: qvel not finite or beyond 1e10",
      "world 1 of the run, after physics step 2 of 2 of environment step 2: qpos, qvel",
      "world 1 of the run, before physics step 1 of 2 of environment step 1",
    ):
      page.get_by_text(when).wait_for()
      page.get_by_role("button", name="Step").click()
    assert red(page) > 300
    slide(page, "Time [s]", 0.02)
    page.get_by_text("before physics step 1 of 2 of environment step 2").wait_for()
    page.get_by_role("button", name="Step").click()
    page.get_by_text("before physics step 2 of 2 of environment step 2").wait_for()
    assert row(page, "Speed").locator("input").first.input_value() == "1/10"
    # Recorded worlds cannot be pushed.
    assert page.get_by_text("Push").count() == 0
    page.get_by_role("tab", name="Plots").click()
    page.get_by_text("qpos[2]").wait_for()


@pytest.mark.slow
def test_the_demo_shows_a_robot_that_walks_on_command(chromium: Browser, tmp_path: Path) -> None:
  words = "demo --task go1 --port 8720 --num-envs 1 --device cpu".split()
  with page_of(chromium, tmp_path, *words) as page:
    # The floor is light.
    eventually(lambda: (seen(page).max(axis=2) < 130).sum() > 1000, "the robot is not seen")
    page.get_by_label("Manual").check()
    forward = row(page, "forward").locator("input[inputmode]")
    forward.fill("0.8")
    forward.press("Enter")
    before = seen(page)
    # The camera follows it over the lines of the floor.
    eventually(lambda: (np.abs(seen(page) - before).max(axis=2) > 40).sum() > 1000, "nothing moves")
    page.get_by_role("tab", name="Plots").click()
    page.get_by_text("track_linear_velocity").first.wait_for()
  assert list(tmp_path.iterdir()) == []


def test_the_demo_lifts_to_where_the_sliders_of_its_page_say(
  chromium: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
  goal = torch.tensor([0.4, 0.1, 0.3], dtype=torch.float64)
  other: list[torch.Tensor] = []

  def look(run: MethodType) -> int:
    viewer = run.__self__
    assert isinstance(viewer, BrowserViewer)
    assert viewer.playback is not None
    command: Any = viewer.playback.env.steering()["lift_height"]
    with stepping(viewer):
      page = opened(chromium, viewer.url)
      slide(page, "World", 1)
      page.get_by_label("Manual").check()
      for axis, place in zip("xyz", goal.tolist(), strict=True):
        slide(page, f"goal {axis} [m]", place)
      eventually(lambda: torch.equal(command.command[1], goal), "the manual goal is not set")
      # A cube that slipped away is tried again with the next goal.
      eventually(lambda: command.distance[1] < 0.05, "the cube is not lifted there")
      other.append(command.command[0].clone())
      page.close()
    assert viewer.playback.error is None
    return 0

  monkeypatch.setattr(_watching, "until_interrupted", look)
  assert cli.main("demo --task lift --port 8725 --num-envs 2 --device cpu --seed 1".split()) == 0
  assert not torch.equal(other[0], goal)
