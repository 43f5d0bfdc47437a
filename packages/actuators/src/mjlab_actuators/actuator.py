"""The base of all laws: what is computed, and how groups of one law become one computation."""

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from mjlab_core.buffers import DelayBuffer
from mjlab_core.state import Stateful

from mjlab_actuators.command import ActuatorCmd, CommandField
from mjlab_actuators.transmission import Target


@dataclass(frozen=True, kw_only=True)
class DelaySettings:
  """How late set-points arrive, in physics substeps."""

  min_lag: int = 0
  max_lag: int = 0
  hold_prob: float = 0.0
  update_period: int = 0


@dataclass(frozen=True, kw_only=True)
class ActuatorGroup:
  """Targets that one law drives, before any tensor exists. Groups with equal `key` are concatenated by `fuse`."""

  law: type["Actuator"]
  """The runtime class."""
  targets: tuple[Target, ...]
  """One per column; a target appears twice when two elements of a wrapped MJCF act on one joint."""
  command_fields: tuple[CommandField, ...]
  """Set-points that the law reads; these, and never the measurements, are delayed."""
  parameters: Mapping[str, tuple[float, ...]]
  """Constants of the law, one number per column each."""
  delay: DelaySettings = DelaySettings()
  ctrl_ids: tuple[int, ...] = ()
  """Model ctrl index of each column; empty for a law that is used without a model."""
  settings: Hashable = None
  """What the law needs to know beside numbers, alike for all columns."""

  @property
  def key(self) -> tuple[object, ...]:
    """Groups that agree in this are one computation."""
    return (self.law, self.command_fields, self.delay, tuple(self.parameters), self.settings)

  @property
  def target_names(self) -> tuple[str, ...]:
    """Names of the targets."""
    return tuple(target.name for target in self.targets)

  def reordered(self, order: Sequence[int]) -> "ActuatorGroup":
    """The same group with column i taken from column `order[i]`."""
    return replace(
      self,
      targets=tuple(self.targets[i] for i in order),
      parameters={name: tuple(values[i] for i in order) for name, values in self.parameters.items()},
      ctrl_ids=tuple(self.ctrl_ids[i] for i in order) if self.ctrl_ids else (),
    )


def fuse(groups: Sequence[ActuatorGroup]) -> list[ActuatorGroup]:
  """One group per law, its settings and its delay; columns keep the order in which they are given.

  This happens before tensors and delay buffers are made, so nothing is allocated twice and laws that remember something
  fuse as well as those that do not.
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
  """A law from set-points and measurements to ctrl, for all worlds and all its targets at once.

  Subclasses implement `compute` by the rules of the captured step: fixed memory, masks, no host reads. Their constants
  arrive as attributes named like the parameters, shaped (1, n), or (num_envs, n) after `expand`.
  """

  _children = ("delay",)

  needs_feedback: ClassVar[bool] = True
  """Whether `compute` reads `position` and `velocity`."""

  effort_limits: ClassVar[tuple[str, ...]] = ("effort_limit",)
  """Parameters that bound the effort, those that the law has."""

  delay: DelayBuffer | None
  """Memory of late set-points; None without delay."""

  def __init__(
    self,
    group: ActuatorGroup,
    *,
    num_envs: int,
    device: torch.device | str,
    dtype: torch.dtype,
    generator: torch.Generator | None = None,
  ) -> None:
    self.num_envs = num_envs
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
    """Ctrl of this substep, (num_envs, n); advances the delay by exactly one substep."""

  def reset(self, mask: torch.Tensor, cmd: ActuatorCmd) -> None:
    """Forgets what was commanded before: the whole delay of masked worlds becomes the set-points of `cmd`.

    Args:
      mask: Worlds to reset, (num_envs,) bool. All others stay bit-identical.
      cmd: Set-points to start from, in all worlds; measurements are not read.
    """
    if self.delay is not None:
      self.delay.fill(mask, self._stacked(cmd))

  def expand(self, name: str) -> torch.Tensor:
    """The parameter `name` with one row per world, (num_envs, n), to be written in place from then on.

    Belongs before the step is recorded: the first call replaces the tensor.

    Raises:
      ValueError: This law has no such parameter.
    """
    values = self._parameter(name)
    self._expanded.add(name)
    if values.shape[0] != self.num_envs:
      values = values.repeat(self.num_envs, 1)
      setattr(self, name, values)
    return values

  def nominal(self, name: str) -> torch.Tensor:
    """The configured value of the parameter `name`, (1, n), whatever was written since.

    Raises:
      ValueError: This law has no such parameter.
    """
    values = self._parameter(name)
    return torch.tensor([self.group.parameters[name]], device=values.device, dtype=values.dtype)

  def _state_tensors(self) -> dict[str, torch.Tensor]:
    # What was configured is no state, although with a single world it has one row per world.
    configured = self.group.parameters.keys() - self._expanded
    return {name: tensor for name, tensor in super()._state_tensors().items() if name not in configured}

  def _parameter(self, name: str) -> torch.Tensor:
    if name not in self.group.parameters:
      raise ValueError(
        f"{type(self).__name__}: parameter {name!r} does not exist; "
        f"this law has: {', '.join(self.group.parameters) or 'none'}"
      )
    return getattr(self, name)

  def _stacked(self, cmd: ActuatorCmd) -> torch.Tensor:
    fields = [getattr(cmd, field) for field in self.group.command_fields]
    return fields[0] if len(fields) == 1 else torch.stack(fields, dim=1)

  def _delayed_targets(self, cmd: ActuatorCmd) -> tuple[torch.Tensor, ...]:
    """The set-points named by `command_fields`, as late as configured, (num_envs, n) each. Call once a substep."""
    if self.delay is None:
      return tuple(getattr(cmd, field) for field in self.group.command_fields)
    late = self.delay.push(self._stacked(cmd))
    return (late,) if len(self.group.command_fields) == 1 else late.unbind(1)
