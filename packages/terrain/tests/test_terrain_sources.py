"""Ground from a user's own heights and meshes."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjlab_terrain import FlatCfg, HeightMapCfg, MeshCfg, TerrainGridCfg, TileCfg
from mjlab_terrain.types.mesh import seen_from_above
from PIL import Image
from terrain_ground import Added

# A wedge of 2 x 1 m that rises along x from 0 to 1 m, closed below.
WEDGE_VERTICES = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [2, 0, 1], [2, 1, 1]], dtype=float)
WEDGE_FACES = np.array([[0, 4, 5], [0, 5, 3], [0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 5], [1, 5, 4], [2, 3, 5]])
WEDGE = (WEDGE_VERTICES, WEDGE_FACES)


def test_the_default_size_of_a_mesh_tile_is_that_of_the_mesh() -> None:
  ground = Added(MeshCfg(source=WEDGE))
  assert ground.terrain.tile_size == pytest.approx((2.0, 1.0))
  for x, y in ((-0.9, 0.1), (0.0, -0.3), (0.77, 0.4)):
    assert ground.at(x, y) == pytest.approx(0.5 * (x + 1.0), abs=1e-6)


def test_a_mesh_is_a_tile_with_a_floor_around_it() -> None:
  types: dict[str, TileCfg] = {"mesh": MeshCfg(source=WEDGE, scale=2.0, floor=-0.1), "flat": FlatCfg()}
  ground = Added(TerrainGridCfg(types=types, rows=1, tile_size=(8.0, 6.0)))
  assert ground.at(1.0, -3.0) == pytest.approx(1.5, abs=1e-6)
  assert ground.at(-2.5, -3.0) == pytest.approx(-0.1, abs=1e-6)
  origin = ground.terrain.origins[0, 0]
  assert ground.at(origin[0], origin[1]) == pytest.approx(origin[2], abs=1e-6)


def test_spheres_rest_on_meshes_and_height_maps_where_geometry_says() -> None:
  """In a groove whose walls rise by 3 in 4, a sphere of radius r rests r / cos(wall) above the bottom line."""
  side = np.array([[-2, -2, 1.5], [-2, 2, 1.5], [0, 2, 0], [0, -2, 0], [2, 2, 1.5], [2, -2, 1.5]], dtype=float)
  groove = side, [[0, 3, 2], [0, 2, 1], [3, 5, 4], [3, 4, 2]]
  x = np.linspace(-2.0, 2.0, 81)
  heights = np.abs(x)[:, None] * np.ones(81) / 2.0
  types: dict[str, TileCfg] = {"mesh": MeshCfg(source=groove), "map": HeightMapCfg(source=heights, height=(0.75, 1.5))}
  for difficulty, walls in ((0.0, (0.75, 0.375)), (1.0, (0.75, 0.75))):
    spec, ends = mujoco.MjSpec(), (difficulty, difficulty)
    grid = TerrainGridCfg(types=types, rows=1, tile_size=(4.0, 4.0), difficulty=ends, border_width=0.0)
    terrain = grid.add_to(spec)
    for y in terrain.origins[0, :, 1]:
      ball = spec.worldbody.add_body(pos=(0.1, y, 1.0))
      ball.add_freejoint()
      ball.add_geom(size=(0.2, 0.0, 0.0), condim=6, friction=(1.0, 0.05, 0.05))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=2500)
    rest = data.qpos.reshape(-1, 7)[:, :3]
    for place, slope in zip(rest, walls, strict=True):
      assert place[2] == pytest.approx(0.2 * np.hypot(1.0, slope), abs=0.004)
      assert abs(place[0]) < 0.01


def test_difficulty_scales_a_mesh_by_its_height() -> None:
  for height, expected in (((1.0, 1.0), 0.5), ((0.0, 1.0), 0.125)):
    ground = Added(MeshCfg(source=WEDGE, height=height), difficulty=0.25)
    assert ground.at(0.0, 0.1) == pytest.approx(expected, abs=1e-6)


def test_the_highest_triangle_is_seen_from_above() -> None:
  rng = np.random.default_rng(0)
  vertices, faces = rng.uniform(-1.0, 1.0, (30, 3)), rng.integers(30, size=(20, 3))
  x, y = np.linspace(-1.0, 1.0, 41), np.linspace(-1.0, 1.0, 31)
  seen = seen_from_above(vertices, faces, x, y)
  # The same by solving for barycentric coordinates of all points.
  points = np.stack((*np.meshgrid(x, y, indexing="ij"), np.ones(seen.shape)))
  best = np.full(seen.shape, -np.inf)
  for face in faces:
    matrix = np.vstack((vertices[face, :2].T, np.ones(3)))
    if abs(np.linalg.det(matrix)) > 1e-9:
      weights = np.tensordot(np.linalg.inv(matrix), points, 1)
      height = np.tensordot(vertices[face, 2], weights, 1)
      best = np.where(weights.min(0) >= -1e-9, np.maximum(best, height), best)
  np.testing.assert_allclose(seen, best, atol=1e-9)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb"])
def test_files_of_many_formats_are_read(tmp_path: Path, suffix: str) -> None:
  trimesh = pytest.importorskip("trimesh")
  path = tmp_path / f"wedge.{suffix}"
  trimesh.Trimesh(*WEDGE).export(path)
  assert Added(MeshCfg(source=path)).at(0.5, 0.1) == pytest.approx(0.75, abs=1e-5)


@pytest.mark.parametrize(
  ("cfg", "message"),
  [
    (MeshCfg(source="nowhere.obj"), "MeshCfg 'it': the mesh 'nowhere.obj' cannot be read: .*No such file"),
    (MeshCfg(source=(np.zeros((3, 2)), [[0, 1, 2]])), r"vertices must be \(n, 3\)"),
    (MeshCfg(source=(np.zeros((3, 3)), [[0, 1, 3]])), "mesh of type tuple cannot be read: index 3 is out of bounds"),
    (MeshCfg(source=WEDGE, floor=float("nan")), "floor must be finite"),
    (MeshCfg(source=WEDGE, scale=10.0), "the mesh is 20 x 10 m, the tile 8 x 8 m; a scale of at most 4"),
    (MeshCfg(source=WEDGE, scale=-1.0), "scale -1.0 must be at least"),
  ],
)
def test_a_bad_mesh_is_refused_by_name(cfg: MeshCfg, message: str) -> None:
  with pytest.raises(ValueError, match=message):
    TerrainGridCfg(types={"it": cfg}).check()


def test_a_file_without_a_mesh_is_refused(tmp_path: Path) -> None:
  pytest.importorskip("trimesh")
  path = tmp_path / "not_a_mesh.obj"
  path.write_text("text")
  with pytest.raises(ValueError, match=r"MeshCfg 'it': the mesh '.*not_a_mesh.obj' cannot be read"):
    TerrainGridCfg(types={"it": MeshCfg(source=path)}).check()


def test_a_picture_is_seen_with_x_to_the_right_and_y_up(tmp_path: Path) -> None:
  pixels = np.zeros((20, 40, 3), dtype=np.uint8)
  # White in the upper right corner.
  pixels[:8, 30:] = 255
  path = tmp_path / "heights.png"
  Image.fromarray(pixels).save(path)
  ground = Added(HeightMapCfg(source=path, height=(0.5, 0.5)), tile_size=(4.0, 2.0))
  assert ground.at(1.7, 0.7) == pytest.approx(0.5, abs=1e-6)
  for x, y in ((-1.7, 0.7), (1.7, -0.7), (-1.7, -0.7)):
    assert ground.at(x, y) == pytest.approx(0.0, abs=1e-6)


def test_pictures_with_sixteen_bits_keep_them(tmp_path: Path) -> None:
  heights = np.arange(64 * 64, dtype=np.uint16).reshape(64, 64) * 16
  path = tmp_path / "deep.png"
  Image.fromarray(heights).save(path)
  assert len(np.unique(HeightMapCfg(source=path)._heights())) == 64 * 64


def test_a_border_brings_a_height_map_to_the_rim() -> None:
  ground = Added(HeightMapCfg(source=np.ones((81, 81)), border=0.5, blend=0.5), tile_size=(8.0, 8.0))
  assert ground.at(3.7, 0.3) == pytest.approx(0.0, abs=1e-6)
  assert ground.at(2.0, 0.3) == pytest.approx(1.0, abs=1e-6)


def test_a_missing_package_names_the_extra_that_has_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  monkeypatch.setitem(sys.modules, "trimesh", None)
  monkeypatch.delitem(sys.modules, "mjlab_terrain.view.page", raising=False)
  (tmp_path / "scan.obj").write_bytes(b"")
  with pytest.raises(ImportError, match="of the extra 'view' of mjlab-terrain"):
    importlib.import_module("mjlab_terrain.view.page")
  with pytest.raises(ValueError, match="of the extra 'mesh' of mjlab-terrain"):
    MeshCfg(source=tmp_path / "scan.obj").add_to(mujoco.MjSpec())
