"""Kill a training at random moments and resume it each time: `uv run python tools/kill_runs.py --times 50`.

Cartpole trains with a checkpoint after every short iteration, so that kills (SIGKILL) often hit a write. After each
kill every checkpoint is read, and the next start resumes the newest one. At the end no temporary file may be left.
"""

import argparse
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch

TASK = "Mjlab-Cartpole-Balance"
TRAIN = ("import sys; from mjlab.cli import main; sys.exit(main(sys.argv[1:]))", "train", TASK, "--device", "cpu")
SMALL = ("--quiet", "--env.scene.num-envs", "4", "--agent.num-steps-per-env", "2", "--agent.save-interval", "1")


def train(root: Path, *flags: str) -> subprocess.Popen[bytes]:
  return subprocess.Popen(
    [sys.executable, "-c", *TRAIN, *SMALL, "--log-root", str(root), *flags], stderr=subprocess.PIPE, bufsize=0
  )


def checkpoints(root: Path) -> list[Path]:
  return sorted(root.rglob("model_*.pt"), key=lambda path: int(path.stem.split("_")[1]))


def temporary(root: Path) -> list[Path]:
  return list(root.rglob(".*.tmp*"))


def main() -> int:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--times", type=int, default=50, help="number of kills")
  parser.add_argument("--seed", type=int, default=0, help="seed of the moments")
  args = parser.parse_args()
  rng = random.Random(args.seed)
  written = torn = unreadable = not_resumed = 0
  with tempfile.TemporaryDirectory() as folder:
    root = Path(folder)
    for kill in range(args.times):
      before = len(checkpoints(root))
      resume = ("--resume", "latest") if before else ()
      running = train(root, "--agent.max-iterations", "1000000", *resume)
      while len(checkpoints(root)) <= before and running.poll() is None:
        time.sleep(0.02)
      time.sleep(rng.uniform(0.0, 0.5))
      if running.poll() is not None:
        not_resumed += 1
        print(running.communicate()[1].decode(), file=sys.stderr)
      running.send_signal(signal.SIGKILL)
      running.wait()
      torn += len(temporary(root))
      for path in checkpoints(root)[before:]:
        written += 1
        try:
          torch.load(path, weights_only=True)
        except Exception as error:
          unreadable += 1
          print(f"{path.name}: {error}")
      print(f"kill {kill + 1}: {len(checkpoints(root))} checkpoints", file=sys.stderr, flush=True)
    done = int(checkpoints(root)[-1].stem.removeprefix("model_"))
    last = train(root, "--agent.max-iterations", str(done + 1), "--resume", "latest")
    error = last.communicate()[1].decode()
    if ended := last.returncode:
      print(error, file=sys.stderr)
    left = len(temporary(root))
  print("| kills | checkpoints written | hit during a write | unreadable | starts that failed | files left |")
  print("| ---: | ---: | ---: | ---: | ---: | ---: |")
  print(f"| {args.times} | {written} | {torn} | {unreadable} | {not_resumed + (ended != 0)} | {left} |")
  return int(bool(unreadable or not_resumed or ended or left))


if __name__ == "__main__":
  sys.exit(main())
