"""CPU time of commands at a prompt, as a table: `uv run python tools/benchmark_cli.py`.

CPU seconds of the whole process (user and system, children included), in a fresh interpreter: the smallest of several
runs, which other programs disturbed least. Counting the modules comes first and warms the disk cache.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path

TASK = "Mjlab-Velocity-Flat-Unitree-Go1"
# What is shown, and the statement that does it. The first row is what every other one contains.
COMMANDS = {
  "python -c pass": "pass",
  "import mjlab": "import mjlab",
  "mjlab --help": "from mjlab.cli import main; main(['--help'])",
  "list-envs": "from mjlab.cli import list_envs; list_envs([])",
  "train --help": "from mjlab.cli import train; train(['--help'])",
  f"train {TASK} --help": f"from mjlab.cli import train; train(['{TASK}', '--help'])",
  f"train {TASK} --help foot": f"from mjlab.cli import train; train(['{TASK}', '--help', 'foot'])",
  "convert-motion --help": "from mjlab.cli import convert_motion; convert_motion(['--help'])",
  "demo": (
    "import mjlab_viewer; mjlab_viewer.BrowserViewer.run = lambda _: opened();"
    "from mjlab.cli import demo; demo(['--device', 'cpu'])"
  ),
}
WATCHED = ("numpy", "mujoco", "torch", "warp", "mujoco_warp", "rsl_rl")
# The page can be opened: the time ends here, without that of closing everything.
OPENED = "import os; opened = lambda: os._exit(0)\n"
STAY = "opened = lambda: None\n"
REPORT = "\nimport json, sys; sys.stdout.flush(); json.dump(sorted(sys.modules), sys.stderr)"


@dataclass
class Cost:
  """One row of the table."""

  least: float
  """CPU time of the quickest run [s]."""
  median: float
  """Median CPU time of all runs [s]."""
  elapsed: float
  """Least time of a run from start to end, which other programs on the cores lengthen [s]."""
  megabytes: float
  """Greatest memory of a run [MB]."""
  modules: int
  """Modules loaded when the command is done."""
  heavy: list[str]
  """Those of `WATCHED` among them."""


def usage(statement: str, sources: str = "") -> tuple[float, float, float]:
  """Return CPU time [s], greatest memory [MB] and elapsed time [s] of a new interpreter."""
  environment = os.environ | ({"PYTHONPATH": sources} if sources else {})
  started = time.perf_counter()
  process = subprocess.Popen([sys.executable, "-c", OPENED + statement], stdout=subprocess.DEVNULL, env=environment)
  _, status, used = os.wait4(process.pid, 0)
  process.returncode = os.waitstatus_to_exitcode(status)
  if process.returncode:
    raise subprocess.CalledProcessError(process.returncode, statement)
  return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0, time.perf_counter() - started


def measure(statement: str, repeats: int) -> Cost:
  report = subprocess.run([sys.executable, "-c", STAY + statement + REPORT], capture_output=True, text=True, check=True)
  modules = set(json.loads(report.stderr))
  seconds, megabytes, elapsed = zip(*(usage(statement) for _ in range(repeats)), strict=True)
  heavy = [name for name in WATCHED if name in modules]
  return Cost(min(seconds), statistics.median(seconds), min(elapsed), max(megabytes), len(modules), heavy)


def compare(clone: Path, repeats: int) -> None:
  """Print the CPU time of `demo` with the sources of another clone and with these, which take turns."""
  sources = ":".join(map(str, [*clone.glob("packages/*/src"), *clone.glob("tasks/*/src")]))
  runs = [(usage(COMMANDS["demo"], sources)[0], usage(COMMANDS["demo"])[0]) for _ in range(repeats)]
  theirs, ours = (min(seconds) for seconds in zip(*runs, strict=True))
  print(f"demo: {theirs:.1f} s there, {ours:.1f} s here, {ours / theirs:.2f} of it")


def processor() -> str:
  """Return the processor's name if the system states it, else its architecture."""
  info = Path("/proc/cpuinfo")
  lines = info.read_text().splitlines() if info.exists() else []
  models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
  return models[0] if models else platform.machine()


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--repeats", type=int, default=7)
  parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "benchmarks" / "cli.md")
  parser.add_argument("--quick", action="store_true", help="leave out `demo`")
  parser.add_argument("--against", type=Path, help="another clone; compares `demo` alone")
  arguments = parser.parse_args()
  if arguments.against is not None:
    compare(arguments.against, arguments.repeats)
    return
  rows, before = [], os.getloadavg()[0]
  for shown, statement in COMMANDS.items():
    if shown == "demo" and arguments.quick:
      continue
    cost = measure(statement, arguments.repeats)
    heavy = ", ".join(cost.heavy) or "-"
    times = f"{cost.least:.3f} | {cost.median:.3f} | {cost.elapsed:.3f}"
    rows.append(f"| `{shown}` | {times} | {cost.megabytes:.0f} | {cost.modules} | {heavy} |")
    print(rows[-1], flush=True)
  versions = ", ".join(f"{name} {version(name)}" for name in ("mjlab", "torch", "mujoco", "tyro"))
  table = "\n".join(rows)
  text = f"""# What a prompt costs

CPU seconds of the whole process, least and median of {arguments.repeats} runs, the least time from its start to its
end, its greatest memory, and the modules that are loaded when it is done; of `demo` until its page can be opened. The
help of a task is read from a file that its first call writes; only that one imports the task, and its modules are
shown. Absolute times hold on this machine only; compare rows. Made by `uv run python tools/benchmark_cli.py`.

{date.today()}, Python {platform.python_version()}, {versions};
{os.cpu_count()} cores of {processor()}, load average {before:.1f} before and {os.getloadavg()[0]:.1f} after.

| command | CPU [s] | median [s] | elapsed [s] | memory [MB] | modules | of these |
|---|---|---|---|---|---|---|
{table}
"""
  arguments.out.parent.mkdir(parents=True, exist_ok=True)
  arguments.out.write_text(text, encoding="utf-8")
  print(arguments.out)


if __name__ == "__main__":
  main()
