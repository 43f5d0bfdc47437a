"""`train-actuator RECORDS ... [flags]`: fit a network to records of a motor, for `LearnedMlpActuatorCfg`."""

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mjlab_core import UsageError

from mjlab.cli._sysid import describe_records
from mjlab.cli.shared._command_line import CommandLine, CommonArguments, output_file
from mjlab.cli.shared._progress import progress_bar, stop_on_ctrl_c

if TYPE_CHECKING:
  from mjlab_sysid import FitProgress, MotorFit


@dataclasses.dataclass(kw_only=True)
class Arguments(CommonArguments):
  """All that can be given after the records."""

  output: str | None = None
  """File of the network; None: that of the first records, with suffix .pt."""
  plot: str | None = None
  """Picture of errors and efforts; None: that of the network, with suffix .png."""
  force: bool = False
  """Overwrite existing files."""
  joints: str = ".*"
  """Pattern of the joints whose motors the network stands for."""
  history_length: int = 3
  """Samples of position error and velocity that the network reads, with the present one; longer than the motor's
  delay."""
  hidden: tuple[int, ...] = (32, 32)
  """Widths of the hidden layers."""
  activation: Literal["softsign", "elu", "relu", "tanh"] = "softsign"
  """Activation function between the layers."""
  epochs: int = 100
  """Passes over the records."""
  batch_size: int = 128
  """Samples in one step of Adam."""
  learning_rate: float = 1e-2
  """Initial learning rate; it falls to zero along a cosine."""
  held_out: float = 0.2
  """Share at the end of each segment that is not trained on."""
  seed: int = 0
  """Seed of the initial weights and of the order of samples."""


@CommandLine(
  "train-actuator",
  "RECORD [RECORD ...]",
  Arguments,
  notes="""\
records are .csv, .npz or .mcap files (docs/sysid.md); of each joint the command reads
  position_target, position [rad or m], velocity [rad/s or m/s], and effort [N m or N]: that of the motor from this
  row to the next. The network is used at the period of the first record.
""",
)
def run(wanted: Arguments, records: list[str]) -> int:
  """Fit a network to the effort of a motor, from records of its commands and responses.

  Write a file for LearnedMlpActuatorCfg. Ctrl-C ends the training after the current epoch and writes the network; a
  second Ctrl-C writes nothing.
  """
  output = Path(wanted.output or Path(records[0]).with_suffix(".pt"))
  plot = Path(wanted.plot or output.parent / f"{output.stem}.png")
  for flag, path in (("--output", output), ("--plot", plot)):
    if path in map(Path, records):
      raise UsageError(f"{flag}: {path} is one of the records")
    output_file(flag, path, force=wanted.force)
  from mjlab_sysid import MotorFitCfg, fit_motor, read_records

  found = read_records(records)
  describe_records(found)
  cfg = MotorFitCfg(**{field.name: getattr(wanted, field.name) for field in dataclasses.fields(MotorFitCfg)})
  with progress_bar("training", cfg.epochs) as show_progress, stop_on_ctrl_c() as stopped:

    def show(seen: "FitProgress") -> bool:
      show_progress(seen.epoch, f"error: train {seen.train_error:.4g}, held out {seen.held_out_error:.4g}")
      return bool(stopped)

    fit = fit_motor(found, cfg, show)
  _report(fit, cfg.epochs)
  fit.save(output)
  print(f"network: {output}")
  fit.save_plot(plot)
  print(f"plot: {plot}")
  print(f"use it as: {fit.config(output)}")
  return 0


def _report(fit: "MotorFit", epochs: int) -> None:
  done = fit.curve[-1].epoch
  if done < epochs:
    print(f"stopped (Ctrl-C) after {done} of {epochs} epochs")
  stiffness, damping = fit.pd_gains
  print("root mean square error of the effort [N or N m]:")
  print(f"  network   train {fit.train_error:.4g}, held out {fit.held_out_error:.4g}")
  print(f"  best PD   held out {fit.pd_error:.4g} (stiffness {stiffness:.4g}, damping {damping:.4g})")
  motor = fit.motor
  words = [f"stiffness {motor.stiffness:.4g}", f"damping {motor.damping:.4g}"]
  words += [f"delay {motor.delay * fit.period:.3g} s", f"friction {motor.friction:.3g}"]
  limits = {name: getattr(motor, name) for name in ("effort_limit", "saturation_effort", "velocity_limit")}
  words += [f"{name} {value:.4g}" for name, value in limits.items() if math.isfinite(value)]
  print(f"  motor     held out {fit.motor_error:.4g} ({', '.join(words)})")
