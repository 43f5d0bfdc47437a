"""Training of a network on records of a motor, for `mjlab_actuators.LearnedMlpActuatorCfg`."""

import copy
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from mjlab_actuators.models.network_file import ACTIVATIONS, Activation
from mjlab_core.constraints import Items, Limits, Positive, PositiveCount, check_fields
from mjlab_core.errors import MjlabError
from mjlab_core.io import figures
from mjlab_core.io.files import AtomicWrite

from mjlab_sysid.data.records import Record, uniform
from mjlab_sysid.motors.motor_model import MotorModel, fit_motor_model, fit_pd


@dataclass(kw_only=True)
class MotorFitCfg:
  """Settings of the network and of its training."""

  history_length: PositiveCount = 3
  """Samples of position error and velocity that the network sees, the present one included."""
  hidden: Annotated[tuple[int, ...], Items(), Limits(ge=1)] = (32, 32)
  """Widths of the hidden layers."""
  activation: Activation = "softsign"
  """Activation function between the layers."""
  epochs: PositiveCount = 100
  """Passes over the records."""
  batch_size: PositiveCount = 128
  """Samples of one step of Adam."""
  learning_rate: Positive = 1e-2
  """Initial learning rate; it falls to zero along a cosine."""
  held_out: Annotated[float, Limits(gt=0, lt=1)] = 0.2
  """Share at the end of each segment that is never trained on."""
  joints: str = ".*"
  """Pattern of the joints whose motors the network stands for."""
  seed: int = 0
  """Seed of the initial weights and of the order of samples."""

  def __post_init__(self) -> None:
    check_fields(self, "MotorFitCfg")


class FitProgress(NamedTuple):
  """Progress of a training after an epoch."""

  epoch: int
  """Epochs done."""
  train_error: float
  """Root mean square over the epoch [N or N m]."""
  held_out_error: float
  """Root mean square over the held-out samples [N or N m]."""


@dataclass(frozen=True, kw_only=True)
class MotorFit:
  """Trained network with its errors: root mean squares over samples [N or N m]."""

  cfg: MotorFitCfg
  period: float
  """Period of the samples [s]."""
  network: torch.nn.Sequential
  """Network from rows as `LearnedMlpActuatorCfg` describes them, with all scales one, to efforts [N or N m]."""
  curve: tuple[FitProgress, ...]
  """Errors after each epoch."""
  train_error: float
  held_out_error: float
  pd_error: float
  """Held-out error of the best ideal PD controller on the same records, for comparison."""
  pd_gains: tuple[float, float]
  """Stiffness and damping of that controller."""
  motor_error: float
  """Held-out error of the best parametric motor on the same records, for comparison."""
  motor: MotorModel
  """That motor: PD with delay, friction and torque-speed limits."""
  held_out: torch.Tensor
  """Efforts of the held-out samples, measured and of the network, (samples, 2) [N or N m]."""

  def save(self, path: str | Path) -> None:
    """Write the state dict that `LearnedMlpActuatorCfg.network_file` names; a file of that name is replaced whole."""
    # Given a name, torch reports a folder that cannot be written as a RuntimeError.
    with AtomicWrite(path) as temporary, temporary.open("wb") as file:
      torch.save(self.network.state_dict(), file)

  def save_plot(self, path: str | Path) -> None:
    """Draw errors over epochs and held-out efforts as a PNG; a file of that name is replaced whole.

    Raises:
      ModuleNotFoundError: matplotlib is not installed; the message says how to get it.
    """
    with figures.figure(path, (11.0, 3.6), package="mjlab-sysid", dpi=120) as drawn:
      self._plot(*drawn.subplots(1, 3))

  def _plot(self, errors: Any, efforts: Any, scatter: Any) -> None:
    epochs = [point.epoch for point in self.curve]
    errors.semilogy(epochs, [point.train_error for point in self.curve], label="train")
    errors.semilogy(epochs, [point.held_out_error for point in self.curve], label="held out")
    errors.axhline(self.pd_error, color="gray", linestyle="--", label="best PD controller, held out")
    errors.axhline(self.motor_error, color="black", linestyle=":", label="fitted motor, held out")
    errors.set(title="error (root mean square)", xlabel="epoch")
    errors.legend()
    measured, learned = self.held_out.numpy().T
    shown = slice(0, min(len(measured), 500))
    time = self.period * np.arange(len(measured))[shown]
    efforts.plot(time, measured[shown], label="measured", color="lightgray", linewidth=4.0)
    efforts.plot(time, learned[shown], label="learned", linewidth=1.0)
    efforts.set(title="held-out effort", xlabel="held-out time [s]")
    efforts.legend(loc="upper right")
    scatter.plot(measured, learned, ".", markersize=2.0)
    ends = [min(measured.min(), learned.min()), max(measured.max(), learned.max())]
    scatter.plot(ends, ends, color="black", linewidth=0.8)
    scatter.set(title="held-out effort", xlabel="measured", ylabel="learned")

  def config(self, network_file: str | Path) -> str:
    """Return the Python of a config that loads this network."""
    return (
      f"LearnedMlpActuatorCfg(target_names_expr=(...,), network_file={str(network_file)!r}, "
      f"history_length={self.cfg.history_length}, sample_period={self.period!r}, activation={self.cfg.activation!r})"
    )


def require_matplotlib() -> None:
  """Check that plots can be drawn.

  Raises:
    ModuleNotFoundError: matplotlib is not installed; the message says how to get it.
  """
  figures.require_matplotlib("mjlab-sysid")


def fit_motor(
  records: Sequence[Record],
  cfg: MotorFitCfg | None = None,
  on_epoch: Callable[[FitProgress], bool | None] | None = None,
) -> MotorFit:
  """Train a network to give the efforts of the records from the recent past of position errors and velocities.

  Windows never reach across segments, nor from held-out samples back into trained ones. The scales of inputs and
  outputs are folded into the first and last layer.

  Args:
    records: Position target, position, velocity and effort of the joints.
    cfg: Settings; None for the defaults.
    on_epoch: Function called after every epoch; a true result ends the training.

  Raises:
    MjlabError: A setting is impossible, a segment is too short, or the efforts never change.
  """
  cfg = MotorFitCfg() if cfg is None else cfg
  period, tables = _tables(records, cfg)
  trained, held = _split(tables, cfg)
  (x, y), (x_held, y_held) = (_samples(parts, cfg.history_length) for parts in (trained, held))
  if y.std() == 0.0:
    raise MjlabError("signal 'effort' never changes, so there is nothing to learn")
  result, curve = _trained((x, y), (x_held, y_held), cfg, on_epoch)
  first = cfg.history_length - 1
  motor, pd = fit_motor_model(trained, first), fit_pd(trained, first)
  with torch.no_grad():
    held_out = torch.stack((y_held, result(x_held)[:, 0]), dim=1)
  return MotorFit(
    cfg=cfg,
    period=period,
    network=result,
    curve=curve,
    train_error=_error(result, x, y),
    held_out_error=curve[-1].held_out_error,
    pd_error=pd.error(held, first),
    pd_gains=(pd.stiffness, pd.damping),
    motor_error=motor.error(held, first),
    motor=motor,
    held_out=held_out,
  )


Samples = tuple[torch.Tensor, torch.Tensor]


def _tables(records: Sequence[Record], cfg: MotorFitCfg) -> tuple[float, list[np.ndarray]]:
  """Return the period, and one table (rows, 4) for each joint and stretch: target, position, velocity, effort."""
  period, tables = records[0].period, []
  for record in records:
    for part in uniform(record.select(cfg.joints), period):
      columns = [part.of(name, part.joints) for name in ("position_target", "position", "velocity", "effort")]
      tables += list(np.stack(columns, 2).swapaxes(0, 1))
  return period, tables


def _split(tables: Sequence[np.ndarray], cfg: MotorFitCfg) -> tuple[list[np.ndarray], list[np.ndarray]]:
  """Return the parts of tables to train on, and those held out."""
  trained, held = [], []
  for index, segment in enumerate(tables):
    begin = len(segment) - round(cfg.held_out * len(segment))
    for part, parts in ((segment[:begin], trained), (segment[begin:], held)):
      if len(part) < cfg.history_length:
        needed = f"both parts, by held_out {cfg.held_out}, need history_length {cfg.history_length} or more"
        raise MjlabError(f"stretch {index + 1} of {len(tables)} has {len(segment)} rows; {needed}")
      parts.append(part)
  return trained, held


def _samples(parts: Sequence[np.ndarray], length: int) -> Samples:
  """Return rows (samples, 2 length), errors newest first and then velocities newest first, and efforts (samples,)."""
  tables = []
  for rows in parts:
    series = np.stack((rows[:, 0] - rows[:, 1], rows[:, 2]))
    past = np.lib.stride_tricks.sliding_window_view(series, length, axis=1)[..., ::-1]
    tables.append(np.concatenate((*past, rows[length - 1 :, 3:]), axis=1))
  table = torch.tensor(np.concatenate(tables), dtype=torch.float32)
  return table[:, :-1], table[:, -1]


def _trained(
  samples: Samples, held: Samples, cfg: MotorFitCfg, on_epoch: Callable[[FitProgress], bool | None] | None
) -> tuple[torch.nn.Sequential, tuple[FitProgress, ...]]:
  """Return the trained network for rows and efforts in their own units, and its errors after each epoch."""
  x, y = samples
  generator = torch.Generator().manual_seed(cfg.seed)
  standard = _Standard.of(x, y, cfg.history_length)
  inputs, wanted = x @ standard.inputs.T - standard.center, (y - standard.effort_center) / standard.effort_scale
  network = _network(cfg, generator)
  optimizer = torch.optim.Adam(network.parameters(), lr=cfg.learning_rate)
  schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, cfg.epochs)
  result, curve = network, []
  for epoch in range(1, cfg.epochs + 1):
    squares = 0.0
    with _one_thread():
      for rows in torch.randperm(len(x), generator=generator).split(cfg.batch_size):
        loss = (network(inputs[rows])[:, 0] - wanted[rows]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        squares += loss.item() * len(rows)
    schedule.step()
    result = standard.folded_into(network)
    train_error = (squares / len(x)) ** 0.5 * standard.effort_scale.item()
    curve.append(FitProgress(epoch, train_error, _error(result, *held)))
    if on_epoch is not None and on_epoch(curve[-1]):
      break
  return result, tuple(curve)


def _network(cfg: MotorFitCfg, generator: torch.Generator) -> torch.nn.Sequential:
  widths = (2 * cfg.history_length, *cfg.hidden, 1)
  layers: list[torch.nn.Module] = []
  for inputs, outputs in pairwise(widths):
    layer = torch.nn.Linear(inputs, outputs)
    bound = inputs**-0.5
    with torch.no_grad():
      for parameter in layer.parameters():
        parameter.uniform_(-bound, bound, generator=generator)
    layers += [layer, ACTIVATIONS[cfg.activation]()]
  return torch.nn.Sequential(*layers[:-1])


class _Standard(NamedTuple):
  """Linear map to the inputs and outputs of training: differences of samples close in time, which matter, are small."""

  inputs: torch.Tensor
  """From rows to the newest sample and the differences between successive ones, of unit variance each."""
  center: torch.Tensor
  effort_center: torch.Tensor
  effort_scale: torch.Tensor

  @staticmethod
  def of(x: torch.Tensor, y: torch.Tensor, length: int) -> "_Standard":
    older = torch.arange(2 * length) % length > 0
    differences = torch.eye(2 * length) - torch.diag(torch.ones(2 * length - 1), -1) * older[:, None]
    scale = (x @ differences.T).std(0).clamp(min=1e-9)
    inputs = differences / scale[:, None]
    return _Standard(inputs, inputs @ x.mean(0), y.mean(), y.std())

  def folded_into(self, network: torch.nn.Sequential) -> torch.nn.Sequential:
    """Return the network for rows and efforts in their own units."""
    result = copy.deepcopy(network)
    first, last = result[0], result[-1]
    assert isinstance(first, torch.nn.Linear)
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
      first.bias.sub_(first.weight @ self.center)
      first.weight.copy_(first.weight @ self.inputs)
      last.weight.mul_(self.effort_scale)
      last.bias.mul_(self.effort_scale).add_(self.effort_center)
    return result.eval().requires_grad_(False)


def _error(network: torch.nn.Module, x: torch.Tensor, y: torch.Tensor) -> float:
  with torch.no_grad():
    return (network(x)[:, 0] - y).square().mean().sqrt().item()


@contextmanager
def _one_thread() -> Generator[None, None, None]:
  """Use one thread, because for tiny matrices a second one would only wait."""
  before = torch.get_num_threads()
  torch.set_num_threads(1)
  try:
    yield
  finally:
    torch.set_num_threads(before)
