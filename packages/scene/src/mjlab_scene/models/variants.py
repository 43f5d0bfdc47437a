"""Entity that differs between worlds: another object or robot, or none at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import torch
from mjlab_core import MjlabError, check_name
from mjlab_terrain.terrain import apportion

from mjlab_scene.entities.entity import Entity, EntityCfg
from mjlab_scene.models.skeleton import FIELDS, find, merge_variants, numbers_of

if TYPE_CHECKING:
  from mjlab_sim import Simulation

SpecFn = Callable[[], mujoco.MjSpec]
_FAR = 1e4
# A contact begins at a distance below the margin, so never with this one.
_NO_CONTACT = -1e6
_TINY = 1e-6


@dataclass(kw_only=True)
class VariantEntityCfg(EntityCfg):
  """An object or a robot that differs between worlds.

  Geoms, materials and meshes of a variant are called "<variant>/<name>". Contact presets, sensors and randomisers see
  all of them, and each geom has its own friction and contact dimension. Every variant costs collision checks in every
  world, so this is for tens of objects, not for thousands.

  Rigid objects have one body, "object", and their sites are called "<variant>/<name>" too. Mass and inertia are values
  per world, and randomisers start from them. If a variant has joints, then bodies, joints and sites of one name are
  one element of all variants, whose place, axis, range, inertia and friction are values per world. All worlds have the
  joints of all variants. A joint that the variant of a world lacks rests, without mass and without effect; see
  `joint_is_there`. Variants have the same joints on a common body, by name and type; all variants float, or none does.
  Actuators are configured in `articulation`; tendons, equalities, sensors and actuators of the models are refused.
  """

  variants: Mapping[str, SpecFn | None]
  """Functions by name of the variant; each returns a new spec with one body on top. None is an absent object, for rigid
  objects only: no contact or ray meets it, and gravity does not move it."""
  assignment: Mapping[str, float] | Sequence[str] | None = None
  """Shares of the variants in all worlds, 1 for variants without a share; or the variant of each world by name. Worlds
  are dealt out as evenly as shares allow, and shuffled. None: equal shares."""
  seed: int = 0
  """Seed of the shuffle. A saved state that is loaded brings its own assignment."""
  spec_fn: SpecFn = field(default=mujoco.MjSpec, init=False, repr=False, compare=False)
  """Made from the variants."""

  def build(self, name: str) -> VariantEntity:
    """Return the entity that this describes, under `name`."""
    return VariantEntity(self, name)


class VariantEntity(Entity):
  """Entity of a `VariantEntityCfg`."""

  variant_names: tuple[str, ...]
  """The variants in their order."""
  variant: torch.Tensor
  """Index of the variant of each world, (num_envs,); exists once the scene is initialized."""
  geom_is_there: torch.Tensor
  """True for geoms that the variant of a world has, bool (num_envs, num_geoms); exists once it is initialized."""

  def __init__(self, cfg: VariantEntityCfg, name: str) -> None:
    specs = {name: None if make is None else make() for name, make in cfg.variants.items()}
    spec, self._models = merge_variants(specs, f"entity '{name}'")
    models = self._models
    self.variant_names = tuple(cfg.variants)
    self._contents = {name: _content(models[name]) if name in models else {} for name in self.variant_names}
    self._assignment, self._seed = cfg.assignment, cfg.seed
    super().__init__(cfg, name, spec)
    if own := [field for field in self.overlay.model if field in FIELDS]:
      raise MjlabError(f"{self.overlay.source}: every variant has a separate {own[0]}, which an overlay cannot replace")

  def initialize(self, sim: Simulation, prefix: str | None = None, rng: torch.Generator | None = None) -> None:
    """Find the entity in the simulation's model, and give every world its variant."""
    super().initialize(sim, prefix, rng)
    chosen = assign(self.variant_names, self._assignment, sim.num_envs, self._seed, self.owner)
    self.variant = self.state_of(torch.tensor(chosen, device=sim.device))
    model, tables = sim.mj_model, self._differences(sim)
    fields = ["geom_margin", "geom_size", "geom_pos", "geom_rgba", *tables]
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
    names = self.indexing.names["joint"]
    there = [[find(self._models[of], "joint", name) >= 0 for name in names] for of in self.variant_names]
    self._joints_of_variant = torch.tensor(there, dtype=torch.bool, device=sim.device)
    sim.recompute_constants()
    sim.rebase_default_fields(fields)

  @property
  def joint_is_there(self) -> torch.Tensor:
    """True for joints that the variant of a world has, bool (num_envs, num_joints); exists once it is initialized."""
    return self._joints_of_variant.index_select(0, self.variant)

  def _differences(self, sim: Simulation) -> dict[str, tuple[list[int], torch.Tensor]]:
    """Return rows of model fields that are not as compiled in every variant, and their values in every world."""
    model, rest = sim.mj_model, self.initial_state.joint_pos
    variants = [numbers_of(self._models.get(name), model, self.prefix, rest) for name in self.variant_names]
    out: dict[str, tuple[list[int], torch.Tensor]] = {}
    for name in FIELDS:
      table = np.array([numbers[name] for numbers in variants])
      if table.size and (differs := (table != getattr(model, name)).reshape(*table.shape[:2], -1).any((0, 2))).any():
        rows = np.flatnonzero(differs).tolist()
        out[name] = rows, torch.as_tensor(table[:, rows], dtype=sim.dtype, device=sim.device)[self.variant]
    return out

  def state_dict(self) -> dict[str, Any]:
    # Worlds hold numbers of variants, which mean something only for the same variants.
    return {**super().state_dict(), _VARIANTS: self._contents}

  def state_problems(self, state: Mapping[str, Any], path: str = "") -> Iterator[str]:
    saved, here = state.get(_VARIANTS, {}), self.variant_names
    if tuple(saved) != here:
      yield f"{path}: saved with the variants {', '.join(saved) or '(unknown)'}; here there are {', '.join(here)}."
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


_VARIANTS = "variants"
_CONTENT = """geom_type geom_size geom_pos geom_quat geom_friction geom_condim geom_contype geom_conaffinity
geom_priority geom_solref geom_solimp geom_margin geom_gap body_mass body_ipos body_inertia body_iquat""".split()
"""Fields that identify an object, beside its meshes."""


def assign(
  names: Sequence[str],
  assignment: Mapping[str, float] | Sequence[str] | None,
  num_envs: int,
  seed: int,
  owner: str,
) -> list[int]:
  """Return the index of the variant of every world; see `VariantEntityCfg.assignment`.

  Raises:
    MjlabError: A variant does not exist, a share is impossible, or the number of names is not that of the worlds.
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
    raise MjlabError(f"{owner}: shares must be numbers from 0, not all 0; got {weights.tolist()}")
  dealt = np.repeat(np.arange(len(names)), apportion(weights / weights.sum(), num_envs))
  return np.random.default_rng(seed).permutation(dealt).tolist()


def _content(model: mujoco.MjModel) -> dict[str, torch.Tensor]:
  # Nine numbers that change if a vertex of a mesh moves.
  arrays = {"mesh_vert": model.mesh_vert.T @ model.mesh_vert, **{name: getattr(model, name) for name in _CONTENT}}
  return {name: torch.tensor(array, dtype=torch.float64) for name, array in arrays.items()}
