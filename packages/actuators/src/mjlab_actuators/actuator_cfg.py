"""Base of all actuator configs: common fields, their checks, and the MuJoCo elements that a config adds."""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import mujoco
from mjlab_core import (
  Config,
  Count,
  Limits,
  MjlabError,
  check_fields,
  check_name,
  match_names,
  match_values_full,
)

from mjlab_actuators.actuator import COMMAND_FIELDS, Actuator, ActuatorGroup, Column, CommandField
from mjlab_actuators.transmission import SiteGear, Target, Transmission, add_element

_DELAY_FIELDS = ("delay_min_lag", "delay_max_lag", "delay_hold_prob", "delay_update_period")

PerTarget = float | Mapping[str, float]
"""One number for all targets, or numbers by pattern (full match; every target by exactly one pattern)."""
NonNegativePerTarget = Annotated[PerTarget, Limits(ge=0)]
"""Finite numbers from 0 on."""
PositivePerTarget = Annotated[PerTarget, Limits(gt=0)]
"""Finite numbers above 0."""
EffortLimit = Annotated[PerTarget | None, Limits(gt=0, finite=False)]
"""Positive numbers; None or infinity for no limit."""
Gear = Annotated[float, Limits(nonzero=True)]
"""Finite number other than 0."""
CtrlInput = tuple[tuple[CommandField, ...], float]
"""Targets that a ctrl takes, and its gear: transmission length per position."""


@dataclass(kw_only=True)
class ActuatorCfg(Config):
  """Base of all actuator configs.

  By default a MuJoCo motor without a range applies what the actuator model computes in torch, so a limit raised at run
  time takes effect. A joint's own `actuatorfrcrange`, if the MJCF has one, still applies.
  """

  target_names_expr: tuple[str, ...]
  """Patterns (full match) of names of joints, tendons or sites, as `transmission_type` says."""
  transmission_type: Transmission = "joint"
  """Kind of the targets: joints, tendons or sites.

  Positions and velocities are those of the joint, the length of the tendon, or of the site along `site_gear`. The
  effort acts on the joint, along the tendon, or as a wrench at the site."""
  site_gear: Annotated[SiteGear | Mapping[str, SiteGear] | None, Limits()] = None
  """For sites, which need it: wrench of a unit effort, force x, y, z [1] then torque x, y, z [m], in the frame of the
  site, or of `refsite`. One for all, or by pattern."""
  refsite: str | None = None
  """For sites: name of the site that positions and velocities are relative to. Without it there is a velocity, but no
  position, and actuator models that read a position are refused."""
  armature: Annotated[PerTarget | None, Limits(ge=0)] = None
  """Reflected rotor inertia written on joint or tendon [kg or kg m^2]; None, or no match, keeps the MJCF's."""
  frictionloss: Annotated[PerTarget | None, Limits(ge=0)] = None
  """Dry friction written on joint or tendon [N or N m]; None, or no match, keeps the MJCF's."""
  viscous_damping: Annotated[PerTarget | None, Limits(ge=0)] = None
  """Linear passive damping written on joint or tendon [N s/m or N m s/rad]; None, or no match, keeps the MJCF's."""
  velocity_limit: EffortLimit = None
  """Top speed of joint, tendon or site [m/s or rad/s]; None, or no match, for no limit. Rewards and policy bundles read
  it; the simulation does not limit speeds, except for actuator models with a torque-speed line."""
  delay_min_lag: Count = 0
  """Least lag of the targets [substeps]."""
  delay_max_lag: Count = 0
  """Greatest lag of the targets [substeps]; 0 means no delay. Each world draws its lag uniformly from min to max."""
  delay_hold_prob: Annotated[float, Limits(ge=0, le=1)] = 0.0
  """Probability that a due redraw keeps the old lag."""
  delay_update_period: Count = 0
  """Substeps between redraws of the lag; see `mjlab_core.buffers.DelayBuffer`."""

  actuator_model: ClassVar[type[Actuator]]
  """Runtime class."""
  command_fields: ClassVar[tuple[CommandField, ...]] = COMMAND_FIELDS
  """Targets that the actuator model reads."""
  number_fields: ClassVar[tuple[str, ...]] = ()
  """Fields that are constants of the actuator model, one number per target each."""
  setting_fields: ClassVar[tuple[str, ...]] = ()
  """Fields that are options of the actuator model; configs that differ in one are not fused."""
  of_mjcf: ClassVar[bool] = False
  """True for actuators that the MJCF declares; the others are added to it."""

  def match(self, candidates: Sequence[str], owner: str = "") -> list[str]:
    """Return the names to drive among `candidates`, in their order.

    Raises:
      ConfigError: A field breaks its constraint.
      UnknownNameError: A pattern matches nothing, or two patterns match one name.
    """
    check_fields(self, type(self).__name__)
    what = f"{self.transmission_type} with an MJCF actuator" if self.of_mjcf else self.transmission_type
    return match_names(self.target_names_expr, candidates, what=what, owner=owner)[1]

  def edit_spec(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    """Write joint or tendon properties, and add one MuJoCo actuator per target, named like it.

    Raises:
      MjlabError: A number is impossible, an element of that name exists, or the transmission lacks something that the
        actuator model needs.
    """
    self.validate(target_names)
    if self.refsite is not None:
      check_name("refsite", self.refsite, [site.name for site in spec.sites], type(self).__name__)
    element_of = spec.joint if self.transmission_type == "joint" else spec.tendon
    for name in ("armature", "frictionloss", "viscous_damping"):
      for target, value in zip(target_names, self._by_target(name, target_names, default=None), strict=True):
        if value is not None and name == "viscous_damping":
          element_of(target).damping[0] = value
        elif value is not None:
          setattr(element_of(target), name, value)
    self._add_elements(spec, target_names)

  def validate(self, target_names: Sequence[str]) -> None:
    """Raise ConfigError if fields are impossible, by themselves or for these targets; one line per problem."""
    check_fields(self, type(self).__name__, self.problems(target_names))
    self.parameters(target_names)

  def problems(self, target_names: Sequence[str]) -> Iterator[str]:
    """Yield problems of fields that keep their own constraints, for subclasses to extend."""
    is_site = self.transmission_type == "site"
    names = ("armature", "frictionloss", "viscous_damping") if is_site else ("site_gear", "refsite")
    yield from self._given(names, f"transmission_type is {self.transmission_type!r}")
    if is_site:
      yield from self._site_problems(target_names)
    if self.delay_min_lag > self.delay_max_lag:
      yield f"delay_min_lag {self.delay_min_lag} exceeds delay_max_lag {self.delay_max_lag}"

  def _given(self, names: Sequence[str], why: str) -> list[str]:
    return [f"{name} is given, but {why}" for name in names if getattr(self, name) is not None]

  def _site_problems(self, target_names: Sequence[str]) -> Iterator[str]:
    if self.site_gear is None:
      yield "site_gear is missing; give the wrench of a unit effort, e.g. (0, 0, 1, 0, 0, 0)"
    else:
      gears = zip(target_names, self._by_target("site_gear", target_names), strict=True)
      yield from (f"site_gear of site {name!r} is all zero" for name, gear in gears if not any(gear))
    if self.refsite is None and self._reads_position():
      yield (f"site {target_names[0]!r} has a position only relative to a refsite; give refsite, or zero stiffness")

  def _reads_position(self) -> bool:
    """Return True if the actuator model needs the position of its target."""
    stiffness: PerTarget = getattr(self, "stiffness", 1.0)
    is_stiff = any(stiffness.values()) if isinstance(stiffness, Mapping) else stiffness != 0.0
    return is_stiff and "position_target" in self.command_fields

  def parameters(self, target_names: Sequence[str]) -> list[dict[str, float]]:
    """Return the constants of the actuator model for each target."""
    return self._numbers(target_names, *self.number_fields)

  def ctrl_inputs(self, model: mujoco.MjModel, element: int) -> list[CtrlInput]:
    """Return the targets that each ctrl of an actuator of a compiled model takes, and the gear between them."""
    return [(self.command_fields, 1.0)]

  def groups(
    self, model: mujoco.MjModel, elements: Mapping[Target, Sequence[int]]
  ) -> dict[ActuatorGroup, list[Column]]:
    """Return the columns of this config in a compiled model, by what is computed together.

    Args:
      model: The compiled model.
      elements: Ids of the actuators of each target.

    Raises:
      MjlabError: Two actuators on one site would get the same target for different wrenches.
    """
    settings = tuple((name, getattr(self, name)) for name in (*_DELAY_FIELDS, *self.setting_fields))
    found: dict[ActuatorGroup, list[Column]] = defaultdict(list)
    numbers = self.parameters([target.name for target in elements])
    for (target, ids), parameters in zip(elements.items(), numbers, strict=True):
      for element in ids:
        for ctrl, (fields, gear) in enumerate(self.ctrl_inputs(model, element), model.actuator_ctrladr[element]):
          constants = {**parameters, "gear": gear}
          columns = found[ActuatorGroup(self.actuator_model, fields, settings, tuple(constants))]
          if target.transmission == "site" and any(column.target == target for column in columns):
            raise MjlabError(
              f"{type(self).__name__}: site {target.name!r} has one {fields[0]}, but several actuators that take one; "
              "give each a separate site, or leave the site out and write its ctrl"
            )
          columns.append(Column(target, element, int(ctrl), constants))
    return found

  def velocity_limits(self, target_names: Sequence[str]) -> dict[Target, float]:
    """Return the top speeds of the targets that have one [m/s or rad/s]."""
    limits = zip(target_names, self._by_target("velocity_limit", target_names, default=None), strict=True)
    return {Target(self.transmission_type, name): limit for name, limit in limits if limit is not None}

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    """Add the MuJoCo actuators of this config."""
    self._bare_elements(spec, target_names)

  def _bare_elements(
    self, spec: mujoco.MjSpec, target_names: Sequence[str], *fields: str, gear: float = 1.0
  ) -> list[tuple[Any, ...]]:
    """Add an actuator with a gear to each target, and return each with its numbers of `fields`."""
    scalar = [(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)] * len(target_names)
    directions = self._by_target("site_gear", target_names) if self.transmission_type == "site" else scalar
    out = []
    for name, direction, numbers in zip(target_names, directions, self._numbers(target_names, *fields), strict=True):
      gears = [gear * part for part in direction]
      element = add_element(
        spec, type(self).__name__, Target(self.transmission_type, name), gear=gears, refsite=self.refsite
      )
      out.append((element, *numbers.values()))
    return out

  def _numbers(self, target_names: Sequence[str], *names: str) -> list[dict[str, float]]:
    """Return the numbers of the fields `names` for each target; infinity where a limit is None."""
    values = [self._by_target(name, target_names) for name in names]
    return [
      {name: math.inf if of[index] is None else float(of[index]) for name, of in zip(names, values, strict=True)}
      for index in range(len(target_names))
    ]

  def _by_target(self, name: str, target_names: Sequence[str], **options: None) -> list:
    """Return the values of the field `name`, one per target."""
    owner = f"{type(self).__name__}.{name}"
    return match_values_full(getattr(self, name), target_names, what=self.transmission_type, owner=owner, **options)
