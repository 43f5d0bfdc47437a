"""Pictures of the viewer for the documentation: `uv run python tools/picture_viewer.py`.

They show the policy of `demo`, on pages of a running viewer that are photographed in the browser. Needs Chromium, and
OpenGL without a screen.
"""

import argparse
import shutil
import threading
from importlib.resources import files
from pathlib import Path

import torch
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import CheckpointPolicy, checkpoints, load_run
from mjlab_viewer import BrowserViewer, CameraCfg, OffscreenRenderer, PictureCfg, Playback, SnapshotTaker
from PIL import Image
from playwright.sync_api import Page, ViewportSize, sync_playwright

FLAGS = """--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-quic --no-first-run
--disable-background-networking --disable-component-update --disable-sync""".split()
SIZE = ViewportSize(width=1280, height=760)
# Software WebGL draws a few pictures a second; this long until the page shows what it is to show [ms].
SETTLE = 9000


def photograph(page: Page, url: str, playback: Playback, out: Path) -> None:
  page.goto(url)
  page.get_by_role("button", name="Reset").wait_for(timeout=30000)
  page.wait_for_timeout(SETTLE)
  # The notice that there is no GPU.
  for button in page.locator(".mantine-Notification-closeButton").all():
    button.click()
  page.wait_for_timeout(1000)
  page.screenshot(path=out / "viewer.png")
  page.get_by_role("tab", name="Plots").click()
  playback.request(playback.resume)
  page.wait_for_timeout(12000)
  page.screenshot(path=out / "viewer_rewards.png")


def contacts(env: ManagerBasedRlEnv, taker: SnapshotTaker, out: Path) -> None:
  """Contact points and forces of one robot in its stride."""
  camera = CameraCfg(distance=1.3, azimuth=130.0, elevation=-14.0)
  cfg = PictureCfg(width=1280, height=720, camera=camera, contacts=True)
  model = env.sim.mj_model
  with OffscreenRenderer(model, cfg) as renderer:
    picture = renderer.render(taker.take((0,), drawers=env.default_drawers()))
  Image.fromarray(picture).resize((960, 540), Image.Resampling.LANCZOS).save(out / "viewer_contacts.png", optimize=True)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "pictures")
  args = parser.parse_args()
  torch.set_num_threads(1)
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
    contacts(env, taker, args.out)
    # The first picture is of this moment: robots that walk on leave each other.
    over = threading.Event()
    with BrowserViewer(
      env, playback=playback, camera=CameraCfg(distance=4.6, azimuth=105.0, elevation=-22.0)
    ) as viewer:
      thread = threading.Thread(target=viewer.run, args=(over.is_set,))
      thread.start()
      try:
        with sync_playwright() as playwright:
          chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
          photograph(chromium.new_page(viewport=SIZE), viewer.url, playback, args.out)
          chromium.close()
      finally:
        over.set()
        thread.join()
    print(playback.error or "pictures made", env.num_envs, "worlds")


if __name__ == "__main__":
  main()
