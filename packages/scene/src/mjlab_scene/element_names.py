"""Names for everything in a spec: what has a name can be addressed, so what has none is given one."""

from collections.abc import Iterable
from typing import Any

import mujoco

FREE_JOINT = "floating_base_joint"
"""Name given to an unnamed free joint."""

KINDS = ("body", "joint", "geom", "site", "tendon", "actuator", "camera", "light", "material")
"""Kinds of element that an entity lists by name."""


def name_everything(spec: mujoco.MjSpec) -> None:
  """Name each unnamed body, joint, geom, site, camera, light, tendon, actuator and sensor of `spec`, in place.

  A part of a body is called "<body>_<kind>", an actuator after its target, a sensor "<type>_<object>"; a number is
  appended where that name is taken.
  """
  for body in spec.bodies[1:]:
    _name([body], "body", [other.name for other in spec.bodies], lambda body: f"{body.parent.name}_body")
  free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
  _name(free, "joint", [joint.name for joint in spec.joints], lambda joint: FREE_JOINT)
  for kind, elements in (
    ("joint", spec.joints),
    ("geom", spec.geoms),
    ("site", spec.sites),
    ("camera", spec.cameras),
    ("light", spec.lights),
  ):
    taken = [element.name for element in elements]
    _name(elements, kind, taken, lambda element, kind=kind: f"{element.parent.name}_{kind}")
  for kind, elements in (("tendon", spec.tendons), ("actuator", spec.actuators)):
    taken = [element.name for element in elements]
    _name(elements, kind, taken, lambda element, kind=kind: getattr(element, "target", "") or kind)
  _name(spec.sensors, "sensor", [sensor.name for sensor in spec.sensors], _sensor_name)


def _sensor_name(sensor: mujoco.MjsSensor) -> str:
  kind = sensor.type.name.removeprefix("mjSENS_").lower()
  return f"{kind}_{sensor.objname}" if sensor.objname else kind


def _name(elements: Iterable[Any], kind: str, taken: Iterable[str], propose: Any) -> None:
  used = set(taken)
  for element in elements:
    if element.name:
      continue
    proposal = propose(element) or kind
    name, number = proposal, 2
    while name in used:
      name, number = f"{proposal}_{number}", number + 1
    element.name = name
    used.add(name)


def spec_names(spec: mujoco.MjSpec, kind: str) -> tuple[str, ...]:
  """Names of all elements of one of `KINDS` in `spec`, in compiled order; the world body and free joints left out."""
  if kind == "body":
    return tuple(body.name for body in spec.bodies[1:])
  if kind == "joint":
    return tuple(joint.name for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE)
  plural = {"camera": spec.cameras, "light": spec.lights, "material": spec.materials, "geom": spec.geoms}
  plural |= {"site": spec.sites, "tendon": spec.tendons, "actuator": spec.actuators}
  return tuple(element.name for element in plural[kind])
