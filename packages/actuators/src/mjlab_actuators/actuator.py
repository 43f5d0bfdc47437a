"""Base of all actuator models, and the columns that a model computes."""

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
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
  """Target and ctrl that an actuator model connects, before any tensor exists."""

  target: Target
  """Joint, tendon or site; it has a column for each input of each of its actuators."""
  element: int
  """Id of the actuator in the compiled model."""
  ctrl: int
  """Index into the model's ctrl."""
  parameters: Mapping[str, float]
  """Constants of the actuator model."""


class ActuatorGroup(NamedTuple):
  """Key of the columns that one actuator model computes together, whatever configs they come from."""

  actuator_model: type["Actuator"]
  """The runtime class."""
  command_fields: tuple[CommandField, ...]
  """Targets that the actuator model reads; these, and never the measurements, are delayed."""
  settings: tuple[tuple[str, Hashable], ...]
  """Options of the actuator model by name, the same for all columns."""
  parameter_names: tuple[str, ...]
  """Names of the constants."""


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
    columns: Sequence[Column],
    *,
    num_envs: int,
    device: torch.device | str,
    dtype: torch.dtype,
    generator: torch.Generator | None = None,
  ) -> None:
    self.num_envs, self.device, self.dtype = num_envs, torch.device(device), dtype
    self.group, self.columns = group, tuple(columns)
    self.target_names = tuple(column.target.name for column in columns)
    self._expanded: set[str] = set()
    for name, setting in group.settings:
      setattr(self, name, setting)
    for name in group.parameter_names:
      setattr(self, name, self.nominal(name))
    self.delay = None
    if self.delay_max_lag > 0:
      fields, width = len(group.command_fields), len(columns)
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
    check_name("parameter", name, self.group.parameter_names, type(self).__name__)
    if name not in self._expanded:
      self._expanded.add(name)
      setattr(self, name, self.state_of(getattr(self, name).repeat(self.num_envs, 1)))
    return getattr(self, name)

  def nominal(self, name: str) -> torch.Tensor:
    """Return the configured value of the parameter `name`, (1, n), which writes do not change."""
    numbers = [column.parameters[name] for column in self.columns]
    return torch.tensor([numbers], device=self.device, dtype=self.dtype)

  def _stacked(self, cmd: ActuatorCmd) -> torch.Tensor:
    fields = [getattr(cmd, field) for field in self.group.command_fields]
    return fields[0] if len(fields) == 1 else torch.stack(fields, dim=1)

  def _delayed_targets(self, cmd: ActuatorCmd) -> tuple[torch.Tensor, ...]:
    """Return the targets named by `command_fields`, delayed as configured, (num_envs, n) each. Call once a substep."""
    if self.delay is None:
      return tuple(getattr(cmd, field) for field in self.group.command_fields)
    late = self.delay.push(self._stacked(cmd))
    return (late,) if len(self.group.command_fields) == 1 else late.unbind(1)
