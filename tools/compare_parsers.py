"""Flags of tasks as mjlab and as tyro alone read them: `uv run python tools/compare_parsers.py`.

CPU seconds until the configuration of a training with one changed flag is there, in a fresh interpreter, without the
time to build the task. Least of several runs. Writes docs/benchmarks/parsers.md.
"""

import argparse
import contextlib
import io
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import make_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

TASKS = (
  "Mjlab-Cartpole-Balance",
  "Mjlab-Velocity-Flat-Unitree-Go1",
  "Mjlab-Velocity-Rough-Unitree-G1",
  "Mjlab-Tracking-Flat-Unitree-G1",
  "Mjlab-Lift-Objects-Yam-Rgb",
)
CHANGED = ["--env.scene.num-envs", "8"]


def outcome(action: Callable[[], Any]) -> str:
  """Return how an action of tyro ends: "yes", or the error."""
  with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    try:
      action()
    except SystemExit as error:
      return "no" if error.code else "yes"
    except Exception as error:
      return type(error).__name__
  return "yes"


def measure(task: str, parser: str) -> dict[str, Any]:
  """Return seconds of one parser, and for tyro what else it can do."""
  from mjlab.cli.shared import _flags
  from mjlab.registry import load_task

  loaded = load_task(task)

  form = make_dataclass("Form", [("env", type(loaded.env)), ("agent", type(loaded.agent))])
  both = form(loaded.env, loaded.agent)
  started = time.process_time()
  if parser == "mjlab":
    _flags.parse(both, CHANGED)
    return {"seconds": time.process_time() - started, "flags": len(_flags.flags(both))}
  import tyro

  read: Any = tyro.cli(form, default=both, args=CHANGED)
  found: dict[str, Any] = {"seconds": time.process_time() - started}
  found["kept"] = "yes" if read.env.rewards is both.env.rewards else "no"
  found["help"] = outcome(lambda: tyro.cli(form, default=both, args=["--help"]))
  part = "--env.rewards." + next(iter(both.env.rewards)).replace("_", "-")
  found["removed"] = outcome(lambda: tyro.cli(form, default=both, args=[part, "None"]))
  return found


def fresh(task: str, parser: str, repeats: int) -> dict[str, Any]:
  """Return what `measure` finds in the quickest of several interpreters."""
  runs = []
  for _ in range(repeats):
    command = [sys.executable, "-W", "ignore", __file__, "--one", task, parser]
    runs.append(json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
  return min(runs, key=lambda run: run["seconds"])


def main() -> None:
  """Write the table."""
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--repeats", type=int, default=3)
  parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
  args = parser.parse_args()
  if args.one is not None:
    print(json.dumps(measure(*args.one)))
    return
  rows = []
  for task in TASKS:
    ours, tyro = (fresh(task, name, args.repeats) for name in ("mjlab", "tyro"))
    times = f"{ours['seconds']:.2f} | {tyro['seconds']:.2f}"
    rows.append(f"| {task} | {ours['flags']} | {times} | {tyro['help']} | {tyro['removed']} | {tyro['kept']} |")
    print(rows[-1], flush=True)
  text = f"""# Flags of tasks, read by mjlab and by tyro alone

CPU time to read one flag of a training (`{" ".join(CHANGED)}`), in a fresh interpreter with the task loaded, least of
{args.repeats} runs; tyro {version("tyro")}. The last columns say what tyro alone does: whether it prints the help,
whether `--env.rewards.NAME None` removes a reward, and whether parts without a changed flag stay the same objects.
Made by `uv run python tools/compare_parsers.py`.

| task | flags | mjlab [s] | tyro [s] | help | removes | keeps |
|---|---:|---:|---:|---|---|---|
{chr(10).join(rows)}
"""
  path = Path(__file__).parents[1] / "docs" / "benchmarks" / "parsers.md"
  path.write_text(text, encoding="utf-8")
  print(path)


if __name__ == "__main__":
  main()
