"""What every type of tile promises, at every difficulty, on square and oblong tiles."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import mjlab_terrain
import mujoco
import numpy as np
import pytest
from mjlab_terrain import PerlinNoiseCfg, RandomBoxesCfg, RandomGridCfg, TerrainGridCfg, TileCfg, all_types
from mjlab_terrain.solids import MIN_THICKNESS, HeightField
from mjlab_terrain.surface import surface
from mjlab_terrain.tile import Tile
from terrain_ground import Ground

DIFFICULTIES = (0.0, 0.25, 0.5, 0.75, 1.0)
SHAPES = ((8.0, 8.0), (7.0, 9.5))
NAMES = tuple(all_types())

# Lowest and highest ground at difficulty 1 that the default settings allow [m].
BOUNDS = {
  "flat": (0.0, 0.0),
  "stairs_up": (0.0, 1.2 + 1e-9),
  "stairs_down": (-1.2 - 1e-9, 0.0),
  "open_stairs": (0.0, 2.0 + 1e-9),
  "random_stairs": (0.0, 1.2),
  "random_grid": (-0.3, 0.3),
  "random_boxes": (0.0, 0.3),
  "tilted_grid": (-0.55, 0.55),
  "stepping_stones": (-2.0, 0.1),
  "narrow_beams": (-2.0, 0.0),
  "nested_rings": (-2.0, 0.0),
  "slope_up": (0.0, 0.7 * 2.75 + 1e-9),
  "slope_down": (-0.7 * 2.75 - 1e-9, 0.0),
  "random_rough": (-0.05, 0.05),
  "waves": (-0.2, 0.2),
  "discrete_obstacles": (-0.3, 0.3),
  "perlin_noise": (0.0, 1.0),
}
# Types whose difficulty is how much of the tile is pit, and not how high it is.
GAPS = ("stepping_stones", "narrow_beams", "nested_rings")


def build(cfg: TileCfg, size: tuple[float, float], difficulty: float, seed: int = 0) -> Tile:
  cfg.check("tile", size)
  tile = Tile(size, difficulty, np.random.default_rng(seed))
  cfg.build(tile)
  return tile


def field_of(tile: Tile) -> HeightField:
  return next(solid for solid in tile.solids if isinstance(solid, HeightField))


def heights_of(tile: Tile, num: int = 120) -> np.ndarray:
  """On a grid of points that avoids edges, (num, num)."""
  x, y = (np.linspace(-0.5 * s, 0.5 * s, num + 2)[1:-1] + 1e-4 for s in tile.size)
  return surface(tile.solids, x, y)


@dataclass(kw_only=True)
class Kept(TerrainGridCfg):
  """Grid that keeps its tiles."""

  placed: list[Tile] = field(default_factory=list)

  def tiles(self) -> list[Tile]:
    self.placed = super().tiles()
    return self.placed


class Built(Ground):
  """All types (columns) at all difficulties (rows) in one model."""

  def __init__(self, size: tuple[float, float], types: dict[str, TileCfg], *, feet: bool = False, **grid: Any) -> None:
    self.cfg = Kept(types=types, tile_size=size, **grid)
    spec = mujoco.MjSpec()
    self.terrain = self.cfg.add_to(spec)
    self.placed = self.cfg.placed
    if feet:
      add_feet(spec, self)
    super().__init__(spec)


FOOT = np.array([0.1, 0.05, 0.02])


def add_feet(spec: mujoco.MjSpec, built: Built) -> None:
  """Boxes the size of a foot that fall onto the origin of each tile and somewhere else, and do not see each other."""
  offsets = np.random.default_rng(built.cfg.seed).uniform(-0.4, 0.4, (len(built.placed), 2)) * built.cfg.tile_size
  for xy in (built.terrain.origins.reshape(-1, 3)[:, :2], np.array([p.center[:2] for p in built.placed]) + offsets):
    for place, p in zip(xy, built.placed, strict=True):
      height = surface(p.solids, *(np.array([c]) for c in place - p.center[:2]))[0, 0]
      body = spec.worldbody.add_body(pos=(*place, height + 0.15))
      body.add_freejoint()
      body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=FOOT, mass=1.0, contype=0, conaffinity=1, group=3)
  spec.option.timestep = 0.005


@pytest.fixture(scope="module", params=[(SHAPES[0], 0), (SHAPES[1], 1), (SHAPES[0], 2)], ids=str)
def built(request: pytest.FixtureRequest) -> Built:
  size, seed = request.param
  return Built(size, all_types(), feet=True, rows=len(DIFFICULTIES), seed=seed, border_width=1.0)


def test_rows_have_the_difficulties_and_columns_the_types(built: Built) -> None:
  np.testing.assert_allclose(built.terrain.difficulty[:, 0], DIFFICULTIES)
  assert built.terrain.type_names == NAMES
  np.testing.assert_array_equal(built.terrain.tile_types[0], np.arange(len(NAMES)))


def test_no_geom_is_thin(built: Built) -> None:
  for geom in range(built.model.ngeom):
    if built.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX and built.model.geom_group[geom] == 0:
      assert built.model.geom_size[geom].min() >= 0.5 * MIN_THICKNESS - 1e-9


def test_origins_lie_on_the_surface_that_a_ray_hits(built: Built) -> None:
  origins = built.terrain.origins.reshape(-1, 3)
  np.testing.assert_allclose(built.surface(origins[:, :2]), origins[:, 2], atol=1e-6)


def test_every_ray_from_above_meets_ground_where_the_tile_says(built: Built) -> None:
  rng = np.random.default_rng(0)
  for p in built.placed:
    # Uneven steps, so that rays do not follow edges.
    x, y = (np.sort(rng.uniform(-0.5, 0.5, 7)) * s for s in built.cfg.tile_size)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    hit = built.surface(points + p.center[:2])
    expected = surface(p.solids, x, y).ravel()
    np.testing.assert_allclose(hit, expected, atol=1e-5, err_msg=NAMES[p.kind])


def test_seams_between_tiles_hold(built: Built) -> None:
  across = 0.5 * np.array(built.cfg.tile_size)
  points = np.array(
    [p.center[:2] + s * across * m for p in built.placed for s in (-1, 1) for m in ((1, 0.3), (0.3, 1))]
  )
  assert np.isfinite(built.surface(points)).all()


def test_geometry_stays_on_its_tile(built: Built) -> None:
  half = 0.5 * np.array(built.cfg.tile_size)
  for p in built.placed:
    for solid in p.solids:
      assert (np.maximum(-solid.low, solid.high)[:2] <= half + 1e-6).all(), NAMES[p.kind]


def test_heights_are_within_the_configured_bounds(built: Built) -> None:
  for p in built.placed:
    low, high = BOUNDS[NAMES[p.kind]]
    z = heights_of(p, 60)
    assert low - 1e-9 <= z.min(), NAMES[p.kind]
    assert z.max() <= high + 1e-9, NAMES[p.kind]
    assert built.terrain.height_range[0] - 1e-9 <= z.min()
    assert z.max() <= built.terrain.height_range[1] + 1e-9


def test_foot_sized_boxes_do_not_fall_through(built: Built) -> None:
  data = mujoco.MjData(built.model)
  mujoco.mj_step(built.model, data, nstep=160)
  position = data.qpos.reshape(-1, 7)[:, :3]
  for k, p in enumerate([*built.placed, *built.placed]):
    where = position[k] - p.center
    z = surface(p.solids, np.array([where[0]]), np.array([where[1]]))[0, 0]
    # A foot may slip under a tread, by no more than the rise and a tread's thickness.
    reach = 0.02 + (0.2 if NAMES[p.kind] == "open_stairs" else 0.0)
    if np.isfinite(z):
      assert position[k, 2] > z - reach, (NAMES[p.kind], p.difficulty)
    assert position[k, 2] > built.terrain.height_range[0] - 0.02, (NAMES[p.kind], p.difficulty)


def test_every_public_type_without_a_file_is_among_those_of_the_tests() -> None:
  public = {getattr(mjlab_terrain, name) for name in mjlab_terrain.__all__}
  types = {kind for kind in public if isinstance(kind, type) and issubclass(kind, TileCfg)}
  from_files = {TileCfg, mjlab_terrain.HeightMapCfg, mjlab_terrain.MeshCfg}
  assert types - from_files == {type(cfg) for cfg in all_types().values()}


@pytest.mark.parametrize("size", SHAPES)
@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_tile_and_another_seed_another(name: str, size: tuple[float, float]) -> None:
  first, again, other = (heights_of(build(all_types()[name], size, 1.0, seed), 40) for seed in (5, 5, 6))
  np.testing.assert_array_equal(first, again)
  levels = "flat", "stairs_up", "stairs_down", "open_stairs", "narrow_beams", "nested_rings"
  assert np.array_equal(first, other) == (name in (*levels, "slope_up", "slope_down", "waves"))


@pytest.mark.parametrize("size", SHAPES)
@pytest.mark.parametrize("name", NAMES)
def test_it_gets_harder_with_difficulty(name: str, size: tuple[float, float]) -> None:
  cfg = all_types()[name]
  z = [heights_of(build(cfg, size, d, seed=3)) for d in np.linspace(0.0, 1.0, 9)]
  if name in GAPS:
    # How much of the tile is pit, as far as the points can tell.
    hard = np.array([(h < -1.0).mean() for h in z])
    assert (np.diff(hard) > -2e-3).all(), hard
  else:
    # Largest differences of height, and the mean step from point to point.
    spread = np.array([np.ptp(h) for h in z])
    assert (np.diff(spread) > -1e-2 * spread.max() - 1e-9).all(), spread
    step = np.array([np.abs(np.diff(h, axis=0)).mean() for h in z])
    assert (np.diff(step) > -1e-2 * step.max() - 1e-9).all(), step
    hard = step
  if name == "flat":
    assert "Difficulty has no effect" in (type(cfg).__doc__ or "")
  else:
    assert hard[-1] > 1.2 * hard[0]


@pytest.mark.parametrize("name", NAMES)
def test_rims_of_neighbours_meet(name: str) -> None:
  tile = build(all_types()[name], (7.0, 9.5), 1.0)
  x, y = 3.5, 4.75
  for axes in (
    (np.array([-x + 1e-6, x - 1e-6]), np.linspace(-y, y, 99)),
    (np.linspace(-x, x, 99), np.array([-y + 1e-6, y - 1e-6])),
  ):
    np.testing.assert_allclose(surface(tile.solids, *axes), 0.0, atol=1e-6)


@pytest.mark.parametrize("size", [*SHAPES, (8.0, 31.0)])
@pytest.mark.parametrize("name", NAMES)
def test_nothing_around_the_spawn_rises_above_it(name: str, size: tuple[float, float]) -> None:
  for difficulty in DIFFICULTIES:
    tile = build(all_types()[name], size, difficulty)
    around = np.linspace(-0.25, 0.25, 11)
    z = surface(tile.solids, tile.spawn[0] + around, tile.spawn[1] + around)
    # Noise has no level places; its highest point near by is close to level.
    assert z.max() - z[5, 5] < 0.02
    assert np.hypot(*tile.spawn) < 1.5


VARIANTS = {
  "stairs_with_holes": dataclasses.replace(all_types()["stairs_up"], holes=True),
  "stairs_down_with_holes": dataclasses.replace(all_types()["stairs_down"], holes=True),
  "open_stairs_down": dataclasses.replace(all_types()["open_stairs"], inverted=True),
  "grid_with_holes": dataclasses.replace(all_types()["random_grid"], holes=True),
  "grid_with_levels": dataclasses.replace(all_types()["random_grid"], levels=4),
  "curved_slope": dataclasses.replace(all_types()["slope_up"], curved=True),
  "fixed_squares": dataclasses.replace(all_types()["discrete_obstacles"], mode="fixed", square=True),
  "beams_wider_than_the_platform": dataclasses.replace(all_types()["narrow_beams"], beam_width=(2.0, 0.8)),
  "steps_of_noise": dataclasses.replace(all_types()["random_rough"], step=0.02, spacing=0.3),
  **{f"{name}_to_the_rim": dataclasses.replace(cfg, border=0.0) for name, cfg in all_types().items() if name != "flat"},
}


@pytest.mark.parametrize("name", list(VARIANTS))
def test_every_row_of_a_long_curriculum_builds(name: str) -> None:
  for difficulty in (1e-6, *np.linspace(0.0, 0.2, 41)):
    for size in SHAPES:
      assert build(VARIANTS[name], size, difficulty).solids


def test_a_grid_with_holes_has_its_cross_however_wide_its_cells_become() -> None:
  # Four cells of 1.75 m along x: none has its centre within half a cell of what was asked for.
  tile = build(RandomGridCfg(holes=True, platform=0.1, cell=1.6), (7.5, 7.5), 0.0)
  z = surface(tile.solids, np.array([0.0, 3.0]), np.array([0.0, 3.0]))
  np.testing.assert_allclose(z, [[0.0, 0.0], [0.0, -2.0]], atol=1e-9)


def test_boxes_that_would_reach_over_the_border_are_left_out() -> None:
  ground, *boxes = build(RandomBoxesCfg(width=(3.0, 3.0), length=(6.4, 6.4)), (7.0, 31.0), 1.0).solids
  assert ground.is_plain
  assert boxes
  assert all((np.maximum(-box.low, box.high)[:2] <= (3.25 + 1e-9, 15.25 + 1e-9)).all() for box in boxes)


def test_noise_finer_than_a_cell_is_left_out_and_costs_nothing() -> None:
  coarse, fine = (build(PerlinNoiseCfg(octaves=n, lacunarity=4.0), (8.0, 8.0), 1.0) for n in (3, 12))
  np.testing.assert_array_equal(field_of(coarse).heights, field_of(fine).heights)


@pytest.mark.parametrize("name", list(VARIANTS))
def test_variants_build_and_agree_with_rays(name: str) -> None:
  for size in SHAPES:
    it = Built(size, {"it": VARIANTS[name]}, rows=3, border_width=0.0)
    test_origins_lie_on_the_surface_that_a_ray_hits(it)
    test_every_ray_from_above_meets_ground_where_the_tile_says(it)
    test_geometry_stays_on_its_tile(it)
    test_no_geom_is_thin(it)
