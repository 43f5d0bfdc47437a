"""The base of all actuators: what is configured, what is computed, and how groups of one law become one computation."""

import math
from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import mujoco
import torch
from mjlab_core.buffers import DelayBuffer
from mjlab_core.names import match_names, match_values, match_values_full
from mjlab_core.state import Stateful

from mjlab_actuators.command import COMMAND_FIELDS, ActuatorCmd, CommandField

PerTarget = float | Mapping[str, float]
"""One number for all targets, or numbers by pattern (full match; every target by exactly one pattern)."""


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
  target_names: tuple[str, ...]
  """One name per column; a name appears twice when two elements of a wrapped MJCF act on one joint."""
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

  def reordered(self, order: Sequence[int]) -> "ActuatorGroup":
    """The same group with column i taken from column `order[i]`."""
    return replace(
      self,
      target_names=tuple(self.target_names[i] for i in order),
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
        target_names=tuple(name for group in members for name in group.target_names),
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


@dataclass(kw_only=True)
class ActuatorCfg(ABC):
  """What all actuators are configured with."""

  target_names_expr: tuple[str, ...]
  """Patterns of the driven joints (full match)."""
  armature: PerTarget | None = None
  """Reflected rotor inertia written on the joint [kg or kg m^2]; None, or no matching pattern, keeps the MJCF's."""
  frictionloss: PerTarget | None = None
  """Dry friction written on the joint [N or N m]; None, or no matching pattern, keeps the MJCF's."""
  viscous_damping: PerTarget | None = None
  """Linear passive damping written on the joint [N s/m or N m s/rad]; None, or no match, keeps the MJCF's."""
  delay_min_lag: int = 0
  """Least lag of the set-points [substeps]."""
  delay_max_lag: int = 0
  """Greatest lag of the set-points [substeps]; 0 means no delay. Each world draws its lag uniformly from min to max."""
  delay_hold_prob: float = 0.0
  """Probability that a due redraw keeps the old lag."""
  delay_update_period: int = 0
  """Substeps between redraws of the lag; see `mjlab_core.buffers.DelayBuffer`."""

  command_fields: ClassVar[tuple[CommandField, ...]] = COMMAND_FIELDS
  """Set-points that the law reads."""

  @property
  @abstractmethod
  def law(self) -> type[Actuator]:
    """The runtime class."""

  def match(self, candidates: Sequence[str], owner: str = "") -> list[str]:
    """The driven joints among `candidates`, in the candidates' order.

    Raises:
      NameMatchError: A pattern matches nothing, or two patterns match one name.
    """
    return match_names(self.target_names_expr, candidates, what="joint", owner=owner)[1]

  def edit_spec(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    """Writes joint properties, and adds one MuJoCo actuator per target, named like it.

    Raises:
      ValueError: A number is negative or not finite, a delay is inverted, or an element of that name exists.
    """
    self.validate(target_names)
    joints = {joint.name: joint for joint in spec.joints}
    for attribute, values in (
      ("armature", self.armature),
      ("frictionloss", self.frictionloss),
      ("viscous_damping", self.viscous_damping),
    ):
      for name, value in self._overrides(attribute, values, target_names).items():
        if attribute == "viscous_damping":
          joints[name].damping[0] = value
        else:
          setattr(joints[name], attribute, value)
    self._add_elements(spec, target_names)

  def validate(self, target_names: Sequence[str]) -> None:
    """Refuses impossible numbers by name.

    Raises:
      ValueError: What is wrong, at which joint.
    """
    kind = type(self).__name__
    for name in ("delay_min_lag", "delay_max_lag", "delay_update_period"):
      value = getattr(self, name)
      if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{kind}: {name} is {value!r}; it must be a whole number of substeps, 0 or more")
    if self.delay_min_lag > self.delay_max_lag:
      raise ValueError(f"{kind}: delay_min_lag {self.delay_min_lag} exceeds delay_max_lag {self.delay_max_lag}")
    if not 0.0 <= self.delay_hold_prob <= 1.0:
      raise ValueError(f"{kind}: delay_hold_prob is {self.delay_hold_prob}; it must lie in [0, 1]")
    for name in ("armature", "frictionloss", "viscous_damping"):
      self._overrides(name, getattr(self, name), target_names)
    self.parameters(target_names)

  def parameters(self, target_names: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Constants that the runtime law needs, one number per target each."""
    return {}

  def groups(self, model: mujoco.MjModel, target_names: Sequence[str], prefix: str = "") -> list[ActuatorGroup]:
    """What this config drives in a compiled model, with the ctrl index of each target looked up by name.

    Raises:
      ValueError: The model has no actuator named like a target: `edit_spec` was not called before it was compiled.
    """
    ctrl_ids = []
    for name in target_names:
      index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, prefix + name)
      if index < 0:
        raise ValueError(
          f"{type(self).__name__}: the model has no actuator {prefix + name!r}; call edit_spec before it is compiled"
        )
      ctrl_ids.append(int(model.actuator_ctrladr[index]))
    return [self._group(target_names, ctrl_ids)]

  def build(
    self,
    *,
    target_names: Sequence[str],
    num_envs: int,
    device: torch.device | str,
    dtype: torch.dtype,
    generator: torch.Generator | None = None,
  ) -> Actuator:
    """The law alone, for n = len(target_names) targets; `ActuatorSet` is for a whole model."""
    self.validate(target_names)
    return self.law(self._group(target_names, ()), num_envs=num_envs, device=device, dtype=dtype, generator=generator)

  @property
  def delay(self) -> DelaySettings:
    return DelaySettings(
      min_lag=self.delay_min_lag,
      max_lag=self.delay_max_lag,
      hold_prob=self.delay_hold_prob,
      update_period=self.delay_update_period,
    )

  @property
  def settings(self) -> Hashable:
    """What the law needs to know beside numbers; configs that differ in it are different computations."""
    return None

  @abstractmethod
  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    """Adds this law's MuJoCo actuators."""

  def _group(self, target_names: Sequence[str], ctrl_ids: Sequence[int]) -> ActuatorGroup:
    return ActuatorGroup(
      law=self.law,
      target_names=tuple(target_names),
      command_fields=self.command_fields,
      parameters=self.parameters(target_names),
      delay=self.delay,
      ctrl_ids=tuple(ctrl_ids),
      settings=self.settings,
    )

  def _numbers(self, name: str, target_names: Sequence[str]) -> tuple[float, ...]:
    """The field `name` for each target, checked to be finite and not negative."""
    values = match_values_full(getattr(self, name), target_names, what="joint", owner=f"{type(self).__name__}.{name}")
    for target, value in zip(target_names, values, strict=True):
      self._check(name, target, value)
    return tuple(float(value) for value in values)

  def _positives(self, name: str, target_names: Sequence[str]) -> tuple[float, ...]:
    """The field `name` for each target, checked to be finite and positive."""
    values = self._numbers(name, target_names)
    for target, value in zip(target_names, values, strict=True):
      if value == 0.0:
        raise ValueError(f"{type(self).__name__}: {name} of joint {target!r} is 0; it must be positive")
    return values

  def _limits(self, name: str, target_names: Sequence[str]) -> tuple[float, ...]:
    """The effort limit `name` for each target, positive; infinity where there is none."""
    value = getattr(self, name)
    if value is None:
      return (math.inf,) * len(target_names)
    values = match_values_full(value, target_names, what="joint", owner=f"{type(self).__name__}.{name}")
    for target, limit in zip(target_names, values, strict=True):
      if not limit > 0.0:
        raise ValueError(
          f"{type(self).__name__}: {name} of joint {target!r} is {limit}; it must be positive, or None for no limit"
        )
    return tuple(float(limit) for limit in values)

  def _overrides(self, name: str, values: PerTarget | None, target_names: Sequence[str]) -> dict[str, float]:
    if values is None:
      return {}
    if isinstance(values, Mapping):
      _, names, numbers = match_values(values, target_names, what="joint", owner=f"{type(self).__name__}.{name}")
      chosen: dict[str, float] = dict(zip(names, numbers, strict=True))
    else:
      chosen = dict.fromkeys(target_names, values)
    for target, value in chosen.items():
      self._check(name, target, value)
    return chosen

  def _check(self, name: str, target: str, value: float) -> None:
    if not (math.isfinite(value) and value >= 0.0):
      raise ValueError(
        f"{type(self).__name__}: {name} of joint {target!r} is {value}; it must be finite and not negative"
      )


def add_joint_element(spec: mujoco.MjSpec, owner: str, target: str) -> mujoco.MjsActuator:
  """A joint actuator named like its target, free of everything that the MJCF's default classes would put on it.

  Raises:
    ValueError: An actuator of that name exists already.
  """
  if any(actuator.name == target for actuator in spec.actuators):
    raise ValueError(
      f"{owner}: joint {target!r} already has an actuator of that name; drive each joint by one config "
      "(XmlActuatorCfg keeps the MJCF's own actuator)"
    )
  element = spec.add_actuator(name=target, target=target, trntype=mujoco.mjtTrn.mjTRN_JOINT)
  element.set_to_motor()
  element.dyntype = mujoco.mjtDyn.mjDYN_NONE
  element.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  element.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
  element.ctrlrange = [0.0, 0.0]
  element.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
  element.forcerange = [0.0, 0.0]
  element.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
  element.actrange = [0.0, 0.0]
  element.inheritrange = 0.0
  # MuJoCo can delay, damp and add inertia in the actuator itself; here those belong to the config's own fields.
  element.delay = 0.0
  element.nsample = 0
  element.armature = 0.0
  element.damping = [0.0, 0.0, 0.0]
  return element


def limit_force(element: mujoco.MjsActuator, effort_limit: float) -> None:
  """Clamps the element's force to +-effort_limit inside MuJoCo; infinity leaves it free."""
  if math.isfinite(effort_limit):
    element.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    element.forcerange = [-effort_limit, effort_limit]
