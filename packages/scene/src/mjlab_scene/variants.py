"""One entity that is another object or robot in another world: of its own shape, inertia and friction, or not there."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import torch
from mjlab_core import MjlabError, check_name, require
from mjlab_terrain.terrain import apportion

from mjlab_scene.articulated import FIELDS, Skeleton, all_float, is_articulated, merge_articulated
from mjlab_scene.entity import Entity, EntityCfg
from mjlab_scene.entity_spec import name_everything

if TYPE_CHECKING:
  from mjlab_sim import Simulation

SpecFn = Callable[[], mujoco.MjSpec]
_FAR = 1e4
# Contact begins at a distance below the margin: with this one, never.
_NO_CONTACT = -1e6
_TINY = 1e-6


@dataclass(kw_only=True)
class VariantEntityCfg(EntityCfg):
  """An object or a robot that differs between worlds.

  Geoms, sites, materials and meshes of a variant are called "<variant>/<name>", and contact presets, sensors and
  randomisers see them all: friction, contact dimension and the like are each geom's own. Every variant costs
  collision checks in every world, so that this is for tens of objects rather than thousands.

  Rigid objects have one moving body, "object", whose mass and inertia are values per world, and are what randomisers
  start from. Where a variant has joints, bodies, joints and sites of one name are one element of all variants, whose
  place, axis, range, inertia, friction and so on are values per world. All worlds have the joints of all variants:
  those that a world's variant lacks rest, without mass and without effect, and `joint_is_there` tells. On a common
  body, variants have the same joints, by name and type; all variants float, or none does. Actuators are configured in
  `articulation`; tendons, equalities, sensors and actuators of a variant's own model are refused.
  """

  variants: Mapping[str, SpecFn | None]
  """Kinds of object by name: a function that returns a new spec with one body on top; None is nothing at all,
  which no contact or ray meets and gravity leaves where it is, for rigid objects only."""
  assignment: Mapping[str, float] | Sequence[str] | None = None
  """Shares of the variants in all worlds, those that are not named counting as 1; or the variant of each world by name.
  Shares are dealt out as evenly as whole worlds allow, and shuffled. None: equal shares."""
  seed: int = 0
  """Of the shuffle. A saved state that is loaded brings its own assignment."""
  spec_fn: SpecFn = field(default=mujoco.MjSpec, init=False, repr=False, compare=False)
  """Made from the variants."""

  def build(self, name: str) -> VariantEntity:
    """Return the entity that this describes, under `name`."""
    return VariantEntity(self, name)


@dataclass(frozen=True)
class _Inertia:
  mass: float
  com: np.ndarray
  moments: np.ndarray
  quat: np.ndarray


class VariantEntity(Entity):
  """See `VariantEntityCfg`."""

  variant_names: tuple[str, ...]
  """The variants in their order."""
  variant: torch.Tensor
  """Index of the variant of each world, (num_envs,); exists once the scene is initialized."""
  geom_is_there: torch.Tensor
  """True for geoms that the variant of a world has, bool (num_envs, num_geoms); exists once it is initialized."""

  def __init__(self, cfg: VariantEntityCfg, name: str) -> None:
    owner = f"entity '{name}'"
    specs = {name: None if make is None else make() for name, make in cfg.variants.items()}
    self._skeleton: Skeleton | None = None
    if any(spec is not None and is_articulated(spec) for spec in specs.values()):
      spec, self._skeleton = _merge_articulated(specs, owner)
      self._contents = {name: _content(model) for name, model in self._skeleton.models.items()}
    else:
      spec, self._inertias, self._contents = _merge(specs, owner)
    self.variant_names = tuple(cfg.variants)
    self._assignment, self._seed = cfg.assignment, cfg.seed
    plain = EntityCfg(spec_fn=lambda: spec, init_state=cfg.init_state, articulation=cfg.articulation)
    super().__init__(replace(plain, edits=cfg.edits, collisions=cfg.collisions), name)
    self.cfg = cfg

  def initialize(self, sim: Simulation, prefix: str | None = None, rng: torch.Generator | None = None) -> None:
    """Find the entity in the simulation's model, and give every world its variant."""
    super().initialize(sim, prefix, rng)
    chosen = assign(self.variant_names, self._assignment, sim.num_envs, self._seed, f"entity '{self.name}'")
    self.variant = self.state_of(torch.tensor(chosen, device=sim.device))
    model = sim.mj_model
    fields = ["geom_margin", "geom_size", "geom_pos", "geom_rgba"]
    if self._skeleton is None:
      fields += ["body_mass", "body_ipos", "body_inertia", "body_iquat", "body_gravcomp"]
      sim.expand_model_fields(fields)
      self._write_inertias(sim)
    else:
      tables = self._differences(sim, self._skeleton)
      fields += tables
      sim.expand_model_fields(fields)
      for name, (rows, values) in tables.items():
        getattr(sim.model, name)[:, rows] = values
    owners = [self.variant_names.index(name.split("/")[0]) for name in self.indexing.names["geom"]]
    self.geom_is_there = self.state_of(self.variant[:, None] == torch.tensor(owners, device=sim.device))
    for geom, is_there in zip(self.indexing.ids["geom"].tolist(), self.geom_is_there.unbind(1), strict=True):
      sim.model.geom_margin[:, geom].masked_fill_(~is_there, _NO_CONTACT)
      sim.model.geom_rgba[:, geom, 3].masked_fill_(~is_there, 0.0)
      if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        # A mesh has no size to take from it.
        sim.model.geom_pos[:, geom, 2].masked_fill_(~is_there, _FAR)
      else:
        sim.model.geom_size[:, geom] = torch.where(is_there[:, None], sim.model.geom_size[:, geom], _TINY)
    names, skeleton = self.indexing.names["joint"], self._skeleton
    there = [[skeleton is None or skeleton.has_joint(of, name) for name in names] for of in self.variant_names]
    self._joints_of_variant = torch.tensor(there, dtype=torch.bool, device=sim.device)
    sim.recompute_constants()
    sim.rebase_default_fields(fields)

  @property
  def joint_is_there(self) -> torch.Tensor:
    """True for joints that the variant of a world has, bool (num_envs, num_joints); exists once it is initialized."""
    return self._joints_of_variant.index_select(0, self.variant)

  def _differences(self, sim: Simulation, skeleton: Skeleton) -> dict[str, tuple[list[int], torch.Tensor]]:
    """Return, of each model field that is not as compiled everywhere, the rows and their values in every world."""
    model, rest = sim.mj_model, self.initial_state.joint_pos
    variants = [skeleton.numbers(model, self.prefix, name, rest) for name in self.variant_names]
    out: dict[str, tuple[list[int], torch.Tensor]] = {}
    for name in FIELDS:
      table = np.array([numbers[name] for numbers in variants])
      if table.size and (differs := (table != getattr(model, name)).reshape(*table.shape[:2], -1).any((0, 2))).any():
        rows = np.flatnonzero(differs).tolist()
        out[name] = rows, torch.as_tensor(table[:, rows], dtype=sim.dtype, device=sim.device)[self.variant]
    return out

  def _write_inertias(self, sim: Simulation) -> None:
    body = sim.mj_model.body(self.prefix + _OBJECT).id

    def by_world(values: Sequence[np.ndarray | float]) -> torch.Tensor:
      return torch.as_tensor(np.array(values), dtype=sim.dtype, device=sim.device)[self.variant]

    solid = next(inertia for inertia in self._inertias.values() if inertia is not None)
    inertias = [self._inertias[name] or solid for name in self.variant_names]
    sim.model.body_mass[:, body] = by_world([inertia.mass for inertia in inertias])
    sim.model.body_ipos[:, body] = by_world([inertia.com for inertia in inertias])
    sim.model.body_inertia[:, body] = by_world([inertia.moments for inertia in inertias])
    sim.model.body_iquat[:, body] = by_world([inertia.quat for inertia in inertias])
    if None in self._inertias.values():
      sim.model.body_gravcomp[:, body] = by_world([float(self._inertias[name] is None) for name in self.variant_names])

  def state_dict(self) -> dict[str, Any]:
    # Who has which variant is told by its number.
    return {**super().state_dict(), _VARIANTS: self._contents}

  def state_problems(self, state: Mapping[str, Any], path: str = "") -> Iterator[str]:
    saved, here = state.get(_VARIANTS, {}), self.variant_names
    if tuple(saved) != here:
      yield f"{path}: saved with the variants {', '.join(saved) or '(not told)'}; here there are {', '.join(here)}."
      return
    for name, content in self._contents.items():
      if saved[name].keys() != content.keys():
        there, now = ("nothing" if not of else "an object" for of in (saved[name], content))
        yield f"{path}: variant '{name}' was saved as {there}; here it is {now}."
        continue
      for quantity, value in content.items():
        before = saved[name][quantity].to(value)
        if before.shape != value.shape or not torch.allclose(before, value, rtol=1e-5, atol=1e-9):
          yield f"{path}: variant '{name}' was saved with another {quantity} than it has here."
    yield from super().state_problems({name: value for name, value in state.items() if name != _VARIANTS}, path)


_OBJECT = "object"
_VARIANTS = "variants"
_CONTENT = """geom_type geom_size geom_pos geom_quat geom_friction geom_condim geom_contype geom_conaffinity
geom_priority geom_solref geom_solimp geom_margin geom_gap body_mass body_ipos body_inertia body_iquat""".split()
"""By which an object is known again, beside its meshes."""


def assign(
  names: Sequence[str],
  assignment: Mapping[str, float] | Sequence[str] | None,
  num_envs: int,
  seed: int,
  owner: str,
) -> list[int]:
  """Index of the variant of every world; see `VariantEntityCfg.assignment`.

  Raises:
    MjlabError: a variant that does not exist, a share that is none, or as many names as there are no worlds.
  """
  if assignment is not None:
    for name in assignment:
      check_name("variant", name, names, owner)
  if isinstance(assignment, Sequence):
    if len(assignment) != num_envs:
      raise MjlabError(f"{owner}: assignment names {len(assignment)} variants for {num_envs} worlds")
    return [list(names).index(name) for name in assignment]
  weights = np.array([1.0 if assignment is None else assignment.get(name, 1.0) for name in names])
  if not (np.isfinite(weights).all() and (weights >= 0.0).all() and weights.sum() > 0.0):
    raise MjlabError(f"{owner}: shares must be numbers from 0, not all 0, got {weights.tolist()}")
  dealt = np.repeat(np.arange(len(names)), apportion(weights / weights.sum(), num_envs))
  return np.random.default_rng(seed).permutation(dealt).tolist()


def _merge(
  variants: Mapping[str, mujoco.MjSpec | None], owner: str
) -> tuple[mujoco.MjSpec, dict[str, _Inertia | None], dict[str, dict[str, torch.Tensor]]]:
  """One spec with the geoms of all variants on one body, and what each variant weighs and is."""
  solid = {name: spec for name, spec in variants.items() if spec is not None}
  if not solid:
    raise MjlabError(f"{owner}: variants need at least one object")
  merged = mujoco.MjSpec()
  root = merged.worldbody.add_body(name=_OBJECT)
  models = {name: _prepare(spec, f"{owner}: variant '{name}'") for name, spec in solid.items()}
  floats = {
    name: any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints) for name, spec in solid.items()
  }
  for name, spec in solid.items():
    _strip(spec)
    merged.attach(spec, prefix=f"{name}/", frame=root.add_frame())
  joint = root.add_freejoint()
  # Contacts are as stiff as the inverse weight of their geom's body says: all geoms belong to the one that has it.
  merged.fuse_static()
  if not all_float(floats, owner):
    merged.delete(joint)
  inertias = {name: _inertia(models[name]) if name in models else None for name in variants}
  contents = {name: _content(models[name]) if name in models else {} for name in variants}
  _give_inertia(merged.body(_OBJECT), inertias)
  return merged, inertias, contents


def _prepare(spec: mujoco.MjSpec, what: str) -> mujoco.MjModel:
  """Name everything, put the body of a rigid object to the origin, and return the model of the object alone."""
  name_everything(spec)
  body = _only_body(spec, what)
  for kind, found in (("actuator", spec.actuators), ("tendon", spec.tendons), ("equality", spec.equalities)):
    if found:
      raise MjlabError(f"{what}: is no rigid object, for it has {kind} '{found[0].name}'")
  body.pos, body.quat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
  body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
  return spec.copy().compile()


def _strip(spec: mujoco.MjSpec) -> None:
  """Remove what the merged body has instead: joints, keyframes and masses."""
  for element in (*spec.joints, *spec.keys):
    spec.delete(element)
  for part in spec.bodies[1:]:
    part.explicitinertial = False
    part.mass = 0.0
  for geom in spec.geoms:
    geom.mass = 0.0


def _give_inertia(root: mujoco.MjsBody, inertias: Mapping[str, _Inertia | None]) -> None:
  """Give the merged body the inertia of the first object."""
  solid = next(inertia for inertia in inertias.values() if inertia is not None)
  root.explicitinertial = True
  # What is compiled as simple cannot have another centre of mass, and what is compiled weightless stays so.
  root.simple = False
  root.mass, root.ipos, root.inertia, root.iquat = solid.mass, solid.com, solid.moments, solid.quat
  root.gravcomp = 1.0 if None in inertias.values() else 0.0


def _merge_articulated(variants: Mapping[str, mujoco.MjSpec | None], owner: str) -> tuple[mujoco.MjSpec, Skeleton]:
  """Return the spec with the joints of all variants, and the numbers of each."""
  specs: dict[str, mujoco.MjSpec] = {}
  for name, given in variants.items():
    absent = f"{owner}: variant '{name}' is None, but others have joints; only rigid objects can be absent"
    spec = require(given, mujoco.MjSpec, absent)
    name_everything(spec)
    _only_body(spec, f"{owner}: variant '{name}'")
    specs[name] = spec
  return merge_articulated(specs, owner)


def _only_body(spec: mujoco.MjSpec, what: str) -> mujoco.MjsBody:
  roots = [body for body in spec.bodies[1:] if body.parent == spec.worldbody]
  if len(roots) != 1:
    raise MjlabError(f"{what}: must be one body with all else in it, has {len(roots)} on the top level")
  if spec.worldbody.geoms:
    raise MjlabError(f"{what}: geom '{spec.worldbody.geoms[0].name}' belongs to no body")
  return roots[0]


def _content(model: mujoco.MjModel) -> dict[str, torch.Tensor]:
  # Of a mesh this tells every vertex that moved, in nine numbers.
  arrays = {"mesh_vert": model.mesh_vert.T @ model.mesh_vert, **{name: getattr(model, name) for name in _CONTENT}}
  return {name: torch.tensor(array, dtype=torch.float64) for name, array in arrays.items()}


def _inertia(model: mujoco.MjModel) -> _Inertia:
  """Mass, centre of mass, principal moments and axes of all bodies together, in the frame of the first."""
  data = mujoco.MjData(model)
  mujoco.mj_kinematics(model, data)
  masses = model.body_mass
  mass = float(masses.sum())
  com = masses @ data.xipos / mass
  total = np.zeros((3, 3))
  for i in range(1, model.nbody):
    axes, arm = data.ximat[i].reshape(3, 3), data.xipos[i] - com
    total += axes @ np.diag(model.body_inertia[i]) @ axes.T + masses[i] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
  moments, axes = np.linalg.eigh(total)
  if np.linalg.det(axes) < 0.0:
    axes[:, 0] *= -1.0
  quat = np.zeros(4)
  mujoco.mju_mat2Quat(quat, axes.ravel())
  return _Inertia(mass, com, moments, quat)
