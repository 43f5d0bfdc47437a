"""Weak and strong scaling of training on the devices of this host, in less than six minutes on four GPUs.

`OUT=FOLDER uv run python tools/benchmark_scaling.py [--seconds 345]`; `--smoke` tries it with two processes on a CPU.

Each row is one run of `train --gpus N`. Rows that fit beside each other on different GPUs run at the same time; those
of all GPUs run alone. Rows for which no time is left are reported as skipped. After each row `scaling.json` and
`scaling.md` are written to the folder OUT.

- weak: environments per GPU are constant. Rates are those of the second half of the iterations.
- large: twice as many environments per GPU.
- strong: environments of all GPUs together are constant; the training ends when its reward, as the mean of five
  iterations, reaches a goal.
- goal: the same with as many environments on every GPU.
- start: one iteration, with kernels that another row has compiled.

The start of each row is the time from the command to the first iteration.
"""

import argparse
import csv
import dataclasses
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import torch
from mjlab.environments import cpu_cores

TRAIN = "import sys; from mjlab.cli import train; sys.exit(train())"
G1, ROUGH, FLAT = (
  "Mjlab-Velocity-Flat-Unitree-G1",
  "Mjlab-Velocity-Rough-Unitree-Go1",
  "Mjlab-Velocity-Flat-Unitree-Go1",
)
CARTPOLE = "Mjlab-Cartpole-Balance"
LEAST = 35.0
"""Time that a row needs at least [s]."""


@dataclasses.dataclass(kw_only=True)
class Row:
  """One training."""

  kind: str
  task: str
  gpus: int
  num_envs: int
  """Environments per GPU."""
  iterations: int = 20
  goal: float | None = None
  """Reward at which it ends."""
  limit: float = 90.0
  """Time after which it is stopped [s]."""
  needs: str = ""
  """Kind of the rows of its task that must have ended before it starts."""


class Training:
  """A row that runs."""

  def __init__(self, row: Row, devices: list[int], device: str, limit: float) -> None:
    self.row, self.devices, self.limit = row, devices, limit
    self._folder = tempfile.TemporaryDirectory()
    self._said = (Path(self._folder.name) / "said.txt").open("w+")
    flags = {"device": device, "gpus": row.gpus, "log-root": self._folder.name, "agent.logger": "none"}
    flags |= {"env.scene.num-envs": row.num_envs, "agent.max-iterations": row.iterations, "agent.save-interval": 10**6}
    words = [word for name, value in flags.items() for word in (f"--{name}", str(value))]
    env = os.environ | {"OMP_NUM_THREADS": str(max(1, cpu_cores() // max(1, torch.cuda.device_count())))}
    if device != "cpu":
      seen = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")
      env["CUDA_VISIBLE_DEVICES"] = ",".join(seen[i] if len(seen) > i and seen[i] else str(i) for i in devices)
    self._began = time.perf_counter()
    self._process = subprocess.Popen(
      [sys.executable, "-c", TRAIN, row.task, *words],
      env=env,
      stdin=subprocess.DEVNULL,
      stdout=self._said,
      stderr=subprocess.STDOUT,
      start_new_session=True,
    )
    self._start: float | None = None
    self._stopping: float | None = None

  def poll(self) -> dict[str, Any] | None:
    """Look at the training, and stop it at its goal or limit; return its result once it has ended."""
    now = time.perf_counter() - self._began
    code = self._process.poll()
    table = self._table()
    if table and self._start is None:
      self._start = now - table[-1]["elapsed"]
    if code is not None:
      return self._result(code, table)
    is_over = now > self.limit or (self.row.goal is not None and reached(table, self.row.goal) is not None)
    if is_over and self._stopping is None:
      self._stopping = now
      self._process.send_signal(signal.SIGINT)
    elif self._stopping is not None and now > self._stopping + 20.0:
      self.kill()
    return None

  def kill(self) -> None:
    """End all its processes at once."""
    if self._process.poll() is None:
      os.killpg(self._process.pid, signal.SIGKILL)
      self._process.wait()

  def _table(self) -> list[dict[str, float]]:
    """Return the iterations so far; a line that is being written is left out."""
    found = list(Path(self._folder.name).glob("*/*/progress.csv"))
    if not found:
      return []
    text = found[0].read_text()
    lines = csv.DictReader(text[: text.rfind("\n") + 1].splitlines())
    return [{name: float(value) for name, value in line.items() if value} for line in lines]

  def _result(self, code: int, table: list[dict[str, float]]) -> dict[str, Any]:
    row = self.row
    found: dict[str, Any] = dataclasses.asdict(row) | {"exit_code": code, "start_s": self._start}
    found |= {"devices": self.devices, "wall_s": time.perf_counter() - self._began, "iterations_done": len(table)}
    half = table[len(table) // 2 :]
    if len(table) > 1:
      collect, learn = (
        sum(line[f"Perf/{name}"] for line in half) / len(half) for name in ("collection_time", "learning_time")
      )
      steps = table[-1]["total_steps"] / len(table)
      found |= {"steps_per_s": steps / (collect + learn), "rollout_s": collect, "update_s": learn}
    if row.goal is not None:
      at = reached(table, row.goal)
      found |= (
        {"goal_s": None, "goal_steps": None}
        if at is None
        else {
          "goal_s": table[at]["elapsed"],
          "goal_steps": table[at]["total_steps"],
        }
      )
      found["curve"] = [[line["elapsed"], line.get("Train/mean_reward")] for line in table]
    if code != 0 or not table:
      self._said.seek(0)
      found["said"] = self._said.read()[-3000:]
    self._said.close()
    self._folder.cleanup()
    return found


def reached(table: list[dict[str, float]], goal: float) -> int | None:
  """Return the first iteration at which the mean reward of five is at the goal."""
  rewards = [line.get("Train/mean_reward", float("nan")) for line in table]
  means = [sum(rewards[i - 4 : i + 1]) / 5 for i in range(4, len(rewards))]
  return next((i + 4 for i, mean in enumerate(means) if mean >= goal), None)


def plan(count: int) -> list[Row]:
  """Return the rows for a number of GPUs: first those that share the host, the longest first."""
  counts = [gpus for gpus in (1, 2, 4, 8) if gpus <= count]
  rows: list[Row] = []
  for gpus in counts:
    strong = Row(kind="strong", task=FLAT, gpus=gpus, num_envs=4096 // gpus, iterations=600, goal=60.0, limit=150.0)
    weak = [Row(kind="weak", task=task, gpus=gpus, num_envs=4096) for task in (G1, ROUGH)]
    rows += [*weak, strong] if gpus == counts[-1] > 1 else [strong, *reversed(weak)]
  rows.insert(len(rows) - 3, Row(kind="start", task=G1, gpus=1, num_envs=4096, iterations=1, needs="weak"))
  rows.append(Row(kind="large", task=G1, gpus=counts[-1], num_envs=8192))
  if counts[-1] > 1:
    rows.append(Row(kind="goal", task=FLAT, gpus=counts[-1], num_envs=4096, iterations=600, goal=60.0))
  return rows


def smoke() -> list[Row]:
  """Return rows for two processes on a CPU, which measure nothing."""
  common: dict[str, Any] = {"task": CARTPOLE, "limit": 300.0}
  rows = [Row(kind="weak", gpus=gpus, num_envs=16, iterations=6, **common) for gpus in (1, 2)]
  rows.append(Row(kind="start", gpus=1, num_envs=16, iterations=1, needs="weak", **common))
  rows.append(Row(kind="strong", gpus=2, num_envs=8, iterations=1000, goal=0.0, **common))
  return rows


def run(rows: list[Row], devices: int, device: str, seconds: float, folder: Path, header: str) -> list[dict[str, Any]]:
  """Run the rows, several at a time, and write the results as they come."""
  began = time.perf_counter()
  pending, running, done = list(rows), [], []
  free = list(range(devices))
  try:
    while pending or running:
      left = began + seconds - time.perf_counter()
      for row in list(pending):
        waits = any(
          row.needs == x.kind and row.task == x.task and x.gpus == 1 for x in [*pending, *(t.row for t in running)]
        )
        if waits or row.gpus > len(free):
          continue
        pending.remove(row)
        if left < LEAST:
          done.append(dataclasses.asdict(row) | {"skipped": "no time left"})
          continue
        taken = [free.pop(0) for _ in range(row.gpus)]
        running.append(Training(row, taken, device, min(row.limit, left)))
      for training in list(running):
        if (result := training.poll()) is not None:
          running.remove(training)
          free = sorted(free + training.devices)
          done.append(result)
          print(line(result, done), flush=True)
          write(folder, header, done)
      time.sleep(0.1)
  finally:
    for training in running:
      training.kill()
    write(folder, header, done)
  return done


COLUMNS = ["row", "task", "GPUs", "environments per GPU", "steps/s", "of linear", "rollout [s]", "update [s]"]
COLUMNS += ["start [s]", "to the goal [s]", "millions of steps to it"]


def line(row: dict[str, Any], rows: list[dict[str, Any]]) -> str:
  """Return a result as a line of the table; of linear: per GPU, against one GPU with as many environments."""
  rate = row.get("steps_per_s")
  same = [x for x in rows if x["kind"] == row["kind"] == "weak" and x["task"] == row["task"] and x["gpus"] == 1]
  base = next((x["steps_per_s"] for x in same if x.get("steps_per_s")), None)
  steps = row.get("goal_steps")
  cells = [row["kind"], row["task"], str(row["gpus"]), str(row["num_envs"]), f"{rate:,.0f}" if rate else "-"]
  cells += [f"{rate / row['gpus'] / base:.3f}" if rate and base else "-"]
  cells += [f"{row[name]:.3f}" if row.get(name) is not None else "-" for name in ("rollout_s", "update_s")]
  cells += [f"{row[name]:.1f}" if row.get(name) is not None else "-" for name in ("start_s", "goal_s")]
  cells += [f"{steps / 1e6:.1f}" if steps else "-"]
  if row.get("exit_code"):
    cells[0] += f", failed with exit code {row['exit_code']}"
  if "skipped" in row:
    cells[0] += ", skipped"
  return f"| {' | '.join(cells)} |"


def write(folder: Path, header: str, rows: list[dict[str, Any]]) -> None:
  """Write all results so far."""
  folder.mkdir(parents=True, exist_ok=True)
  (folder / "scaling.json").write_text(json.dumps({"where": header, "rows": rows}, indent=1) + "\n")
  head = [f"| {' | '.join(COLUMNS)} |", f"|{'---|' * len(COLUMNS)}"]
  ordered = sorted(rows, key=lambda row: (row["kind"], row["task"], row["gpus"]))
  text = "\n".join([header, "", *head, *(line(row, rows) for row in ordered)])
  (folder / "scaling.md").write_text(text + "\n")


def main() -> int:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--seconds", type=float, default=345.0, help="time for all rows; later ones are skipped")
  parser.add_argument("--only", help="kinds of rows to run, such as weak,start")
  parser.add_argument("--smoke", action="store_true", help="two processes on the CPU, to try this program")
  wanted = parser.parse_args()
  count = 0 if wanted.smoke else torch.cuda.device_count()
  if not count and not wanted.smoke:
    parser.error("there is no GPU; --smoke runs on the CPU")
  rows = plan(count) if count else smoke()
  if wanted.only:
    rows = [row for row in rows if row.kind in wanted.only.split(",")]
  where = f"{count} x {torch.cuda.get_device_name()}" if count else "CPU, which measures nothing"
  header = f"{time.strftime('%Y-%m-%d')}, {where}, {cpu_cores()} cores, torch {torch.__version__}"
  print(f"{header}\n\n| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}", flush=True)
  seconds = 1200.0 if wanted.smoke else wanted.seconds
  folder = Path(os.environ.get("OUT", "scaling"))
  done = run(rows, count or 2, "cuda" if count else "cpu", seconds, folder, header)
  for row in done:
    if "said" in row:
      print(f"\n{row['kind']} {row['task']} on {row['gpus']}:\n{row['said']}")
  return 1 if any(row.get("exit_code") for row in done) else 0


if __name__ == "__main__":
  sys.exit(main())
