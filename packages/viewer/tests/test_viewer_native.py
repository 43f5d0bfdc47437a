"""MuJoCo's window on a virtual screen."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# One window for all: windows open slowly, and a process can open only one.
SCRIPT = """
import os
import time
from types import SimpleNamespace
import mujoco
import numpy as np
import torch
from mjlab_core import Contacts
from mjlab_viewer import NativeViewer, Playback, ZeroPolicy
from mjlab_viewer.native.viewer import FRAME
from PIL import ImageGrab
from viewer_env import BoxEnv

env = BoxEnv(3)
env.draws_at_first = True
known = Contacts(
  found=torch.tensor([True, True, True, False]), geom=torch.tensor([[0, 1]] * 4), pos=torch.rand(4, 3),
  dist=torch.zeros(4), normal=torch.eye(3)[[0, 1, 2, 0]], force=torch.ones(4, 3),
)
env.sim.known_contacts = dict.fromkeys(range(3), known)
# World 1 has a small blue box with another ornament.
model, box = env.sim.mj_model, env.sim.mj_model.geom("box").id
env.sim.expand("geom_rgba")[1, box] = torch.tensor([0.1, 0.1, 0.9, 1.0])
env.sim.expand("geom_size")[1, box] *= 0.5
env.sim.expand("geom_dataid")[1, model.geom("ornament").id] = model.mesh("spike").id
# Time passes frame by frame, at any speed of the machine.
clock = SimpleNamespace(now=100.0)
playback = Playback(env, ZeroPolicy(3, 1, env.sim.device), clock=lambda: clock.now)
before = np.zeros(mujoco.mj_sizeModel(env.sim.mj_model), dtype=np.uint8)
mujoco.mj_saveModel(env.sim.mj_model, None, before)

def screen():
  return np.asarray(ImageGrab.grab(xdisplay=os.environ["DISPLAY"])).astype(int)

def seen(channel):
  others = [other for other in range(3) if other != channel]
  image = screen()
  return (image[..., channel] > 2 * image[..., others].max(axis=2) + 40).sum()

def frames(count=1):
  for _ in range(count):
    clock.now += FRAME + 1e-6
    playback.tick()
    viewer.update()

def press(key):
  viewer._press(key)
  frames()

def eventually(holds):
  "Wait for pictures of the thread that draws."
  end = time.monotonic() + 300
  while not holds():
    assert time.monotonic() < end, "it did not happen"
    frames()
    time.sleep(0.01)

with NativeViewer(playback) as viewer:
  eventually(lambda: viewer.window.viewport is not None)
  frames(40)
  assert playback.step_count > 20
  np.testing.assert_allclose(viewer.window.cam.lookat, env.sim.datas[0].xpos[1], atol=1e-6)
  assert viewer.window.user_scn.ngeom == 1
  press(ord(" "))
  assert playback.paused
  count = playback.step_count
  press(262)
  assert playback.step_count == count + 1
  eventually(lambda: seen(0) > 200 and seen(1) > 20 and seen(2) < 20)
  red, green = seen(0), seen(1)
  press(ord("."))
  assert viewer.selected == 1
  eventually(lambda: seen(0) < 20 and 20 < seen(2) < 0.5 * red and seen(1) != green)
  press(ord(","))
  press(ord(","))
  assert viewer.selected == 2
  press(ord("="))
  assert playback.speed == 2.0
  press(ord("R"))
  assert viewer.window.user_scn.ngeom == 0
  press(ord("R"))

  # Contacts of the simulation, and none from the window's data.
  shown = lambda: viewer.window.user_scn.ngeom
  playback.resume()
  frames(120)
  playback.pause()
  assert shown() == 1 and env.sim.datas[2].ncon == 4
  flags = [int(mujoco.mjtVisFlag.mjVIS_CONTACTPOINT), int(mujoco.mjtVisFlag.mjVIS_CONTACTFORCE)]
  for flag, count in zip(flags, (4, 7)):
    with viewer.window.lock():
      viewer.window.opt.flags[flag] = 1
    frames()
    assert shown() == count
  assert viewer._world.data.ncon == 0
  # Only these flags: without lights the whole picture would change later.
  viewer.window.opt.flags[flags] = 0
  frames()
  assert shown() == 1

  # Plots are in the right third of the window.
  eventually(lambda: seen(0) > 200 and seen(2) < 20)
  height, width = viewer.window.viewport.height, viewer.window.viewport.width
  third = lambda: screen()[10:height - 10, 2 * width // 3 + 5:width - 5]
  bare = third()
  changed = lambda: (np.abs(third() - bare).max(axis=2) > 20).mean()
  press(ord("P"))
  assert viewer._plots.page.title == "rewards"
  eventually(lambda: changed() > 0.02)
  for _ in range(3):
    press(ord("P"))
  assert viewer._plots.page is None
  eventually(lambda: changed() < 0.005)

  # Shapes without room in the window are left out evenly and counted.
  assert viewer._own_geoms < 2000 and viewer.window.user_scn.maxgeom == 100_000
  # So many shapes would take a CPU half a minute to draw.
  viewer._own_geoms = viewer.window.user_scn.maxgeom - 50
  places, draw = torch.rand(120, 3), env.command.debug_draw
  env.command.debug_draw = lambda draw: draw.spheres(places, 0.01, (1, 0, 0, 1))
  frames()
  assert shown() == 50 and viewer.num_undrawn == 70
  assert "without" in viewer._status()[1]
  env.command.debug_draw = draw
  frames()
  assert shown() == 1 and viewer.num_undrawn == 0

  # The error of a drawing pauses and is shown in the window; reset continues.
  env.command.debug_draw = lambda draw: 1 / 0
  frames()
  assert playback.error == "viewer: ZeroDivisionError: division by zero"
  assert playback.paused and "division by zero" in viewer._status()[1]
  env.command.debug_draw = draw
  press(257)
  frames(10)
  assert playback.error is None and playback.step_count > 5

  # A diverged world stays as it was; the camera follows it again after a reset.
  box = env.sim.datas[2].qpos
  playback.pause()
  box[:] = env.sim.datas[2].xpos[:] = np.nan
  frames()
  assert "not finite" in viewer._status()[1]
  assert np.isfinite(viewer._world.data.xpos).all()
  press(257)
  press(ord(" "))
  frames(10)
  assert "not finite" not in viewer._status()[1] and playback.step_count > 5
  np.testing.assert_allclose(viewer.window.cam.lookat, env.sim.datas[2].xpos[1], atol=1e-6)

  # Dragging pulls the box of the shown world alone, until it is released.
  perturb = viewer.window.perturb
  perturb.select = 1
  perturb.localmass = 1.0
  perturb.active = int(mujoco.mjtPertBit.mjPERT_TRANSLATE)
  perturb.refselpos[:] = viewer._world.data.xpos[1] + [0, 0, 1]
  viewer._drag()
  pulled = env.sim.data.xfrc_applied[:, 1, 2].tolist()
  assert pulled[2] > 0.1 and pulled[:2] == [0.0, 0.0], pulled
  perturb.active = 0
  viewer._drag()
  assert not env.sim.data.xfrc_applied.any()

# A thread that still draws would hang the process at its end.
assert not any(thread.is_alive() for thread in viewer._window_threads) and viewer._window_threads

after = np.zeros_like(before)
mujoco.mj_saveModel(env.sim.mj_model, None, after)
assert (before == after).all()
print("everything held")
"""


@pytest.fixture
def screen() -> Iterator[str]:
  if shutil.which("Xvfb") is None:
    pytest.skip("needs Xvfb (on Debian: apt install xvfb)")
  # Xvfb chooses a free display and writes its number once it is ready.
  reader, writer = os.pipe()
  command = ["Xvfb", "-displayfd", str(writer), "-screen", "0", "800x600x24"]
  server = subprocess.Popen(command, pass_fds=(writer,), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
  os.close(writer)
  with open(reader) as pipe:
    number = pipe.readline().strip()
  assert number, "Xvfb does not start"
  yield f":{number}"
  server.terminate()
  server.wait()


def run(script: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
  return subprocess.run(
    [sys.executable, "-c", script],
    env=environment | {"PYTHONPATH": str(Path(__file__).parent)},
    capture_output=True,
    text=True,
    check=False,
  )


def test_keys_drawings_and_dragging_work_in_the_window(screen: str) -> None:
  done = run(SCRIPT, {**os.environ, "DISPLAY": screen, "MUJOCO_GL": "glfw", "LIBGL_ALWAYS_SOFTWARE": "1"})
  assert "everything held" in done.stdout, done.stdout + done.stderr


def test_without_a_screen_the_message_is_one_line_and_names_the_way_out() -> None:
  script = (
    "from mjlab_viewer import NativeViewer, Playback, ZeroPolicy\n"
    "from viewer_env import BoxEnv\n"
    "env = BoxEnv(1)\n"
    "try: NativeViewer(Playback(env, ZeroPolicy(1, 1, env.sim.device)))\n"
    "except ValueError as error: print(error)"
  )
  environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
  done = run(script, environment)
  assert done.stdout.count("\n") == 1, done.stdout + done.stderr
  assert done.stdout.startswith("no window can be opened here (X11: The DISPLAY environment variable is missing); ")
  assert "--viewer browser needs none" in done.stdout
