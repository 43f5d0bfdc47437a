"""Base of all actuator models, and the fusion of groups of one model into one computation."""

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple, get_args

import torch
from mjlab_core import DelayBuffer, Stateful, check_name

from mjlab_actuators.transmission import Target

CommandField = Literal["position_target", "velocity_target", "effort_target"]
"""One of the three targets of a joint, tendon or site."""

COMMAND_FIELDS: tuple[CommandField, ...] = get_args(CommandField)


@dataclass(slots=True)
class ActuatorCmd:
  """Targets and measurements of n joints, tendons or sites, one column each.

  Lengths are those of the target: metres for slides, radians for hinges; efforts are newtons or newton metres.
  """

  position_target: torch.Tensor
  """Wanted position, (num_envs, n) [m or rad]."""
  velocity_target: torch.Tensor
  """Wanted velocity, (num_envs, n) [m/s or rad/s]."""
  effort_target: torch.Tensor
  """Feed-forward effort, (num_envs, n) [N or N m]."""
  position: torch.Tensor
  """Measured position, (num_envs, n) [m or rad]."""
  velocity: torch.Tensor
  """Measured velocity, (num_envs, n) [m/s or rad/s]."""


class Column(NamedTuple):
  """Target that an actuator model drives, before any tensor exists."""

  target: Target
  """Joint, tendon or site; it has two columns if two elements of a wrapped MJCF act on it."""
  parameters: Mapping[str, float]
  """Constants of the actuator model."""
  ctrl: int = -1
  """Index into the model's ctrl; -1 without a MuJoCo model."""
  gear: float = 1.0
  """Gear between target and ctrl, for targets that pass unchanged."""


@dataclass(frozen=True, kw_only=True)
class ActuatorGroup:
  """Columns that one actuator model computes; `fuse` joins groups with equal `key`."""

  actuator_model: type["Actuator"]
  """The runtime class."""
  command_fields: tuple[CommandField, ...]
  """Targets that the actuator model reads; these, and never the measurements, are delayed."""
  settings: Mapping[str, Hashable]
  """Options of the actuator model that are the same for all columns."""
  columns: tuple[Column, ...]
  """Targets in their order."""

  @property
  def key(self) -> tuple[object, ...]:
    """Key of fusion: groups of one key are one computation."""
    return (self.actuator_model, self.command_fields, tuple(self.settings.items()), self.parameter_names)

  @property
  def parameter_names(self) -> tuple[str, ...]:
    """Names of the constants."""
    return tuple(self.columns[0].parameters) if self.columns else ()

  @property
  def target_names(self) -> tuple[str, ...]:
    """Names of the targets."""
    return tuple(column.target.name for column in self.columns)


def fuse(groups: Sequence[ActuatorGroup]) -> list[ActuatorGroup]:
  """Return one group per actuator model and settings; columns keep the order in which they are given.

  This happens before tensors and delay buffers are made, so nothing is allocated twice and models with memory fuse too.
  """
  by_key: dict[tuple[object, ...], list[ActuatorGroup]] = {}
  for group in groups:
    by_key.setdefault(group.key, []).append(group)
  return [
    replace(members[0], columns=tuple(column for group in members for column in group.columns))
    for members in by_key.values()
  ]


class Actuator(Stateful, ABC):
  """Actuator model: computes ctrl of all its targets in all worlds from targets and measurements.

  Subclasses implement `compute` by the rules of the captured step: fixed memory, masks, no host reads. Their settings
  and parameters arrive as attributes of the same names; parameters are (1, n), or (num_envs, n) after `expand`.
  """

  needs_feedback: ClassVar[bool] = True
  """True if `compute` reads `position` and `velocity`."""

  effort_limits: ClassVar[tuple[str, ...]] = ("effort_limit",)
  """Parameters that bound the effort; a model may lack some of them."""

  delay: DelayBuffer | None
  """Memory of delayed targets; None without delay."""
  delay_min_lag: int
  """Least lag of the targets [substeps]."""
  delay_max_lag: int
  """Greatest lag of the targets [substeps]."""
  delay_hold_prob: float
  """Probability that a due redraw keeps the old lag."""
  delay_update_period: int
  """Substeps between redraws of the lag."""

  def __init__(
    self,
    group: ActuatorGroup,
    *,
    num_envs: int,
    device: torch.device | str,
    dtype: torch.dtype,
    generator: torch.Generator | None = None,
  ) -> None:
    self.num_envs, self.device, self.dtype = num_envs, torch.device(device), dtype
    self.group = group
    self.target_names = group.target_names
    self._expanded: set[str] = set()
    for name, setting in group.settings.items():
      setattr(self, name, setting)
    for name in group.parameter_names:
      setattr(self, name, self.nominal(name))
    self.delay = None
    if self.delay_max_lag > 0:
      fields, width = len(group.command_fields), len(group.columns)
      self.delay = DelayBuffer(
        self.delay_min_lag,
        self.delay_max_lag,
        num_envs,
        (fields, width) if fields > 1 else (width,),
        device,
        dtype,
        generator,
        hold_prob=self.delay_hold_prob,
        update_period=self.delay_update_period,
      )

  @abstractmethod
  def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
    """Return ctrl of this substep, (num_envs, n); advance the delay by exactly one substep."""

  def reset(self, mask: torch.Tensor, cmd: ActuatorCmd) -> None:
    """Forget earlier targets: fill the whole delay of masked worlds with the targets of `cmd`.

    Args:
      mask: Worlds to reset, (num_envs,) bool. All others stay bit-identical.
      cmd: Targets to start from, in all worlds; measurements are not read.
    """
    if self.delay is not None:
      self.delay.fill(mask, self._stacked(cmd))

  def expand(self, name: str) -> torch.Tensor:
    """Return the parameter `name` with one row per world, (num_envs, n), to be written in place.

    Call it before the step is recorded: the first call replaces the tensor.

    Raises:
      MjlabError: This actuator model has no such parameter.
    """
    self._check(name)
    if name not in self._expanded:
      self._expanded.add(name)
      values: torch.Tensor = getattr(self, name)
      setattr(self, name, self.state_of(values.repeat(self.num_envs // values.shape[0], 1)))
    return getattr(self, name)

  def nominal(self, name: str) -> torch.Tensor:
    """Return the configured value of the parameter `name`, (1, n), which writes do not change.

    Raises:
      MjlabError: This actuator model has no such parameter.
    """
    self._check(name)
    numbers = [column.parameters[name] for column in self.group.columns]
    return torch.tensor([numbers], device=self.device, dtype=self.dtype)

  def _check(self, name: str) -> None:
    check_name("parameter", name, self.group.parameter_names, type(self).__name__)

  def _stacked(self, cmd: ActuatorCmd) -> torch.Tensor:
    fields = [getattr(cmd, field) for field in self.group.command_fields]
    return fields[0] if len(fields) == 1 else torch.stack(fields, dim=1)

  def _delayed_targets(self, cmd: ActuatorCmd) -> tuple[torch.Tensor, ...]:
    """Return the targets named by `command_fields`, delayed as configured, (num_envs, n) each. Call once a substep."""
    if self.delay is None:
      return tuple(getattr(cmd, field) for field in self.group.command_fields)
    late = self.delay.push(self._stacked(cmd))
    return (late,) if len(self.group.command_fields) == 1 else late.unbind(1)
