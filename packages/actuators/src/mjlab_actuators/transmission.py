"""Targets of actuators: joints, tendons and sites."""

import math
from typing import Literal, NamedTuple, get_args

import mujoco
import numpy as np
from mjlab_core import MjlabError
from mjlab_core.model_fields import element_names

Transmission = Literal["joint", "tendon", "site"]
"""Kind of target: a hinge or slide, a tendon, along which the force acts, or a site, at which a wrench acts."""

TRANSMISSIONS: tuple[Transmission, ...] = get_args(Transmission)

SiteGear = tuple[float, float, float, float, float, float]
"""Direction of the wrench of a unit force, in the frame of the site or of its `refsite`: force [1], torque [m]."""

_TRN: dict[Transmission, tuple[mujoco.mjtTrn, ...]] = {
  "joint": (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT),
  "tendon": (mujoco.mjtTrn.mjTRN_TENDON,),
  "site": (mujoco.mjtTrn.mjTRN_SITE,),
}
_SCALAR = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


class Target(NamedTuple):
  """Joint, tendon or site that is driven; one column of targets and measurements."""

  transmission: Transmission
  name: str
  """Without the prefix that a scene puts before it."""


def targets_of(
  source: mujoco.MjSpec | mujoco.MjModel, transmission: Transmission = "joint", prefix: str = ""
) -> list[str]:
  """Return the names of all hinges and slides, tendons, or sites, prefix removed, in the source's order."""
  if isinstance(source, mujoco.MjSpec):
    elements = {"joint": source.joints, "tendon": source.tendons, "site": source.sites}[transmission]
    names = [
      element.name for element in elements if not isinstance(element, mujoco.MjsJoint) or element.type in _SCALAR
    ]
  else:
    names = [
      name
      for index, name in enumerate(element_names(source, transmission))
      if transmission != "joint" or mujoco.mjtJoint(source.jnt_type[index]) in _SCALAR
    ]
  return [name.removeprefix(prefix) for name in names if name and name.startswith(prefix)]


def actuators_of(model: mujoco.MjModel, target: Target, prefix: str = "") -> list[int]:
  """Return the ids of the actuators of a compiled model that act on `target`, in the model's order."""
  kind = getattr(mujoco.mjtObj, f"mjOBJ_{target.transmission.upper()}")
  index = mujoco.mj_name2id(model, kind, prefix + target.name)
  acting = np.isin(model.actuator_trntype, [int(kind) for kind in _TRN[target.transmission]])
  return np.flatnonzero(acting & (model.actuator_trnid[:, 0] == index)).tolist() if index >= 0 else []


def acts_on(element: mujoco.MjsActuator, target: Target) -> bool:
  """Return True if an actuator of a spec acts on `target`."""
  return element.trntype in _TRN[target.transmission] and element.target == target.name


def range_of(spec: mujoco.MjSpec, target: Target) -> tuple[float, float]:
  """Return the limits of a joint [m or rad] or of the length of a tendon [m]; equal when there are none."""
  if target.transmission == "site":
    return 0.0, 0.0
  element = spec.joint(target.name) if target.transmission == "joint" else spec.tendon(target.name)
  if element.limited == mujoco.mjtLimited.mjLIMITED_FALSE:
    return 0.0, 0.0
  # A spec holds what the file says; the compiler turns degrees into radians later, in joints but not in actuators.
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
  name = target.name
  taken = {element.name: element for element in spec.actuators}
  if name in taken and not acts_on(taken[name], target):
    name = f"{name}_{target.transmission}"
  if name in taken:
    raise MjlabError(
      f"{owner}: {target.transmission} {target.name!r} already has an actuator of that name; drive each "
      f"{target.transmission} by one config (XmlActuatorCfg keeps the MJCF's own actuator)"
    )
  element = spec.add_actuator(name=name, target=target.name, trntype=_TRN[target.transmission][0])
  element.set_to_motor()
  element.dyntype = mujoco.mjtDyn.mjDYN_NONE
  element.gear = gear
  if refsite is not None:
    element.refsite = refsite
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
  """Clamp the element's force to +-effort_limit inside MuJoCo; infinity leaves it free."""
  if math.isfinite(effort_limit):
    element.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    element.forcerange = [-effort_limit, effort_limit]
