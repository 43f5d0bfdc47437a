"""MuJoCo's window on a virtual screen."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

# Everything in one window: they take long to open, and a process has room for one.
SCRIPT = """
import os
import time
from types import SimpleNamespace
import mujoco
import numpy as np
import torch
from mjlab_viewer import NativeViewer, Playback, ZeroPolicy
from PIL import ImageGrab
from viewer_env import BoxEnv

env = BoxEnv(3)
env.draws_at_first = True
told = SimpleNamespace(
  found=torch.tensor([True, True, True, False]), geom=torch.tensor([[0, 1]] * 4), pos=torch.rand(4, 3),
  normal=torch.eye(3)[[0, 1, 2, 0]], force=torch.ones(4, 3),
)
env.sim.told = dict.fromkeys(range(3), told)
# World 1 has a small blue box with another ornament.
model, box = env.sim.mj_model, env.sim.mj_model.geom("box").id
env.sim.expand("geom_rgba")[1, box] = torch.tensor([0.1, 0.1, 0.9, 1.0])
env.sim.expand("geom_size")[1, box] *= 0.5
env.sim.expand("geom_dataid")[1, model.geom("ornament").id] = model.mesh("spike").id
playback = Playback(env, ZeroPolicy(3, 1, env.sim.device))
before = np.zeros(mujoco.mj_sizeModel(env.sim.mj_model), dtype=np.uint8)
mujoco.mj_saveModel(env.sim.mj_model, None, before)

def screen():
  return np.asarray(ImageGrab.grab(xdisplay=os.environ["DISPLAY"])).astype(int)

def seen(channel):
  others = [other for other in range(3) if other != channel]
  image = screen()
  return (image[..., channel] > 2 * image[..., others].max(axis=2) + 40).sum()

def eventually(holds):
  end = time.monotonic() + 20
  viewer.run(lambda: holds() or time.monotonic() > end)
  assert holds()

with NativeViewer(playback) as viewer:
  eventually(lambda: playback.step_count > 20)
  np.testing.assert_allclose(viewer.window.cam.lookat, env.sim.datas[0].xpos[1], atol=0.2)
  assert viewer.window.user_scn.ngeom == 1
  viewer._press(ord(" "))
  eventually(lambda: playback.paused)
  count = playback.step_count
  viewer._press(262)
  eventually(lambda: playback.step_count == count + 1)
  viewer._press(ord("."))
  red, green = seen(0), seen(1)
  assert seen(2) < 20
  eventually(lambda: viewer.selected == 1)
  eventually(lambda: seen(0) < 20 and 20 < seen(2) < 0.5 * red and seen(1) != green)
  viewer._press(ord(","))
  viewer._press(ord(","))
  eventually(lambda: viewer.selected == 2)
  viewer._press(ord("="))
  eventually(lambda: playback.speed == 2.0)
  viewer._press(ord("R"))
  eventually(lambda: viewer.window.user_scn.ngeom == 0)
  viewer._press(ord("R"))

  # Contacts that the simulation tells of, and none that the window's own data would have.
  shown = lambda: viewer.window.user_scn.ngeom
  eventually(lambda: shown() == 1 and env.sim.datas[2].ncon == 4)
  flags = [int(mujoco.mjtVisFlag.mjVIS_CONTACTPOINT), int(mujoco.mjtVisFlag.mjVIS_CONTACTFORCE)]
  for flag, count in zip(flags, (4, 7)):
    with viewer.window.lock():
      viewer.window.opt.flags[flag] = 1
    eventually(lambda: shown() == count)
  assert viewer._world.data.ncon == 0
  # These alone: without lights all of the picture would change, some time later.
  viewer.window.opt.flags[flags] = 0
  eventually(lambda: shown() == 1)

  # What is seen: the box, and plots in the right third of the window.
  assert seen(0) > 200 and seen(2) < 20
  height, width = viewer.window.viewport.height, viewer.window.viewport.width
  third = lambda: screen()[10:height - 10, 2 * width // 3 + 5:width - 5]
  bare = third()
  changed = lambda: (np.abs(third() - bare).max(axis=2) > 20).mean()
  viewer._press(ord("P"))
  eventually(lambda: changed() > 0.02)
  assert viewer._plots.page.title == "rewards"
  for _ in range(3):
    viewer._press(ord("P"))
  eventually(lambda: viewer._plots.page is None and changed() < 0.005)

  # More shapes than the window has room for: evenly fewer, and said so.
  assert viewer._own_geoms < 2000 and viewer.window.user_scn.maxgeom == 100_000
  # So many shapes would take a CPU half a minute to draw.
  viewer._own_geoms = viewer.window.user_scn.maxgeom - 50
  places, draw = torch.rand(120, 3), env.command.debug_draw
  env.command.debug_draw = lambda draw: draw.spheres(places, 0.01, (1, 0, 0, 1))
  eventually(lambda: shown() == 50)
  assert viewer.num_undrawn == 70
  assert "without" in viewer._status()[1]
  env.command.debug_draw = draw
  eventually(lambda: shown() == 1 and viewer.num_undrawn == 0)

  # A drawing that fails pauses, and is said in the window; reset goes on.
  env.command.debug_draw = lambda draw: 1 / 0
  eventually(lambda: playback.error == "viewer: ZeroDivisionError: division by zero")
  assert playback.paused and "division by zero" in viewer._status()[1]
  env.command.debug_draw = draw
  viewer._press(257)
  eventually(lambda: playback.error is None and playback.step_count > 5)

  # A world that diverged stays as it was; the eye follows it again once it is back.
  box = env.sim.datas[2].qpos
  box[:] = env.sim.datas[2].xpos[:] = np.nan
  playback.pause()
  eventually(lambda: "not finite" in viewer._status()[1])
  assert np.isfinite(viewer._world.data.xpos).all()
  viewer._press(257)
  viewer._press(ord(" "))
  eventually(lambda: "not finite" not in viewer._status()[1] and playback.step_count > 5)
  np.testing.assert_allclose(viewer.window.cam.lookat, env.sim.datas[2].xpos[1], atol=0.2)

  # A pull on the box of the world that is shown, and on no other; gone when it is let go.
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

# Nothing is left that draws: it would hang the process at its end.
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
  display = f":{90 + os.getpid() % 900}"
  server = subprocess.Popen(
    ["Xvfb", display, "-screen", "0", "800x600x24"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
  )
  lock = Path(f"/tmp/.X11-unix/X{display[1:]}")
  end = time.monotonic() + 10
  while not lock.exists() and time.monotonic() < end:
    time.sleep(0.05)
  yield display
  server.terminate()
  try:
    server.wait(10)
  except subprocess.TimeoutExpired:
    server.kill()


def run(script: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
  return subprocess.run(
    [sys.executable, "-c", script],
    env=environment | {"PYTHONPATH": str(Path(__file__).parent)},
    capture_output=True,
    text=True,
    timeout=120,
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
    "except RuntimeError as error: print(error)"
  )
  environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
  done = run(script, environment)
  assert done.stdout.count("\n") == 1, done.stdout + done.stderr
  assert done.stdout.startswith("no window can be opened here (X11: The DISPLAY environment variable is missing); ")
  assert "--viewer browser needs none" in done.stdout
