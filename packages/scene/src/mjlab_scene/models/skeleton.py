"""One spec for all variants of an entity: the union of their bodies, with the numbers of each variant beside it.

A body, a joint or a site belongs to all variants that have one of its name. A variant that lacks a body is simulated
with a body without mass, and the joint of that body rests. Rigid objects are one body, "object".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import mujoco
import numpy as np
from mjlab_core import ConfigError, MjlabError
from numpy.typing import NDArray

from mjlab_scene.entities.entity_spec import FREE_JOINT, name_everything
from mjlab_scene.entities.indexing import find_elements

Numbers = NDArray[np.float64]

OBJECT = "object"
"""Name of the body of rigid objects."""

_FIELDS = {
  "body": "body_pos body_quat body_mass body_ipos body_inertia body_iquat body_gravcomp".split(),
  "joint": """jnt_pos jnt_axis jnt_range jnt_stiffness jnt_margin jnt_solref jnt_solimp dof_armature dof_damping
dof_frictionloss dof_solref dof_solimp qpos0 qpos_spring""".split(),
  "site": ["site_pos", "site_quat"],
}
FIELDS = tuple(name for names in _FIELDS.values() for name in names)
"""Model fields that differ between variants, beside those of geoms."""

_FREE = mujoco.mjtJoint.mjJNT_FREE
_NO_LIMIT = (-1e9, 1e9)
# A joint that a variant lacks moves nothing, and resists its actuator.
_REST = {"dof_armature": 1.0, "dof_damping": 1e3, "dof_frictionloss": 0.0, "jnt_stiffness": 1e4}
# Fields that configs of actuators write are the same in all variants.
_CONFIGURED = ("dof_armature", "dof_damping", "dof_frictionloss")


def numbers_of(
  alone: mujoco.MjModel | None, model: mujoco.MjModel, prefix: str, rest: Mapping[str, Numbers]
) -> dict[str, Numbers]:
  """Return the fields of a variant in the layout of `model`, which has the merged spec under `prefix`.

  Args:
    alone: The variant, compiled alone; None for an absent object.
    model: Compiled model of the scene.
    prefix: Prefix of the entity's names in the model.
    rest: Positions by joint, where joints that the variant lacks stay.
  """
  out = {name: np.array(getattr(model, name), dtype=np.float64) for name in FIELDS}
  if alone is None:
    # Gravity leaves an absent object where it is.
    out["body_gravcomp"][model.body(prefix + OBJECT).id] = 1.0
    return out
  for kind, fields in _FIELDS.items():
    for here, name in find_elements(model, kind, prefix).items():
      there = find(alone, kind, name)
      if there >= 0:
        for of in fields:
          rows = _rows(model, of, here)
          if of not in _CONFIGURED or not out[of][rows].any():
            out[of][rows] = getattr(alone, of)[_rows(alone, of, there)]
      elif kind == "body":
        out["body_mass"][here], out["body_inertia"][here] = 0.0, 0.0
      elif kind == "joint":
        for of, value in {**_REST, "qpos_spring": rest[name]}.items():
          out[of][_rows(model, of, here)] = value
      if kind == "joint" and (there < 0 or not alone.jnt_limited[there]):
        out["jnt_range"][here] = _NO_LIMIT
  return out


def _rows(model: mujoco.MjModel, field: str, element: int) -> slice:
  """Return the rows of an element in a field of the model; a ball joint has several in qpos and in its velocities."""
  if not field.startswith(("dof", "qpos")):
    return slice(element, element + 1)
  is_ball = model.jnt_type[element] == mujoco.mjtJoint.mjJNT_BALL
  starts, ball = (model.jnt_dofadr, 3) if field.startswith("dof") else (model.jnt_qposadr, 4)
  return slice(starts[element], starts[element] + (ball if is_ball else 1))


def find(model: mujoco.MjModel, kind: str, name: str) -> int:
  """Return the id of an element, negative if the model has none of this name."""
  return mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name)


def merge_variants(
  variants: Mapping[str, mujoco.MjSpec | None], owner: str
) -> tuple[mujoco.MjSpec, dict[str, mujoco.MjModel]]:
  """Return the spec with all variants, and each variant compiled alone; None stands for an absent object.

  Geoms, cameras and lights are those of one variant each, called "<variant>/<name>".

  Raises:
    MjlabError: A variant has parts that variants cannot have, or variants differ in something that all worlds share.
  """
  specs = {name: spec for name, spec in variants.items() if spec is not None}
  absent = [name for name in variants if name not in specs]
  if not specs:
    raise MjlabError(f"{owner}: variants need at least one object")
  is_rigid = all(joint.type == _FREE for spec in specs.values() for joint in spec.joints)
  if absent and not is_rigid:
    raise MjlabError(
      f"{owner}: variant '{absent[0]}' is None, but others have joints; only rigid objects can be absent"
    )
  fixed = [name for name, spec in specs.items() if all(joint.type != _FREE for joint in spec.joints)]
  if 0 < len(fixed) < len(specs):
    raise MjlabError(f"{owner}: variant '{fixed[0]}' has no free joint, but others have; all must float, or none")
  merged, models, dummies = mujoco.MjSpec(), {}, list[str]()
  problems: list[str] = []
  for name, spec in specs.items():
    name_everything(spec)
    found = list(_part_problems(spec))
    if not found:
      models[name] = _prepare(spec, name, is_rigid, not fixed)
      top, others = spec.worldbody.first_body().name, merged.worldbody.first_body()
      if others is not None and others.name != top:
        found.append(f"its body on top is '{top}', that of another variant is '{others.name}'")
    if not found:
      for body in spec.bodies[1:]:
        dummies += _add_body(merged, spec, body, models[name], found)
    problems += [f"{owner}: variant '{name}': {problem}" for problem in found]
  if problems:
    raise ConfigError(*problems)
  for name, spec in specs.items():
    for body in spec.bodies[1:]:
      if body.geoms or body.cameras or body.lights:
        _add_parts(merged, spec, body.name, name, f"{name}/" if is_rigid else f"{name}/{body.name}/")
  # This fuses the bodies that were just attached into those above; dummy joints protect the others.
  merged.fuse_static()
  for dummy in dummies:
    merged.delete(merged.joint(dummy))
  for body in merged.bodies[1:]:
    _set_inertia(body, models)
  return merged, models


def _prepare(spec: mujoco.MjSpec, variant: str, is_rigid: bool, floats: bool) -> mujoco.MjModel:
  """Place an object or a floating base at the origin, make a rigid object one body, and return the compiled variant."""
  root = spec.worldbody.first_body()
  if is_rigid or floats:
    _place_at_origin(root)
  if is_rigid:
    # The stiffness of a contact follows from the inverse weight of its geom's body, so all geoms are on one body.
    holders = [] if floats else [root.add_joint()]
    spec.fuse_static()
    for holder in holders:
      spec.delete(holder)
    root.name = OBJECT
    for joint in root.joints:
      joint.name = FREE_JOINT
    for site in spec.sites:
      site.name = f"{variant}/{site.name}"
  return spec.copy().compile()


def _place_at_origin(body: mujoco.MjsBody) -> None:
  body.pos, body.quat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
  body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _part_problems(spec: mujoco.MjSpec) -> Iterator[str]:
  """Yield parts that a variant cannot have."""
  roots = [body for body in spec.bodies[1:] if body.parent == spec.worldbody]
  if len(roots) != 1:
    yield f"it must be one body with all else in it, and has {len(roots)} on the top level"
  if spec.worldbody.geoms:
    yield f"geom '{spec.worldbody.geoms[0].name}' belongs to no body"
  for kind, found, instead in (
    ("actuator", spec.actuators, "configure actuators in EntityCfg.articulation"),
    ("tendon", spec.tendons, "worlds share tendons"),
    ("equality", spec.equalities, "worlds share equalities"),
    ("sensor", spec.sensors, "configure sensors in SceneCfg.sensors"),
    ("contact pair", spec.pairs, "worlds share pairs"),
    ("exclude", spec.excludes, "worlds share excludes"),
  ):
    if found:
      yield f"{kind} '{found[0].name}' cannot be part of a variant; {instead}"


def _add_body(
  merged: mujoco.MjSpec, spec: mujoco.MjSpec, body: mujoco.MjsBody, alone: mujoco.MjModel, problems: list[str]
) -> list[str]:
  """Add a body with its joints and sites to the skeleton, and return new dummies; note where variants differ."""
  parent = "world" if body.parent == spec.worldbody else body.parent.name
  found, dummies = merged.body(body.name), []
  if found is None:
    above = merged.worldbody if parent == "world" else merged.body(parent)
    found = above.add_body(name=body.name)
    found.pos, found.quat = alone.body(body.name).pos, alone.body(body.name).quat
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
      added = found.add_site(name=site.name, pos=twin.pos, quat=twin.quat, size=twin.size, type=int(twin.type[0]))
      added.rgba, added.group = site.rgba, site.group
    elif merged.site(site.name).parent.name != body.name:
      problems.append(f"site '{site.name}' is on another body than in another variant")
  return dummies


def _add_joint(body: mujoco.MjsBody, name: str, alone: mujoco.MjModel) -> None:
  twin = alone.joint(name)
  joint = body.add_joint(name=name, type=int(twin.type[0]))
  if joint.type == _FREE:
    return
  joint.pos, joint.axis = twin.pos, twin.axis
  # All worlds have limits; those of a variant without limits are out of reach.
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
      yield f"joint '{joint.name}' has different actuatorfrcranges in two variants"


def _add_parts(merged: mujoco.MjSpec, spec: mujoco.MjSpec, name: str, variant: str, prefix: str) -> None:
  """Attach geoms, cameras and lights of a body of a variant to that of the skeleton, under `prefix`."""
  part = spec.copy()
  body = part.body(name)
  used = {geom.meshname for geom in body.geoms}
  unused = [mesh for mesh in part.meshes if mesh.name not in used]
  for element in (*body.bodies, *body.joints, *body.sites, *part.keys, *unused):
    part.delete(element)
  for geom in body.geoms:
    geom.mass = 0.0
  body.explicitinertial, body.mass = False, 0.0
  _place_at_origin(body)
  merged.body(name).add_frame().attach_body(body, prefix, "")
  for element in (*merged.geoms, *merged.cameras, *merged.lights):
    if element.name.startswith(prefix):
      element.name = f"{variant}/{element.name.removeprefix(prefix)}"


def _set_inertia(body: mujoco.MjsBody, models: Mapping[str, mujoco.MjModel]) -> None:
  """Give a body the inertia of the heaviest variant: a body compiled as weightless stays so."""
  twins = [model.body(body.name) for model in models.values() if find(model, "body", body.name) >= 0]
  twin: Any = max(twins, key=lambda twin: twin.mass[0])
  body.explicitinertial, body.mass = True, twin.mass[0]
  body.ipos, body.inertia, body.iquat = twin.ipos, twin.inertia, twin.iquat
