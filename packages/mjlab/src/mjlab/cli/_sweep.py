"""`sweep TASK --space FILE --trials N`: trainings with other values, by Ray Tune."""

import csv
import math
import time
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import msgspec
from mjlab_core import AtomicWrite, UsageError, printable
from mjlab_core.constraints import NonNegative, PositiveCount
from mjlab_core.io.files import reading
from mjlab_core.io.tables import table

from mjlab.cli.shared._command_line import CommandLine, TaskArguments, TaskLine
from mjlab.cli.shared._sweep_space import Range, Space, Sweep, Trial, check, read_space

_CONFIGS = ("--agent.", "--env.")


@dataclass(kw_only=True)
class Arguments(TaskArguments):
  """All that can be given after the task."""

  space: str | None = None
  """YAML file of the values to try; it also names those that pbt may change."""
  trials: PositiveCount = 8
  """Number of trials; with pbt, the size of the population."""
  gpus_per_trial: NonNegative = 0.0
  """GPUs of a trial, such as 0.5 for two trials on each; 0: trials run on CPUs."""
  cpus_per_trial: PositiveCount = 1
  """CPU cores of a trial."""
  scheduler: Literal["asha", "pbt", "none"] = "asha"
  """asha stops trials that are behind; in pbt they copy better ones and change values; none lets all end."""
  address: str | None = None
  """Ray cluster, such as auto or ray://HOST:10001; None: this machine."""
  resume: str | None = None
  """Name of a sweep to continue, with its space and flags."""
  name: str | None = None
  """Name of the sweep; None: task and time."""
  seed: int = 0
  """Seed of the values that are drawn."""
  log_root: str = "logs"
  """Folder of all runs; sweeps are in its folder sweeps."""
  agent: Any = None
  """Configuration of the learner."""


@CommandLine(
  "sweep",
  "TASK",
  Arguments,
  notes="""\
  --agent.PATH VALUE        A value that all trials have, e.g. --agent.max-iterations 300.

  The file of --space:

    values:
      agent.algorithm.entropy-coef: [0.0, 0.005, 0.01]
      agent.algorithm.desired-kl: {low: 0.005, high: 0.02, log: true}
    perturb: [agent.algorithm.entropy-coef]
""",
)
def run(wanted: Arguments, line: TaskLine) -> int:
  """Train a task with many values of its configuration, and show the best.

  This needs Ray, the extra sweep.
  """
  from mjlab.cli.shared._flags import grouped

  name = line.name
  sweeps = Path(wanted.log_root).resolve() / "sweeps"
  if wanted.resume is not None:
    folder = sweeps / wanted.resume
    with reading("sweep", folder / "sweep.json", 2**20) as file:
      sweep = msgspec.json.decode(file.read_bytes(), type=Sweep)
    if sweep.task != name:
      raise UsageError(f"--resume {wanted.resume}: it is a sweep of {printable(sweep.task, 100)}, not of {name}")
  else:
    if wanted.space is None:
      raise UsageError("--space FILE is missing; sweep --help shows such a file")
    folder = sweeps / (wanted.name or f"{name}_{time.strftime('%Y-%m-%d_%H-%M-%S')}")
    if folder.exists():
      raise UsageError(f"--name: {folder} exists; --resume {folder.name} continues it")
    sweep = Sweep(
      task=name,
      flags=[word for flag, values in grouped(line.flags) if flag.startswith(_CONFIGS) for word in (flag, *values)],
      space=read_space(wanted.space),
      trials=wanted.trials,
      scheduler=wanted.scheduler,
      max_iterations=wanted.agent.max_iterations,
      gpus=wanted.gpus_per_trial,
      cpus=wanted.cpus_per_trial,
      seed=wanted.seed,
    )
  check(sweep)
  if find_spec("ray") is None:
    raise UsageError("sweep needs Ray, the extra 'sweep' of mjlab: uv sync --all-packages --extra sweep")
  from mjlab.cli.shared._sweep_trials import run_trials

  if wanted.resume is None:
    with AtomicWrite(folder / "sweep.json") as temporary:
      temporary.write_bytes(msgspec.json.format(msgspec.json.encode(sweep), indent=1))
  trials = run_trials(sweep, folder, wanted.address, is_resumed=wanted.resume is not None)
  print(report(trials, sweep.space, folder))
  if any(trial.state != "done" for trial in trials):
    print(f"not all trials are done: sweep {name} --resume {folder.name} continues them")
  return 1 if all(trial.state == "failed" for trial in trials) else 0


def report(trials: list[Trial], space: Space, folder: Path) -> str:
  """Write the results as trials.csv and trials.png; return them as a table, the best first."""
  from mjlab.cli.shared._plots import plot_trials

  best = sorted(trials, key=lambda trial: -math.inf if math.isnan(trial.reward) else trial.reward, reverse=True)
  head, names = ["trial", "reward", "iterations", "state"], list(space.values)
  rows = [[t.name, t.reward, t.iterations, t.state, *(t.values.get(name, "") for name in names)] for t in best]
  csv_file, picture = folder / "trials.csv", folder / "trials.png"
  with AtomicWrite(csv_file) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
    csv.writer(file).writerows([[*head, *names], *rows])
  ends = [name.rpartition(".")[2] for name in names]
  short = {name: end if ends.count(end) == 1 else name for name, end in zip(names, ends, strict=True)}
  columns = {short[name]: [trial.values.get(name, "") for trial in best] for name in names}
  logarithmic = {short[name] for name, domain in space.values.items() if isinstance(domain, Range) and domain.log}
  plot_trials(columns, [trial.reward for trial in best], logarithmic, picture)
  shown = [[f"{cell:.4g}" if isinstance(cell, float) else cell for cell in row] for row in rows]
  return f"{table([*head, *columns], shown)}\nwrote {csv_file}\nwrote {picture}"
