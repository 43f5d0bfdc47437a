"""One spec for variants with joints: the union of their bodies, with the numbers of each variant beside it.

A body, a joint or a site belongs to all variants that have one of its name. A variant that lacks a body is simulated
with a body of no mass there, whose joint rests.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mjlab_core import ConfigError, MjlabError
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

_BODY = ("body_pos", "body_quat", "body_mass", "body_ipos", "body_inertia", "body_iquat", "body_gravcomp")
_JOINT = ("jnt_pos", "jnt_axis", "jnt_range", "jnt_stiffness", "jnt_margin", "jnt_solref", "jnt_solimp")
_DOF = ("dof_armature", "dof_damping", "dof_frictionloss", "dof_solref", "dof_solimp")
_QPOS = ("qpos0", "qpos_spring")
_SITE = ("site_pos", "site_quat")
FIELDS = (*_BODY, *_JOINT, *_DOF, *_QPOS, *_SITE)
"""Model fields that differ between variants, beside those of geoms."""

_FREE = mujoco.mjtJoint.mjJNT_FREE
_NO_LIMIT = (-1e9, 1e9)
# A joint that a variant lacks moves nothing, and holds its place against whatever its actuator does.
_REST = {"dof_armature": 1.0, "dof_damping": 1e3, "dof_frictionloss": 0.0, "jnt_stiffness": 1e4}
# What the configs of actuators write on a joint is the same in all variants.
_CONFIGURED = ("dof_armature", "dof_damping", "dof_frictionloss")


@dataclass
class Skeleton:
  """Bodies, joints and sites of all variants, and the numbers that each variant has for them.

  Geoms, cameras and lights are those of one variant each, called "<variant>/<name>".
  """

  models: dict[str, mujoco.MjModel]
  """Each variant, compiled alone."""
  bodies: list[str]
  joints: list[str]
  """Names of the joints, without a free one."""
  sites: list[str]
  floats: bool
  """True if the base has a free joint."""

  def numbers(
    self, model: mujoco.MjModel, prefix: str, variant: str, rest: Mapping[str, Numbers]
  ) -> dict[str, Numbers]:
    """Return the fields of one variant in the layout of `model`, which has the skeleton under `prefix`.

    `rest` has the positions of joints by name, where those that the variant lacks stay.
    """
    alone = self.models[variant]
    out = {name: np.array(getattr(model, name), dtype=np.float64) for name in FIELDS}
    for name in self.bodies:
      index, there = model.body(prefix + name).id, mujoco.mj_name2id(alone, mujoco.mjtObj.mjOBJ_BODY, name)
      if there < 0:
        out["body_mass"][index], out["body_inertia"][index] = 0.0, 0.0
        continue
      is_root = name == self.bodies[0]
      for of in _BODY:
        if not (is_root and self.floats and of in ("body_pos", "body_quat")):
          out[of][index] = getattr(alone, of)[there]
    for name in self.joints:
      self._of_joint(out, model, alone, prefix, name, rest[name])
    for name in self.sites:
      index, there = model.site(prefix + name).id, mujoco.mj_name2id(alone, mujoco.mjtObj.mjOBJ_SITE, name)
      if there >= 0:
        for of in _SITE:
          out[of][index] = getattr(alone, of)[there]
    return out

  @staticmethod
  def _of_joint(
    out: dict[str, Numbers],
    model: mujoco.MjModel,
    alone: mujoco.MjModel,
    prefix: str,
    name: str,
    rest: Numbers,
  ) -> None:
    here, there = model.joint(prefix + name).id, mujoco.mj_name2id(alone, mujoco.mjtObj.mjOBJ_JOINT, name)
    nq, nv = _widths(model.jnt_type[here])
    q, v = (slice(start, start + n) for start, n in ((model.jnt_qposadr[here], nq), (model.jnt_dofadr[here], nv)))
    if there < 0:
      for of, value in _REST.items():
        out[of][v if of.startswith("dof") else here] = value
      out["jnt_range"][here], out["qpos_spring"][q] = _NO_LIMIT, rest
      return
    for of in _JOINT:
      out[of][here] = getattr(alone, of)[there]
    if not alone.jnt_limited[there]:
      out["jnt_range"][here] = _NO_LIMIT
    from_q, from_v = int(alone.jnt_qposadr[there]), int(alone.jnt_dofadr[there])
    for of in _QPOS:
      out[of][q] = getattr(alone, of)[from_q : from_q + nq]
    for of in _DOF:
      if of not in _CONFIGURED or not getattr(model, of)[v].any():
        out[of][v] = getattr(alone, of)[from_v : from_v + nv]

  def has_joint(self, variant: str, name: str) -> bool:
    """Return True if a variant has the joint `name`."""
    return mujoco.mj_name2id(self.models[variant], mujoco.mjtObj.mjOBJ_JOINT, name) >= 0


def is_articulated(spec: mujoco.MjSpec) -> bool:
  """Return True if a spec has other joints than a free one."""
  return any(joint.type != _FREE for joint in spec.joints)


def merge_articulated(specs: Mapping[str, mujoco.MjSpec], owner: str) -> tuple[mujoco.MjSpec, Skeleton]:
  """Return the model with all variants, and their numbers, of specs with one body on top and a name for everything.

  Raises:
    MjlabError: The variants differ in something that all worlds of a model share.
  """
  merged, models, dummies = mujoco.MjSpec(), {}, list[str]()
  floats = {name: any(joint.type == _FREE for joint in spec.joints) for name, spec in specs.items()}
  is_floating = all_float(floats, owner)
  top = next(iter(specs.values())).bodies[1].name
  problems: list[str] = []
  for name, spec in specs.items():
    found = list(_part_problems(spec))
    if spec.bodies[1].name != top:
      found.append(f"its body on top is '{spec.bodies[1].name}', that of another variant is '{top}'")
    if not found:
      models[name] = spec.copy().compile()
      for body in spec.bodies[1:]:
        dummies += _add_body(merged, spec, body, models[name], found)
    problems += [f"{owner}: variant '{name}': {problem}" for problem in found]
  if problems:
    raise ConfigError(*problems)
  for name, spec in specs.items():
    for body in spec.bodies[1:]:
      if body.geoms or body.cameras or body.lights:
        _add_parts(merged, spec, body.name, name)
  # Bodies without joints become part of the one above: those that were just attached, and nothing else.
  merged.fuse_static()
  for kind in ("geoms", "cameras", "lights"):
    for element in getattr(merged, kind):
      variant, _, local = element.name.split("/", 2)
      element.name = f"{variant}/{local}"
  for dummy in dummies:
    merged.delete(merged.joint(dummy))
  for body in merged.bodies[1:]:
    _set_inertia(body, models)
  return merged, Skeleton(
    models=models,
    bodies=[body.name for body in merged.bodies[1:]],
    joints=[joint.name for joint in merged.joints if joint.type != _FREE],
    sites=[site.name for site in merged.sites],
    floats=is_floating,
  )


def all_float(floats: Mapping[str, bool], owner: str) -> bool:
  """Return True if all variants have a free joint, False if none has."""
  if len(set(floats.values())) > 1:
    fixed = next(name for name, is_free in floats.items() if not is_free)
    raise MjlabError(f"{owner}: variant '{fixed}' has no free joint, but others have; all must float, or none")
  return any(floats.values())


def _part_problems(spec: mujoco.MjSpec) -> Iterator[str]:
  for kind, found, instead in (
    ("actuator", spec.actuators, "configure actuators in EntityCfg.articulation"),
    ("tendon", spec.tendons, "worlds share tendons"),
    ("equality", spec.equalities, "worlds share equalities"),
    ("sensor", spec.sensors, "configure sensors in SceneCfg.sensors"),
    ("contact pair", spec.pairs, "worlds share pairs"),
    ("exclude", spec.excludes, "worlds share excludes"),
  ):
    if found:
      yield f"{kind} '{found[0].name}' cannot be part of a variant with joints; {instead}"


def _add_body(
  merged: mujoco.MjSpec, spec: mujoco.MjSpec, body: mujoco.MjsBody, alone: mujoco.MjModel, problems: list[str]
) -> list[str]:
  """Add a body with its joints and sites to the skeleton, and return new dummies; note what differs from there."""
  parent = "world" if body.parent == spec.worldbody else body.parent.name
  found, dummies = merged.body(body.name), []
  if found is None:
    above = merged.worldbody if parent == "world" else merged.body(parent)
    found = above.add_body(name=body.name)
    found.pos, found.quat = alone.body(body.name).pos, alone.body(body.name).quat
    if parent == "world" and any(joint.type == _FREE for joint in body.joints):
      found.pos, found.quat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    for joint in body.joints:
      _add_joint(found, joint.name, alone)
    if not body.joints:
      dummies.append(found.add_joint(name=f"{body.name}/dummy").name)
  elif found.parent.name != parent:
    problems.append(f"body '{body.name}' is on '{parent}', but on '{found.parent.name}' in another variant")
  else:
    problems += _joint_problems(found, body, alone)
  here = [site.name for site in merged.sites]
  for site in body.sites:
    if site.name not in here:
      twin = alone.site(site.name)
      found.add_site(name=site.name, pos=twin.pos, quat=twin.quat, size=twin.size, type=int(twin.type[0]))
    elif merged.site(site.name).parent.name != body.name:
      problems.append(f"site '{site.name}' is on another body than in another variant")
  return dummies


def _add_joint(body: mujoco.MjsBody, name: str, alone: mujoco.MjModel) -> None:
  twin = alone.joint(name)
  joint = body.add_joint(name=name, type=int(twin.type[0]))
  if joint.type == _FREE:
    return
  joint.pos, joint.axis = twin.pos, twin.axis
  # Limits of all worlds are on: those of a variant without one are out of reach.
  joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, list(_NO_LIMIT)
  if alone.jnt_actfrclimited[twin.id]:
    joint.actfrclimited, joint.actfrcrange = mujoco.mjtLimited.mjLIMITED_TRUE, alone.jnt_actfrcrange[twin.id]


def _joint_problems(found: mujoco.MjsBody, body: mujoco.MjsBody, alone: mujoco.MjModel) -> Iterator[str]:
  theirs = [(joint.name, joint.type) for joint in found.joints if not joint.name.endswith("/dummy")]
  mine = [(joint.name, joint.type) for joint in body.joints]
  if mine != theirs:
    shown = [", ".join(f"'{name}'" for name, _ in of) or "none" for of in (mine, theirs)]
    yield f"joints of body '{body.name}' are {shown[0]}; those of another variant are {shown[1]}, or of other types"
    return
  for joint in found.joints if mine else ():
    if joint.type != _FREE and list(alone.jnt_actfrcrange[alone.joint(joint.name).id]) != list(joint.actfrcrange):
      yield f"joint '{joint.name}' has another actuatorfrcrange than in another variant"


def _add_parts(merged: mujoco.MjSpec, spec: mujoco.MjSpec, name: str, variant: str) -> None:
  """Attach what a body of a variant carries to that of the skeleton, as a body without joints."""
  part = spec.copy()
  for kind in ("joints", "keys", "sites"):
    for element in list(getattr(part, kind)):
      part.delete(element)
  for body in part.bodies[1:]:
    for kind in ("geoms", "cameras", "lights"):
      for element in list(getattr(body, kind)):
        if body.name != name:
          part.delete(element)
        elif kind == "geoms":
          element.mass = 0.0
    body.explicitinertial, body.mass = False, 0.0
    body.pos, body.quat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
  meshes = {geom.meshname for geom in part.body(name).geoms}
  for mesh in list(part.meshes):
    if mesh.name not in meshes:
      part.delete(mesh)
  model = part.copy().compile()
  data = mujoco.MjData(model)
  mujoco.mj_kinematics(model, data)
  there = model.body(name).id
  back, quat = np.zeros(3), np.zeros(4)
  mujoco.mju_negPose(back, quat, data.xpos[there], data.xquat[there])
  merged.attach(part, prefix=f"{variant}/{name}/", frame=merged.body(name).add_frame(pos=back, quat=quat))


def _set_inertia(body: mujoco.MjsBody, models: Mapping[str, mujoco.MjModel]) -> None:
  """Give a body the inertia of the first variant that has it; what is compiled weightless would stay so."""
  twins: list[Any] = [model.body(body.name) for model in models.values() if _has_body(model, body.name)]
  twin = max(twins, key=lambda twin: twin.mass[0])
  body.explicitinertial, body.simple = True, False
  body.mass, body.ipos, body.inertia, body.iquat = float(twin.mass[0]), twin.ipos, twin.inertia, twin.iquat
  body.gravcomp = float(max(one.gravcomp[0] for one in twins)) if hasattr(twin, "gravcomp") else 0.0


def _has_body(model: mujoco.MjModel, name: str) -> bool:
  return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) >= 0


def _widths(kind: int) -> tuple[int, int]:
  return (4, 3) if kind == mujoco.mjtJoint.mjJNT_BALL else (1, 1)
