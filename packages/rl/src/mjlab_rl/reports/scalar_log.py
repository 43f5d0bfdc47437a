"""Figures of each iteration, and the logs that keep them: progress.csv, tensorboard, Weights & Biases."""

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from mjlab_core.io.files import AtomicWrite

from mjlab_rl.config import RslRlBaseRunnerCfg


@dataclass(kw_only=True)
class IterationReport:
  """Figures of one training iteration."""

  iteration: int
  """Index of the iteration, from 0 over all resumes."""
  end: int
  """Iterations in all."""
  total_steps: int
  """Environment steps since the start of the run, all worlds together."""
  elapsed: float
  """Training time since the start of the run, resumes included [s]."""
  eta: float
  """Expected time to the last iteration [s]."""
  scalars: dict[str, float]
  """Logged values by rsl-rl's tags."""

  @property
  def steps_per_second(self) -> float:
    """Environment steps of all worlds per second of this iteration."""
    return self.scalars["Perf/total_fps"]

  @property
  def mean_reward(self) -> float | None:
    """Mean return of the last 100 finished episodes; None before the first."""
    return self.scalars.get("Train/mean_reward")

  @property
  def mean_episode_length(self) -> float | None:
    """Mean length of the last 100 finished episodes [steps]; None before the first."""
    return self.scalars.get("Train/mean_episode_length")

  def cause_of_divergence(self) -> str:
    """Return the likely cause of losses or weights that are not finite, from the values of this iteration."""
    broken = {tag: value for tag, value in self.scalars.items() if tag.startswith("Nonfinite/") and value > 0}
    if broken:
      found = ", ".join(f"{tag.removeprefix('Nonfinite/')} ({value:.0f} values)" for tag, value in broken.items())
      return f"Cause: not finite before the update: {found}."
    prefix = "Episode_Reward/"
    terms = {tag.removeprefix(prefix): abs(v) for tag, v in self.scalars.items() if tag.startswith(prefix)}
    # A NaN counts as the largest.
    largest = max(terms, key=lambda name: terms[name] if math.isfinite(terms[name]) else math.inf, default=None)
    rewards = "" if largest is None else f"the largest reward term is {largest} ({terms[largest]:.3g}), "
    rate = self.scalars.get("Loss/learning_rate", math.nan)
    return (
      f"Cause: rewards that are too large, or steps of the learner: {rewards}the learning rate is {rate:.3g} "
      "(agent.algorithm.learning_rate)."
    )


class CsvLog:
  """One row per iteration in `progress.csv`; a reader never sees half a row.

  A value that first appears in a later iteration widens the table: the file is replaced by one with the new column.
  """

  def __init__(self, path: Path):
    self._path = path
    self._columns: list[str] = []

  def write(self, report: IterationReport) -> None:
    """Write the figures of one iteration."""
    row: dict[str, Any] = {
      "iteration": report.iteration,
      "total_steps": report.total_steps,
      "elapsed": round(report.elapsed, 3),
      **{name: f"{value:.8g}" for name, value in report.scalars.items()},
    }
    missing = [name for name in row if name not in self._columns]
    if missing:
      self._widen(missing)
    text = io.StringIO()
    csv.DictWriter(text, self._columns, restval="", lineterminator="\n").writerow(row)
    # Unbuffered: one write for the whole row.
    with self._path.open("ab", buffering=0) as file:
      file.write(text.getvalue().encode())

  def _widen(self, columns: list[str]) -> None:
    rows: list[dict[str, str]] = []
    if self._columns:
      with self._path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    self._columns += columns
    with AtomicWrite(self._path) as temporary, temporary.open("w", newline="") as file:
      writer = csv.DictWriter(file, self._columns, restval="", lineterminator="\n")
      writer.writeheader()
      writer.writerows(rows)


class RunLogs:
  """Logs of a run: progress.csv, and those of `cfg.logger`; wandb also writes tensorboard files.

  Args:
    directory: Run directory; None: nothing is written.
    cfg: Configuration of the learner.
    config: The same as plain values, for Weights & Biases.
  """

  def __init__(self, directory: Path | None, cfg: RslRlBaseRunnerCfg, config: dict[str, Any]):
    self._csv: CsvLog | None = None
    self._tensorboard: Any = None
    self._wandb: Any = None
    self._uploads = cfg.upload_model
    if directory is None:
      return
    self._csv = CsvLog(directory / "progress.csv")
    if cfg.logger == "wandb":
      import wandb  # pyright: ignore[reportMissingImports]  # ty: ignore[import-not-found]

      self._wandb = wandb.init(
        project=cfg.wandb_project, name=directory.name, dir=str(directory), tags=list(cfg.wandb_tags), config=config
      )
    if cfg.logger in ("tensorboard", "wandb"):
      from torch.utils.tensorboard import SummaryWriter

      self._tensorboard = SummaryWriter(log_dir=str(directory), flush_secs=10)

  def __enter__(self) -> Self:
    return self

  def __exit__(self, *_: object) -> None:
    if self._tensorboard is not None:
      self._tensorboard.close()
    if self._wandb is not None:
      self._wandb.finish()

  def write(self, report: IterationReport) -> None:
    """Write the figures of one iteration, under rsl-rl's tags."""
    if self._csv is not None:
      self._csv.write(report)
    if self._wandb is not None:
      self._wandb.log(report.scalars, step=report.iteration)
    if self._tensorboard is not None:
      for tag, value in report.scalars.items():
        self._tensorboard.add_scalar(tag, value, report.iteration)
        if tag.startswith("Train/"):
          # Reward and length once more over seconds.
          self._tensorboard.add_scalar(f"{tag}/time", value, int(report.elapsed))

  def save_file(self, path: Path) -> None:
    """Upload a checkpoint to Weights & Biases if that is wanted."""
    if self._wandb is not None and self._uploads:
      self._wandb.save(str(path), base_path=str(path.parent))
