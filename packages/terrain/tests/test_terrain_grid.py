"""The grid: what goes where, what it says of itself, and what it refuses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from mjlab_terrain import (
  FlatCfg,
  FlatPatchCfg,
  HeightMapCfg,
  NarrowBeamsCfg,
  NestedRingsCfg,
  PerlinNoiseCfg,
  PlaneCfg,
  PyramidSlopeCfg,
  PyramidStairsCfg,
  RandomBoxesCfg,
  RandomGridCfg,
  RandomRoughCfg,
  SteppingStonesCfg,
  TerrainGridCfg,
  Tile,
  TileCfg,
  WavesCfg,
  all_types,
)
from mjlab_terrain.assembly import merge_boxes
from mjlab_terrain.solids import box_between
from terrain_ground import Added

FRICTION = (0.7, 0.01, 0.001)


def test_a_grid_of_ten_by_twenty_has_few_geoms() -> None:
  grid = Added(TerrainGridCfg(types=all_types(), rows=10, columns=20))
  model, terrain = grid.model, grid.terrain
  assert terrain.origins.shape == (10, 20, 3)
  assert model.ngeom < 6500
  assert model.ngeom == len(terrain.geom_names) == len(set(terrain.geom_names))


def test_all_geoms_are_static_in_group_zero_and_weigh_nothing() -> None:
  grid = Added(TerrainGridCfg(rows=2))
  model, terrain = grid.model, grid.terrain
  body = model.body(terrain.name)
  assert (model.geom_bodyid == body.id).all()
  assert model.body_weldid[body.id] == 0
  assert body.mass[0] == 0.0
  assert (model.geom_group == 0).all()
  assert [model.geom(name).id for name in terrain.geom_names] == list(range(model.ngeom))


@pytest.mark.parametrize("cfg", [TerrainGridCfg(rows=2, friction=FRICTION), PlaneCfg(friction=FRICTION)])
def test_geoms_do_not_depend_on_the_defaults_of_the_model(cfg: TerrainGridCfg | PlaneCfg) -> None:
  spec = mujoco.MjSpec.from_string(
    '<mujoco><default><geom contype="0" conaffinity="0" group="3" friction="9 9 9" type="sphere"/></default></mujoco>'
  )
  cfg.add_to(spec)
  model = spec.compile()
  assert (model.geom_contype == 1).all()
  assert (model.geom_conaffinity == 1).all()
  assert (model.geom_group == 0).all()
  np.testing.assert_allclose(model.geom_friction, np.tile(FRICTION, (model.ngeom, 1)))


def test_the_same_settings_give_the_same_model() -> None:
  def xml(seed: int) -> str:
    types: dict[str, TileCfg] = {"noise": PerlinNoiseCfg(), "boxes": RandomBoxesCfg()}
    spec = mujoco.MjSpec()
    TerrainGridCfg(types=types, rows=2, seed=seed, layout="random").add_to(spec)
    spec.compile()
    return spec.to_xml() + str(sorted(spec.assets.items()))

  assert xml(1) == xml(1)
  assert xml(1) != xml(2)


def test_a_model_written_as_xml_comes_back_the_same() -> None:
  spec = mujoco.MjSpec()
  TerrainGridCfg(types=all_types(), rows=2).add_to(spec)
  model = spec.compile()
  again = mujoco.MjSpec.from_string(spec.to_xml(), assets=spec.assets).compile()
  np.testing.assert_allclose(again.geom_size, model.geom_size, atol=1e-3)
  np.testing.assert_allclose(again.hfield_data, model.hfield_data, atol=1e-4)
  np.testing.assert_array_equal(again.tex_data, model.tex_data)


def test_a_tile_does_not_depend_on_the_others() -> None:
  small, large = (
    TerrainGridCfg(types={"rough": RandomRoughCfg()}, rows=rows, difficulty=(1.0, 1.0)).tiles() for rows in (3, 9)
  )
  first, same, other = (vars(p.solids[0])["heights"] for p in (small[1], large[1], small[2]))
  np.testing.assert_array_equal(first, same)
  assert not np.array_equal(first, other)


def test_a_curriculum_has_columns_by_share_and_rows_by_difficulty() -> None:
  shares = {"a": 6.0, "off": 0.0, "b": 3.0, "c": 0.01}
  types: dict[str, TileCfg] = {name: FlatCfg(share=share) for name, share in shares.items()}
  terrain = Added(TerrainGridCfg(types=types, rows=5, columns=10, difficulty=(0.2, 0.6))).terrain
  assert terrain.type_names == ("a", "b", "c")
  counts = np.bincount(terrain.tile_types[0])
  assert counts.min() == 1
  assert tuple(counts) == (6, 3, 1)
  assert (terrain.tile_types == terrain.tile_types[0]).all()
  np.testing.assert_allclose(terrain.difficulty, np.repeat([[0.2], [0.3], [0.4], [0.5], [0.6]], 10, axis=1))
  by_type = [terrain.column_shares[terrain.tile_types[0] == k].sum() for k in range(3)]
  np.testing.assert_allclose(by_type, np.array([6.0, 3.0, 0.01]) / 9.01)


def test_a_curriculum_has_one_column_for_each_type_by_default() -> None:
  terrain = Added(TerrainGridCfg(rows=2)).terrain
  assert terrain.origins.shape == (2, 7, 3)
  np.testing.assert_allclose(terrain.column_shares, [0.2, 0.2, 0.2, 0.1, 0.1, 0.1, 0.1])
  assert terrain.columns_of(1000).tolist().count(1) == 200


def test_a_random_layout_draws_types_by_share_and_difficulty_from_its_range() -> None:
  types: dict[str, TileCfg] = {"a": FlatCfg(share=3.0), "b": FlatCfg(share=1.0)}
  cfg = TerrainGridCfg(types=types, rows=20, columns=30, layout="random", difficulty=(0.4, 0.5))
  terrain = Added(cfg).terrain
  assert terrain.difficulty.min() >= 0.4
  assert terrain.difficulty.max() <= 0.5
  assert abs((terrain.tile_types == 0).mean() - 0.75) < 0.05
  np.testing.assert_allclose(terrain.column_shares, 1.0 / 30)


def test_worlds_are_spread_by_share_and_evenly() -> None:
  terrain = Added(TerrainGridCfg(types={"a": FlatCfg(share=0.75), "b": FlatCfg(share=0.25)}, rows=3)).terrain
  columns = terrain.columns_of(64)
  assert np.bincount(columns).tolist() == [48, 16]
  assert np.bincount(columns[:32]).tolist() == [24, 8]
  origins = terrain.env_origins(64, spacing=1.0)
  for column, number in ((0, 48), (1, 16)):
    rows, counts = np.unique(origins[columns == column][:, 0], return_counts=True)
    assert len(rows) == 3
    assert counts.max() - counts.min() <= 1
    assert counts.sum() == number


def test_tiles_lie_side_by_side_around_the_origin() -> None:
  terrain = Added(TerrainGridCfg(types={"a": FlatCfg(), "b": FlatCfg()}, rows=3, tile_size=(4.0, 6.0))).terrain
  np.testing.assert_allclose(terrain.origins[:, 0, 0], [-4.0, 0.0, 4.0])
  np.testing.assert_allclose(terrain.origins[0, :, 1], [-3.0, 3.0])


def test_a_border_surrounds_the_grid_at_the_height_of_the_rims() -> None:
  ground = Added(TerrainGridCfg(types={"slope": PyramidSlopeCfg()}, rows=2, tile_size=(4.0, 6.0), border_width=3.0))
  for x, y in ((6.9, 0.0), (-6.9, 0.0), (0.0, 5.9), (0.0, -5.9), (6.9, 5.9), (4.01, 3.01)):
    assert ground.at(x, y) == pytest.approx(0.0, abs=1e-9)
  assert np.isnan(ground.at(7.1, 0.0))


@pytest.mark.parametrize("axis", [0, 1])
def test_a_ramp_along_an_axis_is_a_ramp_along_it(axis: int) -> None:
  heights = np.linspace(0.0, 1.0, 30)[:, None] * np.ones(20)
  heights = heights if axis == 0 else heights.T
  ground = Added(HeightMapCfg(source=heights), tile_size=(6.0, 3.0))
  model = ground.model
  for x, y in ((-2.0, 1.0), (1.3, 0.2), (2.9, -1.4)):
    expected = (x + 3.0) / 6.0 if axis == 0 else (y + 1.5) / 3.0
    assert ground.at(x, y) == pytest.approx(expected, abs=1e-6)
  # The picture that colors it has its first line at the far end of y, and x from left to right.
  picture = model.tex_data.reshape(model.tex_height[0], model.tex_width[0], 3)
  top = np.array([0.85, 0.50, 0.32]) * 255
  there = picture[:, -1] if axis == 0 else picture[0]
  elsewhere = picture[:, 0] if axis == 0 else picture[-1]
  assert np.abs(there.mean(0) - top).max() < 40
  assert np.abs(elsewhere.mean(0) - top).max() > 40


def test_level_neighbours_become_one_geom_and_a_stair_needs_one_a_step() -> None:
  def geoms(cfg: TileCfg, **grid: Any) -> int:
    return Added(TerrainGridCfg(types={"it": cfg}, difficulty=(1.0, 1.0), **grid)).model.ngeom

  assert geoms(FlatCfg(), rows=10, columns=10, border_width=0.0) == 1
  assert geoms(RandomGridCfg(levels=3), rows=1) < 0.75 * geoms(RandomGridCfg(), rows=1)
  # Five steps and the platform, and a rim of four.
  assert geoms(PyramidStairsCfg(), rows=1, border_width=0.0) == 10


def test_merging_keeps_the_volume_and_kinds_apart() -> None:
  rng = np.random.default_rng(0)
  i, j = (a.ravel() for a in np.meshgrid(np.arange(12), np.arange(9), indexing="ij"))
  top = rng.integers(1, 3, i.shape)
  low = np.stack((0.1 * i, 0.2 * j, np.zeros(i.shape)), -1, dtype=np.float64)
  high = np.stack((0.1 * (i + 1), 0.2 * (j + 1), top), -1, dtype=np.float64)
  kind = rng.integers(2, size=i.shape)
  order = rng.permutation(len(kind))
  merged = merge_boxes([box_between(*zip(low[k], high[k], strict=True), kind=int(kind[k])) for k in order])
  merged_low, merged_high = (np.array([getattr(box, end) for box in merged]) for end in ("low", "high"))
  merged_kind = np.array([box.kind for box in merged])
  assert len(merged_low) < len(low)
  for which in (0, 1):
    before, after = (high - low)[kind == which], (merged_high - merged_low)[merged_kind == which]
    assert before.prod(1).sum() == pytest.approx(after.prod(1).sum())
  centers = 0.5 * (low + high)
  inside = ((merged_low[:, None] <= centers) & (centers <= merged_high[:, None])).all(-1)
  assert (inside.sum(0) == 1).all()
  np.testing.assert_array_equal(merged_kind[inside.argmax(0)], kind)


def test_merging_keeps_a_box_that_ends_where_a_shorter_one_does() -> None:
  long, short = (box_between((start, 2), (0, 1), (0, 1)) for start in (0, 1))
  for boxes in ([long, short], [short, long]):
    assert max(box.high[0] - box.low[0] for box in merge_boxes(boxes)) == 2.0


def test_colors_show_height_type_or_neither() -> None:
  types: dict[str, TileCfg] = {"up": PyramidStairsCfg(), "flat": FlatCfg()}
  colors: tuple[Any, ...] = ("height", "type", (0.1, 0.2, 0.3))
  by_height, by_type, plain = (Added(TerrainGridCfg(types=types, rows=2, color=color)).model for color in colors)
  assert len(np.unique(by_height.geom_rgba, axis=0)) == 7
  # The border is of the first type.
  assert len(np.unique(by_type.geom_rgba, axis=0)) == 8
  np.testing.assert_allclose(np.unique(plain.geom_rgba, axis=0), [(0.1, 0.2, 0.3, 1.0)], rtol=1e-6)


@pytest.mark.parametrize("size", [(8.0, 8.0), (6.0, 9.5)])
def test_flat_patches_are_level_on_the_surface_and_on_their_tile(size: tuple[float, float]) -> None:
  patches = {"feet": FlatPatchCfg(count=5, radius=0.25), "low": FlatPatchCfg(count=3, radius=0.1, z_range=(-9.0, 0.0))}
  types: dict[str, TileCfg] = {
    "stairs": PyramidStairsCfg(), "stones": SteppingStonesCfg(), "waves": WavesCfg(), "slope": PyramidSlopeCfg()
  }  # fmt: skip
  ground = Added(TerrainGridCfg(types=types, rows=2, tile_size=size, flat_patches=patches))
  terrain = ground.terrain
  places = terrain.flat_patches["feet"]
  assert places.shape == (2, 4, 5, 3)
  for row, column in np.ndindex(2, 4):
    center = (np.array((row, column)) - (0.5, 1.5)) * size
    for place in places[row, column]:
      assert ground.at(place[0], place[1]) == pytest.approx(place[2], abs=1e-6)
      assert (np.abs(place[:2] - center) <= 0.5 * np.array(size) - 0.25 + 1e-9).all()
      # Turned a little, so that no ray follows the edge between two boxes.
      for angle in 0.1 + np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
        there = ground.at(place[0] + 0.24 * np.cos(angle), place[1] + 0.24 * np.sin(angle))
        assert there == pytest.approx(place[2], abs=0.055)
  assert (terrain.flat_patches["low"][..., 2] <= 1e-9).all()
  assert len(np.unique(places[0, 0], axis=0)) == 5


@pytest.mark.parametrize(
  ("size", "patch"),
  [
    # No point of the grid is in the range, or far enough from the rim.
    ((8.0, 8.0), FlatPatchCfg(radius=0.3, x_range=(0.51, 0.53), y_range=(-1.02, -1.01))),
    ((1.05, 8.0), FlatPatchCfg(radius=0.525)),
    ((0.7, 0.7), FlatPatchCfg(radius=0.3, resolution=0.5)),
  ],
)
def test_a_narrow_range_of_patches_is_kept_to_within_the_resolution(
  size: tuple[float, float], patch: FlatPatchCfg
) -> None:
  grid = TerrainGridCfg(types={"flat": FlatCfg()}, tile_size=size, rows=1, flat_patches={"p": patch})
  places = grid.add_to(mujoco.MjSpec()).flat_patches["p"][0, 0]
  for axis, (low, high) in enumerate((patch.x_range, patch.y_range)):
    reach = 0.5 * size[axis] - patch.radius
    assert (places[:, axis] >= max(low, -reach) - 0.5 * patch.resolution).all()
    assert (places[:, axis] <= min(high, reach) + 0.5 * patch.resolution).all()


def test_without_level_places_patches_are_the_most_level_one() -> None:
  rough, patch = RandomRoughCfg(amplitude=(0.1, 0.1)), FlatPatchCfg(count=3, radius=1.0, max_height_difference=0.0)
  terrain = Added(TerrainGridCfg(types={"rough": rough}, rows=1, flat_patches={"none": patch})).terrain
  assert len(np.unique(terrain.flat_patches["none"][0, 0], axis=0)) == 1


# Replaces settings by values of any type.
replaced: Callable[..., Any] = dataclasses.replace
GOOD = TerrainGridCfg(types={"it": FlatCfg()})


BAD: list[tuple[TileCfg, str]] = [
  (PyramidStairsCfg(step_height=(-0.1, 0.2)), r"step_height \(-0.1, 0.2\) must be at least 0; \(0.0, 0.2\) would work"),
  (PyramidStairsCfg(step_height=(0.2, 0.1)), r"must grow with difficulty; \(0.1, 0.2\) would work"),
  (PyramidStairsCfg(step_width=0.01), "step_width 0.01 must be at least 0.05; 0.05 would work"),
  (replaced(PyramidStairsCfg(), step_height=0.2), r"step_height must be \(easiest, hardest\), got 0.2"),
  (PyramidStairsCfg(platform=9.0), "make the platform at most 5.9 m, or the tile at least 11.1 m"),
  (PyramidStairsCfg(border=4.0), "make the border at most 2 m"),
  (PyramidStairsCfg(border=0.01), "a Box of .* m, 0.01 m thick, is not finite or thinner than 0.05 m"),
  (PyramidStairsCfg(share=-1.0), "share -1.0 must be at least 0; 0"),
  (NarrowBeamsCfg(num_beams=0), "num_beams 0 must be at least 1; 1 would work"),
  (replaced(NarrowBeamsCfg(), num_beams=1.5), "num_beams must be a whole number"),
  (NarrowBeamsCfg(beam_width=(0.2, 0.8)), r"must fall with difficulty; \(0.8, 0.2\) would work"),
  (NarrowBeamsCfg(num_beams=200), "num_beams 200 leaves no gaps between beams; at most 116 would work"),
  (NestedRingsCfg(ring_width=(3.0, 3.0)), "no ring fits between border and platform; make the tile at least 9.1 m"),
  (RandomBoxesCfg(width=(1.0, 9.0)), "does not fit inside the border of a tile of 8 x 8 m; at most 7.5 m would work"),
  (RandomBoxesCfg(height=(0.3, 0.1)), "must go from low to high"),
  (RandomGridCfg(cell=8.0), "at most 7.5 m would work"),
  (RandomRoughCfg(step=0.0), "step 0.0 must be at least 0.001"),
  (RandomRoughCfg(amplitude=(0.0, float("nan"))), "amplitude must be finite"),
  (SteppingStonesCfg(stone_size=(0.05, 0.05)), "stone_size"),
  (HeightMapCfg(source="nowhere.png"), "height map 'nowhere.png' cannot be read"),
  (HeightMapCfg(source=np.zeros((3, 1))), r"at least \(2, 2\), and finite; got \(3, 1\)"),
]


@pytest.mark.parametrize(("tile", "message"), BAD, ids=[f"{type(t).__name__}-{k}" for k, (t, _) in enumerate(BAD)])
def test_a_bad_type_is_refused_by_name_and_leaves_the_model_alone(tile: TileCfg, message: str) -> None:
  spec = mujoco.MjSpec()
  with pytest.raises(ValueError, match=rf"^{type(tile).__name__} 'it': .*{message}.*\.$"):
    dataclasses.replace(GOOD, types={"it": tile}).add_to(spec)
  assert len(spec.bodies) == 1
  assert not spec.hfields


@pytest.mark.parametrize(
  ("change", "message"),
  [
    ({"types": {"a": FlatCfg(share=0.0)}}, "the shares of types .'a'. sum to 0; give one of them a share of 1"),
    ({"types": {"a": FlatCfg(), "b": FlatCfg()}, "columns": 1}, "at least 2 would work"),
    ({"rows": 0}, "rows 0 must be at least 1; 1 would work"),
    ({"rows": 2.0}, "rows must be a whole number, got 2.0"),
    ({"seed": 1.5}, "seed must be a whole number, got 1.5"),
    ({"tile_size": (8.0, 0.0)}, r"tile_size \(8.0, 0.0\) must be at least 0.5; \(8.0, 0.5\) would work"),
    ({"tile_size": 8.0}, r"tile_size must be \(2 numbers\), got 8.0"),
    ({"columns": 0}, "columns 0 must be at least 1; 1 would work"),
    ({"layout": "curiculum"}, "layout must be 'curriculum' or 'random', got 'curiculum'"),
    ({"difficulty": (0.5, 1.5)}, r"between 0 and 1; \(0.5, 1.0\) would work"),
    ({"difficulty": (1.0, 0.0)}, "must go from low to high"),
    ({"seed": -3}, "seed -3 must be at least 0; 0 would work"),
    ({"border_width": -1.0}, "border_width -1.0 must be at least 0; 0"),
    ({"border_width": 0.01}, "a Box of .* m, 0.01 m thick, is not finite or thinner than 0.05 m"),
    ({"color": "hight"}, "color must be 'height', 'type' or three numbers"),
    ({"friction": (-1.0, 0.0, 0.0)}, r"friction \(-1.0, 0.0, 0.0\) must be at least 0"),
    ({"flat_patches": {"p": FlatPatchCfg(radius=5.0)}}, "FlatPatchCfg 'p': radius 5 m does not fit.*at most 4 m"),
    ({"flat_patches": {"p": FlatPatchCfg(x_range=(5.0, 6.0))}}, "x_range .* centres can be from -3.5 to 3.5 m"),
    ({"flat_patches": {"p": FlatPatchCfg(count=0)}}, "FlatPatchCfg 'p': count 0 must be at least 1"),
  ],
)
def test_a_bad_grid_is_refused_with_what_would_work(change: dict[str, Any], message: str) -> None:
  spec = mujoco.MjSpec()
  with pytest.raises(ValueError, match=message):
    dataclasses.replace(GOOD, **change).add_to(spec)
  assert len(spec.bodies) == 1


@pytest.mark.parametrize("cfg", [GOOD, PlaneCfg()], ids=["grid", "plane"])
def test_names_that_are_taken_are_refused_before_anything_is_added(cfg: Any) -> None:
  spec = mujoco.MjSpec()
  spec.modelname = "mine"
  cfg.add_to(spec)
  before = spec.to_xml()
  with pytest.raises(ValueError, match="'terrain': the model 'mine' already has a body named 'terrain'"):
    cfg.add_to(spec)
  assert spec.to_xml() == before
  dataclasses.replace(cfg, name="second").add_to(spec)
  assert spec.compile().nbody == 3


def test_a_name_of_a_geom_that_is_taken_is_refused() -> None:
  other = mujoco.MjSpec()
  other.worldbody.add_geom(name="terrain_0", size=(1, 0, 0))
  with pytest.raises(ValueError, match="already has a geom named 'terrain_0'"):
    GOOD.add_to(other)


@dataclasses.dataclass(kw_only=True)
class Broken(TileCfg):
  build_it: Callable[[Tile], None]

  def build(self, tile: Tile) -> None:
    self.build_it(tile)


AT = r"at difficulty 0, tile \(0, 0\): .*"


@pytest.mark.parametrize(
  ("build", "message"),
  [
    (lambda tile: tile.box((-1.0, 1.0), (-1.0, 1.0), (0.0, 0.01)), AT + "a Box of 2 x 2 x 0.01 m, 0.01 m thick, is"),
    (lambda tile: None, "build added no geometry"),
    (lambda tile: tile.heights(np.full((5, 5), np.nan)), AT + "a HeightField .* is not finite"),
    (lambda tile: tile.box((0.0, np.nan), (0.0, 1.0), (0.0, 1.0)), AT + "is not finite"),
    (lambda tile: tile.box((0.0, 1.0), (0.0, 1.0), (-1.0, 0.0), slope=(0.0, np.nan)), AT + "is not finite"),
    (lambda tile: tile.box((0.0, 1.0), (0.0, 1.0), (-1.0, 0.0), slope=(1.0, 0.96)), AT + "a Box of .* m, 0.02 m thick"),
  ],
)
def test_a_type_that_builds_nonsense_is_named_and_nothing_is_added(build: Callable[[Tile], None], message: str) -> None:
  spec = mujoco.MjSpec()
  with pytest.raises(ValueError, match=f"Broken 'it': {message}"):
    dataclasses.replace(GOOD, types={"it": Broken(build_it=build)}).add_to(spec)
  assert len(spec.bodies) == 1
