"""Pictures of a terrain, the command that makes them, and the example."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mjlab_terrain import FlatCfg, HeightMapCfg, PyramidStairsCfg, TerrainGridCfg, all_types
from mjlab_terrain.picture import plot
from mjlab_terrain.png import png
from mjlab_terrain.settings import apply_settings, settings_of
from mjlab_terrain.triangles import triangles
from mjlab_terrain.visualize import main


def test_the_example_drops_its_spheres(capsys: pytest.CaptureFixture[str]) -> None:
  example = Path(__file__).parents[1] / "examples" / "drop_spheres.py"
  runpy.run_path(str(example), run_name="__main__")
  assert "200 of 200 spheres on the ground" in capsys.readouterr().out


def test_a_plot_shows_x_up_and_y_to_the_left() -> None:
  heights = np.zeros((41, 41))
  heights[30:, 30:] = 1.0
  cfg = TerrainGridCfg(types={"map": HeightMapCfg(source=heights)}, rows=1, border_width=0.0)
  pixels = plot(cfg, (200, 100)).astype(int)
  assert pixels.shape == (100, 100, 3)
  redness = pixels[..., 0] - pixels[..., 2]
  assert redness[5, 5] > 50
  assert max(redness[5, 95], redness[95, 5], redness[95, 95]) < 20


def test_an_image_is_written_without_opengl(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  path = tmp_path / "new" / "map.png"
  assert main(["all", "--rows", "2", "--plot", "--image", str(path), "--image-size", "680", "80"]) == 0
  assert "(plot)" in capsys.readouterr().out
  assert path.read_bytes().startswith(b"\x89PNG")


def test_an_image_is_written_whatever_there_is_of_opengl(tmp_path: Path) -> None:
  path = tmp_path / "stairs.png"
  command = [sys.executable, "-m", "mjlab_terrain.visualize", "stairs_up", "--difficulty", "0.5"]
  run = subprocess.run([*command, "--image", str(path), "--image-size", "160", "90"], capture_output=True, text=True)
  assert run.returncode == 0, run.stderr
  assert "(rendering)" in run.stdout or "(plot)" in run.stdout
  assert path.stat().st_size > 500


@pytest.mark.parametrize(
  ("words", "message"),
  [
    (["stair"], "there is no type 'stair'. There are all, walking, flat, stairs_up"),
    (["stairs_up", "--set", "platform=9"], "make the platform at most 5.9 m"),
    (["stairs_up", "--set", "waves.amplitude=0,1"], "there is no type 'waves' here. There are stairs_up"),
    (["stairs_up", "--set", "hight=3"], "there is no setting 'hight'. There are border"),
    (["stairs_up", "--set", "step_height=3"], "must be like (0.0, 0.2), without brackets"),
    (["stairs_up", "--set", "holes"], "has no value"),
    (["waves", "--seed", "-1"], "seed must not be negative"),
    (["waves", "--plot", "--image-size", "0", "9"], "--image-size 0 9: both must be at least 1 pixel"),
  ],
)
def test_a_mistake_on_the_command_line_says_what_there_is(
  words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
  assert main([*words, "--image", "never.png"]) == 2
  assert message in capsys.readouterr().err
  assert not Path("never.png").exists()


def test_a_picture_that_cannot_be_written_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  (tmp_path / "file").touch()
  for image, code in ((tmp_path / "file" / "x.png", 1), (tmp_path / "x.jpg", 2)):
    assert main(["flat", "--plot", "--image", str(image), "--image-size", "80", "60"]) == code
    captured = capsys.readouterr()
    assert not captured.out
    assert captured.err.startswith("visualize-terrain: ")
    assert captured.err.count("\n") == 1
    assert not image.exists()


def test_settings_are_read_as_what_they_are() -> None:
  types = all_types()
  apply_settings(types, ["stairs_up.step_height=0.1,0.3", "holes=yes", "num_beams=5", "mode=fixed"])
  stairs, grid, beams = types["stairs_up"], types["random_grid"], types["narrow_beams"]
  assert (vars(stairs)["step_height"], vars(stairs)["holes"]) == ((0.1, 0.3), True)
  assert vars(grid)["holes"] is True
  assert vars(beams)["num_beams"] == 5
  assert vars(types["discrete_obstacles"])["mode"] == "fixed"


def test_every_setting_of_every_type_is_shown_with_its_kind() -> None:
  kinds = {name: {s.name: s.kind for s in settings_of(cfg)} for name, cfg in all_types().items()}
  assert kinds["flat"] == {}
  assert kinds["stairs_up"] == {
    "step_height": "pair",
    "step_width": "number",
    "platform": "number",
    "border": "number",
    "inverted": "flag",
    "holes": "flag",
    "pit_depth": "number",
  }
  assert kinds["discrete_obstacles"]["mode"] == "choice"
  assert kinds["narrow_beams"]["num_beams"] == "whole"


def test_triangles_face_outwards_and_have_the_heights_of_the_ground() -> None:
  cfg = TerrainGridCfg(types={"up": PyramidStairsCfg(), "flat": FlatCfg()}, rows=2, border_width=0.0)
  vertices, faces, colors = triangles(cfg.tiles(), (), cfg.coloring())
  assert vertices.shape == colors.shape
  assert vertices[:, 2].max() == pytest.approx(1.2)
  a, b, c = (vertices[faces[:, k]] for k in range(3))
  # The volume under closed, outward triangles is positive, and for the flat column known.
  volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
  assert volume > 4 * 64.0


def test_a_picture_keeps_its_pixels(tmp_path: Path) -> None:
  image = pytest.importorskip("PIL.Image")
  pixels = np.random.default_rng(0).integers(256, size=(7, 5, 3), dtype=np.uint8)
  path = tmp_path / "noise.png"
  path.write_bytes(png(pixels))
  np.testing.assert_array_equal(np.asarray(image.open(path)), pixels)


def test_the_page_builds_what_its_controls_say() -> None:
  pytest.importorskip("trimesh")
  viser = pytest.importorskip("viser")
  from mjlab_terrain.page import Page

  server = viser.ViserServer(port=0, verbose=False)
  try:
    page = Page(TerrainGridCfg(rows=2), server)
    assert "14 tiles" in page._status.content
    page._choice.value = "stepping_stones"
    assert "2 tiles" in page._status.content
    page._tile_size.value = (1.0, 1.0)
    assert "Cannot be built" in page._status.content
    page._choice.value = "flat"
    assert "2 tiles of 2 boxes and 0 height fields, 12 triangles" in page._status.content
  finally:
    server.stop()


def test_difficulty_seed_and_settings_change_the_ground_that_the_page_shows() -> None:
  pytest.importorskip("trimesh")
  viser = pytest.importorskip("viser")
  from mjlab_terrain.page import Page

  server = viser.ViserServer(port=0, verbose=False)
  shown: list[np.ndarray] = []
  server.scene.add_mesh_trimesh = lambda name, mesh: shown.append(np.array(mesh.vertices))
  try:
    page = Page(TerrainGridCfg(types={"rough": all_types()["random_rough"]}, rows=1, border_width=0.0), server)
    page._easiest.value = page._hardest.value = 0.5
    easy = shown[-1]
    page._easiest.value = page._hardest.value = 1.0
    hard = shown[-1]
    assert np.ptp(hard[:, 2]) > 1.5 * np.ptp(easy[:, 2])
    page._seed.value = page._seed.value + 1
    assert not np.array_equal(shown[-1], hard)
    page._choice.value = "stairs_up"
    steps = shown[-1]
    page._settings["step_height"].value = (0.05, 0.1)
    assert shown[-1][:, 2].max() == pytest.approx(0.5 * steps[:, 2].max())
  finally:
    server.stop()
