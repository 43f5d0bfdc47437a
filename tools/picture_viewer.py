"""Pictures of the pages for the documentation: `uv run python tools/picture_viewer.py [PAGE ...]`.

Pages of a running viewer, photographed in the browser: the policy of `demo`, a short training, ground, a clip and a NaN
dump. Needs Chromium, and OpenGL without a screen.
"""

import argparse
import io
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

import torch
from mjlab.cli.shared._clip_preview import clip_replay, preview_model
from mjlab.nan_replay import NanReplay
from mjlab_envs import ManagerBasedRlEnv
from mjlab_motions import load_motion, shipped_clips
from mjlab_rl import CheckpointPolicy, checkpoints, load_run
from mjlab_robots import g1_spec
from mjlab_sim import NanDump
from mjlab_terrain import TerrainGridCfg, all_types
from mjlab_terrain.view.page import open_page
from mjlab_viewer import (
  BrowserViewer,
  CameraCfg,
  OffscreenRenderer,
  PictureCfg,
  Playback,
  SnapshotTaker,
  ZeroPolicy,
)
from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

FLAGS = """--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-quic --no-first-run
--disable-background-networking --disable-component-update --disable-sync""".split()
SIZE = ViewportSize(width=1280, height=760)
TASK = "Mjlab-Velocity-Flat-Unitree-Go1"
OUT = Path(__file__).parents[1] / "docs" / "pictures"
# Software WebGL draws a few pictures a second; this long until the page shows what it is to show [ms].
SETTLE = 9000


def look_at(browser: Browser, url: str, wait_for: str | re.Pattern[str]) -> Page:
  """Open a page without the note that there is no GPU, and wait until it shows a text."""
  page = browser.new_page(viewport=SIZE, reduced_motion="reduce")
  page.set_default_timeout(300_000)
  page.goto(url)
  page.add_style_tag(content=".mantine-Notifications-root { display: none }")
  page.get_by_text(wait_for).first.wait_for()
  return page


def photograph(page: Page, name: str, *, is_still: bool = True) -> None:
  """Write a picture; of a page that is still, once two looks at it are the same."""
  page.wait_for_timeout(SETTLE)
  seen = page.screenshot()
  for _ in range(10 if is_still else 0):
    before, _ = seen, page.wait_for_timeout(SETTLE / 3)
    seen = page.screenshot()
    if seen == before:
      break
  Image.open(io.BytesIO(seen)).convert("RGB").save(OUT / f"{name}.png", optimize=True)
  print(name, (OUT / f"{name}.png").stat().st_size // 1000, "kB", flush=True)
  page.close()


@contextmanager
def running(viewer: BrowserViewer) -> Generator[None]:
  """Run a viewer in a thread of its own."""
  over = threading.Event()
  thread = threading.Thread(target=viewer.run, args=(over.is_set,))
  with viewer:
    thread.start()
    try:
      yield
    finally:
      over.set()
      thread.join()


def play(browser: Browser) -> None:
  """Photograph the page of `play`: controls, plots and groups; and contact forces as a picture."""
  folder = Path(str(files("mjlab") / "demo_policy"))
  run = load_run(folder)
  run.env.scene.num_envs, run.env.seed = 8, 2
  with ManagerBasedRlEnv(run.env, device="cpu") as env:
    policy = CheckpointPolicy(env, run.agent)
    policy.load(checkpoints(folder)[-1])
    playback = Playback(env, policy)
    for world in range(8):
      env.steering()["twist"].steer(world, (0.7, 0.0, 0.1 * (world % 3 - 1)))
    playback.pause()
    # The simulation keeps contacts from its next step on.
    taker = SnapshotTaker(env, contacts=True)
    for _ in range(45):
      playback.step_once()
    contacts(env, taker)
    # The first picture is of this moment: robots that walk on leave each other.
    camera = CameraCfg(distance=4.6, azimuth=105.0, elevation=-22.0)
    viewer = BrowserViewer(env, playback=playback, camera=camera, label=TASK)
    with running(viewer):
      photograph(look_at(browser, viewer.url, "step 45"), "viewer")
      page = look_at(browser, viewer.url, "step 45")
      page.get_by_role("tab", name="Groups").click()
      photograph(page, "viewer_groups")
      page = look_at(browser, viewer.url, "step 45")
      page.get_by_role("tab", name="Plots").click()
      playback.request(playback.resume)
      while playback.total_steps < 200:
        page.wait_for_timeout(1000)
      playback.request(playback.pause)
      photograph(page, "viewer_rewards")
    print(playback.error or "no error", env.num_envs, "worlds")


def training(browser: Browser) -> None:
  """Photograph the page of `train --viewer`, after some iterations."""
  flags = """--viewer --device cpu --agent.logger none --quiet --env.scene.num-envs 8 --agent.num-steps-per-env 8
  --agent.algorithm.num-mini-batches 1 --agent.algorithm.num-learning-epochs 1""".split()
  code = "import sys; from mjlab.cli import train; sys.exit(train(sys.argv[1:]))"
  with tempfile.TemporaryDirectory() as folder:
    words = [sys.executable, "-c", code, TASK, *flags]
    process = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
      assert process.stdout is not None
      url = next(line.split()[-1] for line in process.stdout if line.startswith("watch at"))
      # The page may miss a number while it draws.
      page = look_at(browser, url, re.compile(r"Iteration ([2-9]\d|\d{3,}) of"))
      photograph(page, "viewer_training", is_still=False)
    finally:
      process.terminate()
      process.wait()


def terrain(browser: Browser) -> None:
  """Photograph the page of `visualize-terrain`."""
  types = {name: all_types()[name] for name in ("stairs_up", "waves", "random_grid", "slope_up")}
  server = open_page(TerrainGridCfg(types=types, rows=3), "127.0.0.1", 8080)
  photograph(look_at(browser, f"http://localhost:{server.get_port()}", "triangles"), "visualize_terrain")
  server.stop()


def clip(browser: Browser) -> None:
  """Photograph the page of `convert-motion --preview`."""
  motion = load_motion(shipped_clips()["squat_and_wave"])
  replay = clip_replay(preview_model(g1_spec()), motion)
  playback = Playback(replay, ZeroPolicy(1, 0, replay.sim.device))
  playback.pause()
  replay.show(motion.num_frames // 3)
  viewer = BrowserViewer(replay, playback=playback, label=motion.name)
  with running(viewer):
    photograph(look_at(browser, viewer.url, "frame"), "clip_preview")


def nan(browser: Browser) -> None:
  """Photograph the page of `viz-nan --viewer browser`, of a robot whose joint got a velocity without end."""
  with tempfile.TemporaryDirectory() as folder:
    run = load_run(Path(str(files("mjlab") / "demo_policy")))
    run.env.scene.num_envs = 2
    with ManagerBasedRlEnv(run.env, device="cpu") as env:
      env.output_dir = Path(folder)
      actions = torch.zeros(2, env.action_manager.total_action_dim)
      for step in range(30):
        if step == 29:
          env.sim.data.qvel[1, 8] = torch.inf
        env.step(actions)
    (path,) = Path(folder).rglob("*.npz")
    replay = NanReplay(NanDump.load(path))
    playback = Playback(replay, ZeroPolicy(replay.num_envs, 0, replay.sim.device))
    playback.pause()
    viewer = BrowserViewer(replay, playback=playback, label=path.name)
    with running(viewer):
      photograph(look_at(browser, viewer.url, "physics step"), "viz_nan")


def draws(browser: Browser) -> None:
  """Draw what `inspect-dr` shows of a task."""
  del browser
  path = OUT / "inspect_dr.png"
  code = "import sys; from mjlab.cli import inspect_dr; sys.exit(inspect_dr(sys.argv[1:]))"
  words = [sys.executable, "-c", code, TASK, "--num-envs", "256", "--png", str(path), "--force"]
  subprocess.run(words, stdout=subprocess.DEVNULL, check=True)
  Image.open(path).convert("RGB").save(path, optimize=True)


def contacts(env: ManagerBasedRlEnv, taker: SnapshotTaker) -> None:
  """Draw contact points and forces of one robot in its stride."""
  camera = CameraCfg(distance=1.3, azimuth=130.0, elevation=-14.0)
  cfg = PictureCfg(width=1280, height=720, camera=camera, contacts=True)
  model = env.sim.mj_model
  with OffscreenRenderer(model, cfg) as renderer:
    picture = renderer.render(taker.take((0,), drawers=env.default_drawers()))
  Image.fromarray(picture).resize((960, 540), Image.Resampling.LANCZOS).save(OUT / "viewer_contacts.png", optimize=True)


PAGES: dict[str, Callable[[Browser], None]] = {
  "play": play,
  "training": training,
  "terrain": terrain,
  "clip": clip,
  "nan": nan,
  "draws": draws,
}


def main(names: Sequence[str] | None = None) -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("pages", nargs="*", choices=[*PAGES, []], default=list(PAGES))
  args = parser.parse_args(names)
  torch.set_num_threads(1)
  with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
    for name in args.pages:
      PAGES[name](browser)
    browser.close()


if __name__ == "__main__":
  main()
