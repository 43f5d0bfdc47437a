"""Base of all actuator models, and the fusion of groups of one model into one computation."""

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import torch
from mjlab_core import DelayBuffer, Stateful, check_name

from mjlab_actuators.transmission import Target

CommandField = Literal["position_target", "velocity_target", "effort_target"]
"""One of the three targets of a joint, tendon or site."""

COMMAND_FIELDS: tuple[CommandField, ...] = ("position_target", "velocity_target", "effort_target")


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


@dataclass(frozen=True, kw_only=True)
class DelaySettings:
  """Delay of targets, in physics substeps."""

  min_lag: int = 0
  max_lag: int = 0
  hold_prob: float = 0.0
  update_period: int = 0


@dataclass(frozen=True, kw_only=True)
class ActuatorGroup:
  """Targets that one actuator model drives, before any tensor exists; `fuse` joins groups with equal `key`."""

  actuator_model: type["Actuator"]
  """The runtime class."""
  targets: tuple[Target, ...]
  """One per column; a target appears twice when two elements of a wrapped MJCF act on one joint."""
  command_fields: tuple[CommandField, ...]
  """Targets that the actuator model reads; these, and never the measurements, are delayed."""
  parameters: Mapping[str, tuple[float, ...]]
  """Constants of the actuator model, one number per column each."""
  delay: DelaySettings = DelaySettings()
  ctrl_ids: tuple[int, ...] = ()
  """Model ctrl index of each column; empty without a MuJoCo model."""
  settings: Hashable = None
  """Options of the actuator model that are not numbers per column."""

  @property
  def key(self) -> tuple[object, ...]:
    """Groups that agree in this are one computation."""
    return (self.actuator_model, self.command_fields, self.delay, tuple(self.parameters), self.settings)

  @property
  def target_names(self) -> tuple[str, ...]:
    """Names of the targets."""
    return tuple(target.name for target in self.targets)

  def reordered(self, order: Sequence[int]) -> "ActuatorGroup":
    """Return the same group with column i taken from column `order[i]`."""
    return replace(
      self,
      targets=tuple(self.targets[i] for i in order),
      parameters={name: tuple(values[i] for i in order) for name, values in self.parameters.items()},
      ctrl_ids=tuple(self.ctrl_ids[i] for i in order) if self.ctrl_ids else (),
    )


def fuse(groups: Sequence[ActuatorGroup]) -> list[ActuatorGroup]:
  """Return one group per actuator model, settings and delay; columns keep the order in which they are given.

  This happens before tensors and delay buffers are made, so nothing is allocated twice and models with memory fuse too.
  """
  by_key: dict[tuple[object, ...], list[ActuatorGroup]] = {}
  for group in groups:
    by_key.setdefault(group.key, []).append(group)
  fused = []
  for members in by_key.values():
    first = members[0]
    fused.append(
      replace(
        first,
        targets=tuple(target for group in members for target in group.targets),
        parameters={
          name: tuple(value for group in members for value in group.parameters[name]) for name in first.parameters
        },
        ctrl_ids=tuple(index for group in members for index in group.ctrl_ids),
      )
    )
  return fused


class Actuator(Stateful, ABC):
  """Actuator model: from targets and measurements to ctrl, for all worlds and all its targets at once.

  Subclasses implement `compute` by the rules of the captured step: fixed memory, masks, no host reads. Their constants
  arrive as attributes named like the parameters, shaped (1, n), or (num_envs, n) after `expand`.
  """

  needs_feedback: ClassVar[bool] = True
  """True if `compute` reads `position` and `velocity`."""

  effort_limits: ClassVar[tuple[str, ...]] = ("effort_limit",)
  """Parameters that bound the effort, those that the model has."""

  delay: DelayBuffer | None
  """Memory of delayed targets; None without delay."""

  def __init__(
    self,
    group: ActuatorGroup,
    *,
    num_envs: int,
    device: torch.device | str,
    dtype: torch.dtype,
    generator: torch.Generator | None = None,
  ) -> None:
    self.num_envs, self.device = num_envs, torch.device(device)
    self.group = group
    self.target_names = group.target_names
    self._expanded: set[str] = set()
    for name, values in group.parameters.items():
      setattr(self, name, torch.tensor([values], device=device, dtype=dtype))
    settings = group.delay
    self.delay = None
    if settings.max_lag > 0:
      several = len(group.command_fields) > 1
      width = len(group.target_names)
      self.delay = DelayBuffer(
        settings.min_lag,
        settings.max_lag,
        num_envs,
        (len(group.command_fields), width) if several else (width,),
        device,
        dtype,
        generator,
        hold_prob=settings.hold_prob,
        update_period=settings.update_period,
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
    """Return the parameter `name` with one row per world, (num_envs, n), to be written in place from then on.

    Call it before the step is recorded: the first call replaces the tensor.

    Raises:
      MjlabError: This actuator model has no such parameter.
    """
    values = self._parameter(name)
    if name not in self._expanded:
      self._expanded.add(name)
      values = self.state_of(values.repeat(self.num_envs // values.shape[0], 1))
      setattr(self, name, values)
    return values

  def nominal(self, name: str) -> torch.Tensor:
    """Return the configured value of the parameter `name`, (1, n), whatever was written since.

    Raises:
      MjlabError: This actuator model has no such parameter.
    """
    values = self._parameter(name)
    return torch.tensor([self.group.parameters[name]], device=values.device, dtype=values.dtype)

  def _parameter(self, name: str) -> torch.Tensor:
    return getattr(self, check_name("parameter", name, self.group.parameters, type(self).__name__))

  def _stacked(self, cmd: ActuatorCmd) -> torch.Tensor:
    fields = [getattr(cmd, field) for field in self.group.command_fields]
    return fields[0] if len(fields) == 1 else torch.stack(fields, dim=1)

  def _delayed_targets(self, cmd: ActuatorCmd) -> tuple[torch.Tensor, ...]:
    """Return the targets named by `command_fields`, delayed as configured, (num_envs, n) each. Call once a substep."""
    if self.delay is None:
      return tuple(getattr(cmd, field) for field in self.group.command_fields)
    late = self.delay.push(self._stacked(cmd))
    return (late,) if len(self.group.command_fields) == 1 else late.unbind(1)
