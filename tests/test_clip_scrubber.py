"""The scrubber of a clip on the page of the browser viewer."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

import mjlab
import mujoco
import numpy as np
import pytest
import torch
from mjlab.cli.shared._clip_preview import clip_replay, preview_model
from mjlab_envs import ManagerBasedRlEnv
from mjlab_motions import Motion, load_motion, resample, shipped_clips
from mjlab_tracking.mdp import MotionCommand, MotionCommandCfg
from mjlab_viewer import BrowserViewer, Playback, ViewedEnv, ZeroPolicy
from playwright.sync_api import Browser, Page
from viewer_page import eventually, is_red, opened, pixels, slide, stepping

CLIP = "side_step_dance"
# A mast whose red flag hangs down at 0 and stands level at pi/2.
FLAG = """
<mujoco>
  <statistic extent="2" center="0 0 1"/>
  <worldbody>
    <body name="mast" pos="0 0 1">
      <freejoint/>
      <geom type="sphere" size="0.1"/>
      <body name="flag">
        <joint name="flag" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0  0 0 -0.8" size="0.08" rgba="0.9 0.1 0.1 1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@contextmanager
def shown(env: ViewedEnv, num_actions: int, browser: Browser) -> Generator[tuple[BrowserViewer, Playback, Page]]:
  """Run a viewer in a separate thread, and open its page."""
  playback = Playback(env, ZeroPolicy(env.num_envs, num_actions, env.sim.device))
  viewer = BrowserViewer(env, playback=playback, port=8400)
  with stepping(viewer):
    page = opened(browser, viewer.url)
    yield viewer, playback, page
    page.close()


def pause(page: Page, playback: Playback) -> None:
  page.get_by_role("button", name="Pause").click()
  page.get_by_role("button", name="Play", exact=True).wait_for()
  eventually(lambda: playback.paused)


def red(page: Page) -> np.ndarray:
  """Return the red pixels above the axes in the corner, bool (height, width)."""
  return is_red(pixels(page)[:460])


def tracking() -> tuple[ManagerBasedRlEnv, MotionCommand]:
  cfg = mjlab.load_task("Mjlab-Tracking-Flat-Unitree-G1").env
  cfg.scene.num_envs, cfg.seed, cfg.events = 2, 0, {}
  cfg.terminations = dict.fromkeys(cfg.terminations)
  motion = cast(MotionCommandCfg, cfg.commands["motion"])
  motion.motion, motion.sampling = CLIP, "start"
  env = ManagerBasedRlEnv(cfg, device="cpu")
  return env, cast(MotionCommand, env.command_manager.get_term("motion"))


def ghost_centres(env: ManagerBasedRlEnv, motion: Motion, frame: int) -> np.ndarray:
  """Return the centres of the robot's visible shapes without meshes in MuJoCo C, (n, 3) [m]."""
  model = env.sim.mj_model
  data = mujoco.MjData(model)
  data.qpos[:] = torch.cat((motion.root_pos[frame], motion.root_quat[frame], motion.joint_pos[frame]))
  data.qpos[:3] += env.scene.env_origins[0].numpy()
  mujoco.mj_kinematics(model, data)
  seen = (model.geom_group == 2) & (model.geom_type != mujoco.mjtGeom.mjGEOM_MESH)
  return data.geom_xpos[seen]


def test_ghost_and_reference_go_to_the_frame_that_the_scrubber_is_moved_to(
  chromium: Browser, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
  # A robot of primitives, also where meshes are installed: their places are sent to the page.
  monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
  env, term = tracking()
  motion = resample(load_motion(shipped_clips()[CLIP]), 50.0)
  with env, shown(env, 29, chromium) as (viewer, playback, page):
    page.get_by_label("Manual").check()
    # First while the worlds run, then while they are paused.
    for time, frame, is_next in ((12.4, 620, True), (3.0, 150, False)):
      slide(page, "time [s]", time)
      eventually(lambda frame=frame: term.frame[0] == frame, f"not at frame {frame}")
      reference = torch.cat((term.joint_pos[0], term.command[0, :29]))
      torch.testing.assert_close(reference, motion.joint_pos[frame].repeat(2).to(reference.dtype), atol=1e-5, rtol=0)
      wanted = ghost_centres(env, motion, frame)

      def is_drawn(wanted: np.ndarray = wanted) -> bool:
        shapes = [shape for shape in viewer.history[-1].drawings[0].shapes if shape.kind != "mesh"]
        middles = [s.position[0] + (0.5 * s.direction[0] if s.kind == "line" else 0.0) for s in shapes]
        return len(middles) == len(wanted) and np.allclose(middles, wanted, atol=1e-4)

      eventually(is_drawn, "the ghost is elsewhere")
      if is_next:
        pause(page, playback)
    # The other world has no manual command.
    assert term.frame[1] != 150
    page.get_by_label("Manual").uncheck()
    page.get_by_role("button", name="Play", exact=True).click()
    eventually(lambda: term.frame[0] > 150, "the clip does not go on")
    assert playback.error is None


def test_the_preview_of_a_clip_shows_the_time_that_the_scrubber_is_moved_to(chromium: Browser) -> None:
  robot = mujoco.MjSpec.from_string(FLAG)
  lift = torch.linspace(0.0, 2.0, 201, dtype=torch.float64)
  motion = Motion(
    name="lift",
    rate=50.0,
    root_body="mast",
    joint_names=("flag",),
    root_pos=torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).repeat(201, 1),
    root_quat=torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64).repeat(201, 1),
    joint_pos=lift[:, None],
  )
  with shown(clip_replay(preview_model(robot), motion), 0, chromium) as (viewer, playback, page):
    eventually(lambda: red(page).sum() > 1000, "the flag is not seen")
    pause(page, playback)
    for time, frame in ((0.4, 20), (3.2, 160)):
      slide(page, "Time [s]", time)
      eventually(lambda frame=frame: viewer.history[-1].data["qpos"][0, 7] == lift[frame].item())
      page.get_by_text(f"clip lift, frame {frame + 1} of 201, {time:.2f} s").wait_for()
      # The camera looks at the mast, in row 280: hanging, the flag is below it, standing level it is not.
      eventually(lambda is_level=frame > 100: is_seen(red(page), is_level), "it is seen elsewhere")


def is_seen(where: np.ndarray, is_level: bool) -> bool:
  rows, _ = np.nonzero(where)
  return len(rows) > 1000 and (rows.mean() < 300) == is_level
