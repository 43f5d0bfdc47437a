"""Where the figures of each iteration are kept: progress.csv, tensorboard, Weights & Biases."""

import csv
import io
import os
from pathlib import Path
from typing import Any, Protocol

from mjlab_rl.config import RslRlBaseRunnerCfg
from mjlab_rl.iteration_report import IterationReport


class ScalarLog(Protocol):
  """Receives one report per iteration."""

  def write(self, report: IterationReport) -> None: ...

  def save_file(self, path: Path) -> None:
    """A checkpoint was written."""
    ...

  def close(self) -> None: ...


class CsvLog:
  """One row per iteration in `progress.csv`; a reader never sees half a row.

  A value that first appears in a later iteration widens the table: the file is replaced by one with the new column.
  """

  def __init__(self, path: Path):
    self._path = path
    self._columns: list[str] = []

  def write(self, report: IterationReport) -> None:
    """Append the row of one iteration."""
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
    handle = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
      os.write(handle, text.getvalue().encode())
    finally:
      os.close(handle)

  def _widen(self, columns: list[str]) -> None:
    rows: list[dict[str, str]] = []
    if self._columns:
      with self._path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    self._columns += columns
    temporary = self._path.with_suffix(".csv.tmp")
    with temporary.open("w", newline="") as file:
      writer = csv.DictWriter(file, self._columns, restval="", lineterminator="\n")
      writer.writeheader()
      writer.writerows(rows)
    os.replace(temporary, self._path)

  def save_file(self, path: Path) -> None:
    """Nothing to do."""

  def close(self) -> None:
    """Nothing to do: every row is on disk once written."""


class TensorboardLog:
  """Scalars under rsl-rl's tags, so that its curves and ours lie in one plot."""

  def __init__(self, directory: Path):
    from torch.utils.tensorboard import SummaryWriter

    self._writer = SummaryWriter(log_dir=str(directory), flush_secs=10)

  def write(self, report: IterationReport) -> None:
    """Write all scalars; reward and length a second time over seconds instead of iterations."""
    for tag, value in report.scalars.items():
      self._writer.add_scalar(tag, value, report.iteration)
    if report.mean_reward is not None:
      self._writer.add_scalar("Train/mean_reward/time", report.mean_reward, int(report.elapsed))
      self._writer.add_scalar("Train/mean_episode_length/time", report.mean_episode_length, int(report.elapsed))

  def save_file(self, path: Path) -> None:
    """Nothing to do."""

  def close(self) -> None:
    """Write what is buffered."""
    self._writer.close()


class WandbLog:
  """Scalars, configuration and checkpoints in a Weights & Biases run; wandb is imported here and nowhere else."""

  def __init__(self, directory: Path, cfg: RslRlBaseRunnerCfg, config: dict[str, Any]):
    import wandb  # pyright: ignore[reportMissingImports]  # ty: ignore[import-not-found]

    self._run = wandb.init(
      project=cfg.wandb_project, name=directory.name, dir=str(directory), tags=list(cfg.wandb_tags), config=config
    )
    self._uploads = cfg.upload_model

  def write(self, report: IterationReport) -> None:
    """Log all scalars of one iteration in one call."""
    self._run.log(report.scalars, step=report.iteration)

  def save_file(self, path: Path) -> None:
    """Upload a checkpoint, where the configuration wants that."""
    if self._uploads:
      self._run.save(str(path), base_path=str(path.parent))

  def close(self) -> None:
    """End the run."""
    self._run.finish()


def open_logs(directory: Path, cfg: RslRlBaseRunnerCfg, config: dict[str, Any]) -> list[ScalarLog]:
  """The logs a run writes: always progress.csv, and what `cfg.logger` asks for."""
  logs: list[ScalarLog] = [CsvLog(directory / "progress.csv")]
  if cfg.logger == "wandb":
    logs.append(WandbLog(directory, cfg, config))
  if cfg.logger in ("tensorboard", "wandb"):
    logs.append(TensorboardLog(directory))
  return logs
