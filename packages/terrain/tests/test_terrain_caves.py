"""The ground is solid everywhere below its surface: no hollow under an edge, between neighbours or below a border.

These tests stand for the class "something gets under the ground". They ask MuJoCo alone, which knows nothing of how a
type was built.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
from mjlab_terrain import FlatCfg, OpenStairsCfg, TerrainGridCfg, Tile, TileCfg, TiltedGridCfg, all_types
from terrain_ground import Ground

TYPES = all_types()
STEEP = TiltedGridCfg(tilt=(0.0, 40.0), height=(0.0, 0.3))
HOLES: dict[str, TileCfg] = {
  f"{name}_with_holes": dataclasses.replace(TYPES[name], holes=True)
  for name in ("stairs_up", "stairs_down", "random_grid")
}
PITS = HOLES | {name: TYPES[name] for name in ("stepping_stones", "narrow_beams", "nested_rings")}
# Their pits reach the rim, and so the level tile and the border beside them.
OPEN_PITS = {f"{name}_without_border": dataclasses.replace(cfg, border=0.0) for name, cfg in PITS.items()}
CASES: dict[str, TileCfg] = {
  **TYPES,
  "tilted_grid_steep": STEEP,
  "tilted_grid_small_cells": dataclasses.replace(STEEP, cell=0.4, border=0.0),
  "open_stairs_down": dataclasses.replace(TYPES["open_stairs"], inverted=True),
  **HOLES,
  **OPEN_PITS,
}
OPEN = {name for name in CASES if name.startswith("open_stairs")}
# Rise of a tread less its thickness at difficulty 1 [m]: what fits between two treads.
SLOT = 0.15
# Width of the ground around both tiles [m], so that few spheres roll off it.
BORDER = 12.0


class Case(Ground):
  """A tile at difficulty 1, a level one beside it and a border."""

  def __init__(self, name: str) -> None:
    self.name, self.spec = name, mujoco.MjSpec()
    types = {"it": CASES[name], "flat": FlatCfg()}
    self.terrain = TerrainGridCfg(types=types, rows=1, difficulty=(1.0, 1.0), border_width=BORDER).add_to(self.spec)
    super().__init__(self.spec)

  def with_spheres(self, bodies: list[np.ndarray], radii: list[float]) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The model with spheres that do not touch each other: for each body its centres, (n, 3) [m], and its radius."""
    spec = self.spec.copy()
    spec.option.timestep = 0.006
    for centres, radius in zip(bodies, radii, strict=True):
      body = spec.worldbody.add_body(pos=centres[0])
      body.add_freejoint()
      for centre in centres - centres[0]:
        body.add_geom(
          type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(radius, 0.0, 0.0), pos=centre, mass=1.0,
          contype=0, conaffinity=1, condim=6, friction=(0.6, 0.002, 0.002),
        )  # fmt: skip
    model = spec.compile()
    return model, mujoco.MjData(model)


@pytest.fixture(scope="module", params=CASES)
def ground(request: pytest.FixtureRequest) -> Case:
  return Case(request.param)


def test_a_grain_anywhere_below_the_surface_is_inside_something_solid(ground: Case) -> None:
  radius, count = 0.005, 600
  rng = np.random.default_rng(0)
  lowest = ground.terrain.height_range[0]
  # The tile of the type is at negative y; a part of the points is on its neighbour and on the border.
  xy = rng.uniform((-5.9, -9.9), (5.9, 9.9), (count, 2))
  top = ground.surface(xy)
  # Half of the grains lie close below the surface, where a thin roof would show, the others anywhere down to the pit.
  # A pit that does not reach the rim has a wall around it, and so the ground elsewhere need not be as deep.
  deepest = top - lowest + 0.9 if ground.name in OPEN_PITS else 0.9
  depth = np.where(rng.random(count) < 0.5, rng.uniform(0.02, 0.3, count), rng.uniform(0.02, deepest, count))
  grains = np.column_stack((xy, top - depth))
  model, data = ground.with_spheres([grains], [radius])
  for part in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_collision):
    part(model, data)
  hollow = np.ones(count, dtype=bool)
  hollow[data.contact.geom.max(axis=1) - ground.model.ngeom] = False
  if ground.name in OPEN:
    # A slot is one tread deep and as high as the rise leaves it.
    assert hollow.any()
    hollow &= depth > OpenStairsCfg().step_thickness + SLOT + radius
  assert not hollow.any(), f"{hollow.sum()} of {count} grains are in a hollow, the first at {grains[hollow][0]}"


def test_spheres_that_roll_over_it_stay_above_the_surface(ground: Case) -> None:
  radius = np.repeat((0.04, 0.12), 50)
  rng = np.random.default_rng(1)
  start = np.column_stack((rng.uniform((-3.9, -7.9), (3.9, 0.5), (100, 2)), np.zeros(100)))
  start[:, 2] = ground.surface(start) + radius + 0.2
  model, data = ground.with_spheres(list(start[:, None]), radius.tolist())
  data.qvel.reshape(-1, 6)[:, :2] = rng.uniform(-1.5, 1.5, (100, 2))
  mujoco.mj_step(model, data, nstep=270)
  # Those that fall from an edge at this moment slow down, for a fast impact is deeper than the tolerance.
  data.qvel[:] = 0.0
  mujoco.mj_step(model, data, nstep=28)
  rest = data.qpos.reshape(-1, 7)[:, :3]
  clearance = rest[:, 2] - radius - ground.surface(rest)
  under_a_tread = np.where(2.0 * radius < SLOT, SLOT + OpenStairsCfg().step_thickness, 0.0) * (ground.name in OPEN)
  assert (np.isfinite(clearance).reshape(2, 50).mean(1) > 0.7).all()
  assert np.nanmin(clearance + under_a_tread) > -0.02


def test_height_range_is_that_of_the_surface(ground: Case) -> None:
  x, y = np.meshgrid(np.linspace(-3.99, 3.99, 90), np.linspace(-7.99, 7.99, 150), indexing="ij")
  seen = ground.surface(np.column_stack((x.ravel(), y.ravel())))
  lowest, highest = ground.terrain.height_range
  # Rays 10 cm apart miss the very corner of a slope.
  reach = 0.1 if ground.name.startswith("tilted_grid") else 0.02
  assert lowest <= seen.min() + 1e-5 < lowest + reach
  assert highest - reach < seen.max() - 1e-5 <= highest


@dataclasses.dataclass(kw_only=True)
class Buried(TileCfg):
  """A slab far below a level surface, and one that shows through a slot of 2 cm."""

  slot: float = 0.0

  def build(self, tile: Tile) -> None:
    tile.slab(-3.0)
    tile.slab(-0.5)
    edge = 0.5 * tile.size[1]
    tile.box((-0.5 * tile.size[0], 0.33), (-edge, edge), (-0.5, 0.0))
    tile.box((0.33 + self.slot, 0.5 * tile.size[0]), (-edge, edge), (-0.5, 0.0))


def test_height_range_counts_what_shows_and_nothing_that_is_buried() -> None:
  for slot, lowest in ((0.0, 0.0), (0.02, -0.5)):
    terrain = Buried(slot=slot).add_to(mujoco.MjSpec())
    assert terrain.height_range == (lowest, 0.0)
