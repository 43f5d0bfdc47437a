"""Cost of the viewer: `uv run python tools/benchmark_viewer.py [--device cpu] [--worlds 4096] [--markdown FILE]`.

Times a picture for the browser by worlds shown and worlds simulated, and a step with no client, with a client, and
while a film is made. The first client is a headless Chromium on the same machine, if there is one; on a CPU it competes
with the simulation for the cores. The second client reads all messages in a separate process and draws nothing, like
a page on another machine.
"""

import argparse
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from datetime import date
from functools import partial
from importlib.metadata import version
from pathlib import Path

import torch
from mjlab.environments import cpu_cores, make, resolve_device
from mjlab_envs import ManagerBasedRlEnv
from mjlab_viewer import BrowserViewer, CameraCfg, PictureCfg, SnapshotTaker, TrainingVideo

TASK = "Mjlab-Velocity-Flat-Unitree-Go1"
DRAWN = (1, 16, 256)
BLOCK = 20
READER = """
import sys
import msgspec, viser
from viser._messages import ViewerCameraMessage
from websockets.sync.client import connect
origin, up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
pose = ViewerCameraMessage((1.0, 0.0, 0.0, 0.0), (3.0, 3.0, 2.0), 1.0, 0.1, 100.0, 720, 1280, origin, up)
with connect(sys.argv[1], subprotocols=["viser-v" + viser.__version__], max_size=None) as page:
  page.send(msgspec.msgpack.encode(pose.as_serializable_dict()))
  for _ in page:
    pass
"""
FLAGS = """--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-quic --no-first-run
--disable-background-networking --disable-component-update --disable-sync""".split()


def least_ms(action: Callable[[], object], repeats: int, block: int = 1) -> float:
  """Least mean time of `repeats` blocks of an action [ms], behind one that does not count.

  What else runs on the machine only ever adds to a time. A picture is taken in some steps only, so steps go in blocks.
  """
  means = []
  for _ in range(repeats + 1):
    begun = time.perf_counter()
    for _ in range(block):
      action()
    means.append(1e3 * (time.perf_counter() - begun) / block)
  return min(means[1:])


def stepper(env: ManagerBasedRlEnv, after_step: Callable[[], None] | None = None) -> Callable[[], None]:
  action = torch.zeros(env.num_envs, env.action_manager.total_action_dim, device=env.device)

  def step() -> None:
    env.step(action)
    if after_step is not None:
      after_step()
    if env.device.type == "cuda":
      torch.cuda.synchronize(env.device)

  return step


def picture(viewer: BrowserViewer, taker: SnapshotTaker, worlds: Sequence[int], names: Sequence[str]) -> None:
  viewer.scene.show(taker.take(worlds, drawers=names))


def pictures(env: ManagerBasedRlEnv, repeats: int) -> dict[int, float]:
  """Time of a picture [ms] by worlds shown: the copy, and the messages to the page."""
  found = {}
  for drawn in DRAWN:
    if drawn <= env.num_envs:
      with BrowserViewer(env, max_worlds=drawn, port=8400) as viewer:
        taker, worlds, names = SnapshotTaker(env, contacts=True), viewer.selection.worlds, tuple(env.drawers())
        show = partial(picture, viewer, taker, worlds, names)
        found[drawn] = least_ms(show, repeats)
  return found


def steps(env: ManagerBasedRlEnv, repeats: int) -> dict[str, float]:
  """Time of a step without and with viewers [ms]."""
  found = {"nothing": least_ms(stepper(env), repeats, BLOCK)}
  with BrowserViewer(env, port=8400) as viewer, ExitStack() as stack:
    found["a viewer, no client"] = least_ms(stepper(env, viewer.update), repeats, BLOCK)
    reader = subprocess.Popen([sys.executable, "-c", READER, viewer.url.replace("http", "ws", 1)])
    wait_for_client(viewer, 1)
    found["a viewer, one client elsewhere"] = least_ms(stepper(env, viewer.update), repeats, BLOCK)
    reader.kill()
    reader.wait()
    wait_for_client(viewer, 0)
    executable = shutil.which("chromium")
    if executable is not None:
      from playwright.sync_api import sync_playwright

      browser = stack.enter_context(sync_playwright()).chromium.launch(executable_path=executable, args=FLAGS)
      browser.new_page().goto(viewer.url)
      wait_for_client(viewer, 1)
      found["a viewer, one client here"] = least_ms(stepper(env, viewer.update), repeats, BLOCK)
      browser.close()
  with tempfile.TemporaryDirectory() as folder:
    length = (repeats + 1) * BLOCK
    cfg = PictureCfg(camera=CameraCfg())
    film = TrainingVideo(env, Path(folder), interval=length, length=length, cfg=cfg)
    found["a film"] = least_ms(stepper(env, film.after_step), repeats, BLOCK)
    film.close()
    if film.is_off:
      del found["a film"]
  return found


def wait_for_client(viewer: BrowserViewer, number: int) -> None:
  end = time.monotonic() + 30
  while len(viewer.server.get_clients()) != number:
    if time.monotonic() > end:
      raise TimeoutError(f"{len(viewer.server.get_clients())} clients after 30 s, {number} expected")
    time.sleep(0.1)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--device", default="auto")
  parser.add_argument("--worlds", type=int, nargs="+", help="256 and 1024 on a CPU, else 4096")
  parser.add_argument("--repeats", type=int, default=8)
  parser.add_argument("--markdown", type=Path)
  args = parser.parse_args()
  device = resolve_device(args.device)
  where = f"{cpu_cores()} CPU cores" if device == "cpu" else torch.cuda.get_device_name(device)
  stack = ", ".join(f"{name} {version(name)}" for name in ("mujoco", "viser", "mjviser", "torch"))
  counts: list[int] = args.worlds or ([256, 1024] if device == "cpu" else [4096])
  lines = [f"# What watching costs: Go1 on flat ground, {where}", ""]
  lines += [
    f"{date.today()}, {stack}, Python {platform.python_version()}; `tools/benchmark_viewer.py`. Least of several runs.",
    "",
  ]
  lines += [
    "A picture for the browser [ms]:",
    "",
    "| worlds | 1 shown | 16 shown | 256 shown |",
    "|---|---|---|---|",
  ]
  table: dict[int, dict[str, float]] = {}
  for worlds in counts:
    with make(TASK, num_envs=worlds, device=device) as env:
      env.reset(seed=0)
      found = pictures(env, args.repeats)
      lines.append(f"| {worlds} | " + " | ".join(f"{found[k]:.1f}" if k in found else "-" for k in DRAWN) + " |")
      table[worlds] = steps(env, args.repeats)
  heads = list(table[counts[0]])
  lines += ["", "An environment step without and with viewers [ms]:", "", "| worlds | " + " | ".join(heads) + " |"]
  lines.append("|---" * (len(heads) + 1) + "|")
  lines += [f"| {worlds} | " + " | ".join(f"{row[head]:.1f}" for head in heads) + " |" for worlds, row in table.items()]
  text = "\n".join(lines) + "\n"
  print(text)
  if args.markdown is not None:
    args.markdown.write_text(text, encoding="utf-8")


if __name__ == "__main__":
  main()
