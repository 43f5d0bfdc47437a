"""The base of all configs: what every actuator is told, checked by name, and written into an MjSpec."""

import math
from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import ClassVar, TypeVar

import mujoco
import torch
from mjlab_core.names import match_names, match_values, match_values_full, unknown

from mjlab_actuators.actuator import Actuator, ActuatorGroup, DelaySettings
from mjlab_actuators.command import COMMAND_FIELDS, CommandField
from mjlab_actuators.transmission import (
  TRANSMISSIONS,
  SiteGear,
  Target,
  Transmission,
  actuators_of,
  add_element,
  targets_of,
)

T = TypeVar("T")

PerTarget = float | Mapping[str, float]
"""One number for all targets, or numbers by pattern (full match; every target by exactly one pattern)."""


def is_zero(values: PerTarget) -> bool:
  """Whether a number is zero for all targets."""
  return not any(values.values()) if isinstance(values, Mapping) else values == 0.0


@dataclass(kw_only=True)
class ActuatorCfg(ABC):
  """What all actuators are configured with."""

  target_names_expr: tuple[str, ...]
  """Patterns of what is driven (full match): names of joints, tendons or sites, as `transmission_type` says."""
  transmission_type: Transmission = "joint"
  """Whether `target_names_expr` names joints, tendons or sites.

  Positions and velocities are then those of the joint, the length of the tendon, or of the site along `site_gear`; the
  effort acts on the joint, along the tendon, or as a wrench at the site."""
  site_gear: SiteGear | Mapping[str, SiteGear] | None = None
  """For sites, required there: wrench of a unit effort, force x, y, z [1] then torque x, y, z [m], in the frame of the
  site, or of `refsite`. One for all, or by pattern."""
  refsite: str | None = None
  """For sites: name of the site that positions and velocities are relative to. Without it there is a velocity, but no
  position, and laws that read one are refused."""
  armature: PerTarget | None = None
  """Reflected rotor inertia written on joint or tendon [kg or kg m^2]; None, or no match, keeps the MJCF's."""
  frictionloss: PerTarget | None = None
  """Dry friction written on joint or tendon [N or N m]; None, or no match, keeps the MJCF's."""
  viscous_damping: PerTarget | None = None
  """Linear passive damping written on joint or tendon [N s/m or N m s/rad]; None, or no match, keeps the MJCF's."""
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
    """What is driven among `candidates`, in the candidates' order.

    Raises:
      NameMatchError: A pattern matches nothing, or two patterns match one name.
    """
    self._check_transmission()
    return match_names(self.target_names_expr, candidates, what=self.transmission_type, owner=owner)[1]

  def edit_spec(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    """Writes joint or tendon properties, and adds one MuJoCo actuator per target, named like it.

    Raises:
      ValueError: A number is negative or not finite, a delay is inverted, an element of that name exists, or the
        transmission lacks what the law needs.
    """
    self.validate(target_names)
    if self.refsite is not None and self.refsite not in targets_of(spec, "site"):
      raise ValueError(unknown("refsite", self.refsite, targets_of(spec, "site"), owner=type(self).__name__))
    element_of = spec.joint if self.transmission_type == "joint" else spec.tendon
    for attribute, values in (
      ("armature", self.armature),
      ("frictionloss", self.frictionloss),
      ("viscous_damping", self.viscous_damping),
    ):
      for name, value in self._overrides(attribute, values, target_names).items():
        if attribute == "viscous_damping":
          element_of(name).damping[0] = value
        else:
          setattr(element_of(name), attribute, value)
    self._add_elements(spec, target_names)

  def validate(self, target_names: Sequence[str]) -> None:
    """Refuses impossible numbers by name.

    Raises:
      ValueError: What is wrong, at which target.
    """
    kind = type(self).__name__
    self._validate_transmission(kind, target_names)
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

  def _check_transmission(self) -> None:
    if self.transmission_type not in TRANSMISSIONS:
      kind = type(self).__name__
      raise ValueError(unknown("transmission_type", str(self.transmission_type), TRANSMISSIONS, owner=kind))

  def _validate_transmission(self, kind: str, target_names: Sequence[str]) -> None:
    self._check_transmission()
    if self.transmission_type != "site":
      for name in ("site_gear", "refsite"):
        if getattr(self, name) is not None:
          raise ValueError(f"{kind}: {name} is given, but transmission_type is {self.transmission_type!r}")
      return
    for name in ("armature", "frictionloss", "viscous_damping"):
      if getattr(self, name) is not None:
        raise ValueError(f"{kind}: {name} is given, but a site has none; joints and tendons have")
    self._validate_site(kind, target_names)

  def _validate_site(self, kind: str, target_names: Sequence[str]) -> None:
    self._site_gears(target_names)
    if self.refsite is None and self._reads_position():
      raise ValueError(
        f"{kind}: site {target_names[0]!r} has no position to be driven to without a refsite to measure it from; "
        "give refsite, or zero stiffness"
      )

  def _site_gears(self, target_names: Sequence[str]) -> dict[str, SiteGear]:
    kind = type(self).__name__
    if self.site_gear is None:
      raise ValueError(f"{kind}: site_gear is missing; say the wrench of a unit effort, e.g. (0, 0, 1, 0, 0, 0)")
    gears = self._by_target("site_gear", self.site_gear, target_names)
    for target, gear in zip(target_names, gears, strict=True):
      if len(gear) != 6 or not all(map(math.isfinite, gear)) or not any(gear):
        raise ValueError(
          f"{self._field_of('site_gear', target)} is {gear}; it must be six finite numbers, not all zero"
        )
    return dict(zip(target_names, gears, strict=True))

  def _reads_position(self) -> bool:
    """Whether the law needs the position of its target."""
    return False

  def parameters(self, target_names: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Constants that the runtime law needs, one number per target each."""
    return {}

  def groups(self, model: mujoco.MjModel, target_names: Sequence[str], prefix: str = "") -> list[ActuatorGroup]:
    """What this config drives in a compiled model, with the ctrl index of each target looked up by name.

    Raises:
      ValueError: The model has no actuator named like a target: `edit_spec` was not called before it was compiled.
    """
    elements = self.elements(model, target_names, prefix)
    return [self._group(target_names, [int(model.actuator_ctrladr[index]) for index in elements])]

  def elements(self, model: mujoco.MjModel, target_names: Sequence[str], prefix: str = "") -> list[int]:
    """Ids of the actuators that `edit_spec` added, one per target.

    Raises:
      ValueError: The model has no such actuator: `edit_spec` was not called before it was compiled.
    """
    found = []
    for name in target_names:
      target = Target(self.transmission_type, name)
      names = (prefix + name, f"{prefix}{name}_{self.transmission_type}")
      ids = [index for index in actuators_of(model, target, prefix) if model.actuator(index).name in names]
      if not ids:
        raise ValueError(
          f"{type(self).__name__}: the model has no actuator {prefix + name!r}; call edit_spec before it is compiled"
        )
      found.append(ids[0])
    return found

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

  def _bare_elements(
    self, spec: mujoco.MjSpec, target_names: Sequence[str], gear: float = 1.0
  ) -> list[mujoco.MjsActuator]:
    """Adds an actuator to each target, whose effort is `gear` times its force, and returns them."""
    scalar = dict.fromkeys(target_names, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    directions = self._site_gears(target_names) if self.transmission_type == "site" else scalar
    return [
      add_element(
        spec,
        type(self).__name__,
        Target(self.transmission_type, name),
        gear=[gear * part for part in directions[name]],
        refsite=self.refsite,
      )
      for name in target_names
    ]

  def _group(self, target_names: Sequence[str], ctrl_ids: Sequence[int]) -> ActuatorGroup:
    return ActuatorGroup(
      law=self.law,
      targets=tuple(Target(self.transmission_type, name) for name in target_names),
      command_fields=self.command_fields,
      parameters=self.parameters(target_names),
      delay=self.delay,
      ctrl_ids=tuple(ctrl_ids),
      settings=self.settings,
    )

  def _numbers(self, name: str, target_names: Sequence[str]) -> tuple[float, ...]:
    """The field `name` for each target, checked to be finite and not negative."""
    values = self._by_target(name, getattr(self, name), target_names)
    for target, value in zip(target_names, values, strict=True):
      self._check(name, target, value)
    return tuple(float(value) for value in values)

  def _positives(self, name: str, target_names: Sequence[str]) -> tuple[float, ...]:
    """The field `name` for each target, checked to be finite and positive."""
    values = self._numbers(name, target_names)
    for target, value in zip(target_names, values, strict=True):
      if value == 0.0:
        raise ValueError(f"{self._field_of(name, target)} is 0; it must be positive")
    return values

  def _limits(self, name: str, target_names: Sequence[str]) -> tuple[float, ...]:
    """The effort limit `name` for each target, positive; infinity where there is none."""
    value = getattr(self, name)
    if value is None:
      return (math.inf,) * len(target_names)
    values = self._by_target(name, value, target_names)
    for target, limit in zip(target_names, values, strict=True):
      if not limit > 0.0:
        raise ValueError(f"{self._field_of(name, target)} is {limit}; it must be positive, or None for no limit")
    return tuple(float(limit) for limit in values)

  def _overrides(self, name: str, values: PerTarget | None, target_names: Sequence[str]) -> dict[str, float]:
    if values is None:
      return {}
    if isinstance(values, Mapping):
      owner = f"{type(self).__name__}.{name}"
      _, names, numbers = match_values(values, target_names, what=self.transmission_type, owner=owner)
      chosen: dict[str, float] = dict(zip(names, numbers, strict=True))
    else:
      chosen = dict.fromkeys(target_names, values)
    for target, value in chosen.items():
      self._check(name, target, value)
    return chosen

  def _by_target(self, name: str, values: T | Mapping[str, T], target_names: Sequence[str]) -> list[T]:
    """The values of the field `name`, one per target."""
    return match_values_full(values, target_names, what=self.transmission_type, owner=f"{type(self).__name__}.{name}")

  def _check(self, name: str, target: str, value: float) -> None:
    if not (isinstance(value, Real) and math.isfinite(value) and value >= 0.0):
      raise ValueError(f"{self._field_of(name, target)} is {value!r}; it must be finite and not negative")

  def _field_of(self, name: str, target: str) -> str:
    """How messages begin that are about a field of one target."""
    return f"{type(self).__name__}: {name} of {self.transmission_type} {target!r}"
