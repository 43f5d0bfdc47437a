"""Targets of actuators: joints, tendons and sites."""

import math
from typing import Literal, NamedTuple, get_args

import mujoco
from mjlab_core import MjlabError
from mjlab_core.mujoco.model_fields import element_names

Transmission = Literal["joint", "tendon", "site"]
"""Kind of target: a hinge or slide, a tendon, along which the force acts, or a site, at which a wrench acts."""

TRANSMISSIONS: tuple[Transmission, ...] = get_args(Transmission)

SiteGear = tuple[float, float, float, float, float, float]
"""Direction of the wrench of a unit force, in the frame of the site or of its `refsite`: force [1], torque [m]."""

_KINDS: dict[mujoco.mjtTrn, Transmission] = {
  mujoco.mjtTrn.mjTRN_JOINT: "joint",
  mujoco.mjtTrn.mjTRN_JOINTINPARENT: "joint",
  mujoco.mjtTrn.mjTRN_TENDON: "tendon",
  mujoco.mjtTrn.mjTRN_SITE: "site",
}
_SCALAR = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


class Target(NamedTuple):
  """Joint, tendon or site that is driven; one column of targets and measurements."""

  transmission: Transmission
  name: str
  """Without the prefix that a scene puts before it."""


def targets_of(source: mujoco.MjSpec | mujoco.MjModel, prefix: str = "") -> list[Target]:
  """Return all hinges and slides, then tendons, then sites, prefix removed, in the source's order."""
  if isinstance(source, mujoco.MjSpec):
    types = [joint.type for joint in source.joints]
    names = {kind: [element.name for element in getattr(source, f"{kind}s")] for kind in TRANSMISSIONS}
  else:
    types = [mujoco.mjtJoint(kind) for kind in source.jnt_type]
    names = {kind: element_names(source, kind) for kind in TRANSMISSIONS}
  names["joint"] = [name for name, kind in zip(names["joint"], types, strict=True) if kind in _SCALAR]
  found = [_local(kind, name, prefix) for kind in TRANSMISSIONS for name in names[kind]]
  return [target for target in found if target is not None]


def targets_of_actuators(source: mujoco.MjSpec | mujoco.MjModel, prefix: str = "") -> list[Target | None]:
  """Return the target of each actuator, prefix removed; None for other transmissions, and for names without prefix."""
  if isinstance(source, mujoco.MjSpec):
    return [_local(_KINDS.get(element.trntype), element.target, prefix) for element in source.actuators]
  names = {kind: element_names(source, kind) for kind in TRANSMISSIONS}
  kinds: list[Transmission | None] = [_KINDS.get(mujoco.mjtTrn(trntype)) for trntype in source.actuator_trntype]
  ids = source.actuator_trnid[:, 0].tolist()
  return [_local(kind, names[kind][i] if kind else "", prefix) for kind, i in zip(kinds, ids, strict=True)]


def _local(kind: Transmission | None, name: str, prefix: str) -> Target | None:
  return Target(kind, name.removeprefix(prefix)) if kind and name and name.startswith(prefix) else None


def range_of(spec: mujoco.MjSpec, target: Target) -> tuple[float, float]:
  """Return the limits of a joint [m or rad] or of the length of a tendon [m]; equal when there are none."""
  if target.transmission == "site":
    return 0.0, 0.0
  element = spec.joint(target.name) if target.transmission == "joint" else spec.tendon(target.name)
  if element.limited == mujoco.mjtLimited.mjLIMITED_FALSE:
    return 0.0, 0.0
  # A spec has the numbers of the file; the compiler turns degrees into radians later, in joints but not in actuators.
  in_degrees = isinstance(element, mujoco.MjsJoint) and element.type == mujoco.mjtJoint.mjJNT_HINGE
  unit = math.pi / 180.0 if spec.compiler.degree and in_degrees else 1.0
  return float(element.range[0]) * unit, float(element.range[1]) * unit


def add_element(
  spec: mujoco.MjSpec, owner: str, target: Target, *, gear: list[float], refsite: str | None
) -> mujoco.MjsActuator:
  """Add an actuator named like its target, free of everything that the MJCF's default classes would put on it.

  If something of another kind has the name, the kind follows it: "grip" and "grip_tendon".

  Raises:
    MjlabError: The target has an actuator of that name already.
  """
  taken = {element.name: of for element, of in zip(spec.actuators, targets_of_actuators(spec), strict=True)}
  name = target.name
  if taken.get(name, target) != target:
    name = f"{name}_{target.transmission}"
  if name in taken:
    raise MjlabError(
      f"{owner}: {target.transmission} {target.name!r} already has an actuator of that name; drive each "
      f"{target.transmission} by one config (XmlActuatorCfg keeps the MJCF's own actuator)"
    )
  trntype = next(trntype for trntype, kind in _KINDS.items() if kind == target.transmission)
  # Default classes of the MJCF must not change an actuator that a config describes.
  element = spec.add_actuator(mujoco.MjSpec().default, name=name, target=target.name, trntype=trntype, gear=gear)
  element.set_to_motor()
  element.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
  if refsite is not None:
    element.refsite = refsite
  return element


def limit_force(element: mujoco.MjsActuator, effort_limit: float) -> None:
  """Clamp the element's force to +-effort_limit inside MuJoCo; infinity leaves it free."""
  if math.isfinite(effort_limit):
    element.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    element.forcerange = [-effort_limit, effort_limit]
