"""Pictures and the page of a terrain, and the example."""

from __future__ import annotations

import io
import runpy
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mjlab_terrain import FlatCfg, HeightMapCfg, PyramidStairsCfg, TerrainGridCfg, all_types
from mjlab_terrain.colors import as_pixels, color_of, picture_of
from mjlab_terrain.presets import apply_settings
from mjlab_terrain.solids import HeightField
from mjlab_terrain.view.picture import plot
from PIL import Image


@pytest.fixture
def open_page() -> Iterator[Callable[[TerrainGridCfg], Any]]:
  """Function that opens a page of a terrain without a browser."""
  pytest.importorskip("trimesh")
  viser = pytest.importorskip("viser")
  from mjlab_terrain.view.page import Page

  server = viser.ViserServer(port=0, verbose=False)
  yield lambda cfg: Page(cfg, server)
  server.stop()


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


def test_settings_are_read_by_their_kind() -> None:
  types = all_types()
  apply_settings(types, ["stairs_up.step_height=0.1,0.3", "holes=yes", "num_beams=5", "mode=fixed"])
  stairs, grid, beams, obstacles = (
    vars(types[name]) for name in ("stairs_up", "random_grid", "narrow_beams", "discrete_obstacles")
  )
  assert (stairs["step_height"], stairs["holes"], grid["holes"]) == ((0.1, 0.3), True, True)
  assert (beams["num_beams"], obstacles["mode"]) == (5, "fixed")


@pytest.mark.parametrize(
  ("assignment", "message"),
  [
    ("stairs_up.step_height=0.3", r"the value must be like \(0.0, 0.2\), without brackets"),
    ("holes=maybe", "the value must be like False"),
    ("levels=many", "the value must be like None"),
    ("mode=5", "the value must be like 'choice'"),
    ("stairs.holes=yes", "there is no type 'stairs' here"),
    ("flat.holes=yes", "there is no setting 'holes'. There are share"),
  ],
)
def test_an_impossible_setting_is_refused(assignment: str, message: str) -> None:
  with pytest.raises(ValueError, match=message):
    apply_settings(all_types(), [assignment])


def test_every_setting_of_a_type_has_a_control_of_its_kind(open_page: Callable[[TerrainGridCfg], Any]) -> None:
  page, kinds = open_page(TerrainGridCfg(rows=1, border_width=0.0)), {}
  for name in all_types():
    page._choice.value = name
    kinds[name] = {setting: type(control.value) for setting, control in page._settings.items()}
  assert kinds["flat"] == {}
  stairs = {"step_height": tuple, **dict.fromkeys(("step_width", "platform", "border", "pit_depth"), float)}
  assert kinds["stairs_up"] == stairs | {"inverted": bool, "holes": bool}
  assert kinds["discrete_obstacles"]["mode"] is str
  assert kinds["narrow_beams"]["num_beams"] is int
  assert "levels" not in kinds["random_grid"]


def test_triangles_face_outwards_and_have_the_heights_of_the_ground() -> None:
  pytest.importorskip("viser")
  from mjlab_terrain.view.page import ground_mesh

  cfg = TerrainGridCfg(types={"up": PyramidStairsCfg(), "flat": FlatCfg()}, rows=2, border_width=0.0)
  mesh = ground_mesh(cfg.tiles(), cfg.color)
  assert mesh.bounds[1, 2] == pytest.approx(1.2)
  # The volume under closed, outward triangles is positive, and for the flat column known.
  assert mesh.volume > 4 * 64.0
  heights = np.random.default_rng(0).uniform(0.0, 1.0, (5, 7))
  field = ground_mesh(TerrainGridCfg(types={"map": HeightMapCfg(source=heights)}, rows=1).tiles(), "height")
  np.testing.assert_allclose(field.vertices[:, 2], heights.ravel())
  assert (field.face_normals[:, 2] > 0.0).all()
  assert field.area_faces @ field.face_normals[:, 2] == pytest.approx(64.0)


def test_the_picture_of_a_height_field_is_a_png_with_its_colors() -> None:
  heights = np.random.default_rng(0).uniform(-2.0, 2.0, (5, 7))
  field = HeightField(center=np.zeros(3), half=(0.5, 0.5), bottom=-3.0, heights=heights)
  read = np.asarray(Image.open(io.BytesIO(picture_of(field, "height"))))
  pixels = as_pixels(color_of("height", 0, heights))
  # First line at the far end of y, x to the right.
  np.testing.assert_array_equal(read, pixels.transpose(1, 0, 2)[::-1])


def test_the_page_builds_what_its_controls_say(open_page: Callable[[TerrainGridCfg], Any]) -> None:
  page = open_page(TerrainGridCfg(rows=2))
  assert "14 tiles" in page._status.content
  page._choice.value = "stepping_stones"
  assert "2 tiles" in page._status.content
  page._controls["tile_size"].value = (1.0, 1.0)
  assert "Cannot be built" in page._status.content
  page._choice.value = "flat"
  assert "2 tiles of 2 solids, 12 triangles" in page._status.content


def test_difficulty_seed_and_settings_change_the_ground_that_the_page_shows(
  open_page: Callable[[TerrainGridCfg], Any],
) -> None:
  page = open_page(TerrainGridCfg(types={"rough": all_types()["random_rough"]}, rows=1, border_width=0.0))
  shown: list[np.ndarray] = []
  page._server.scene.add_mesh_trimesh = lambda name, mesh: shown.append(np.array(mesh.vertices))
  page._controls["difficulty"].value = (0.5, 0.5)
  easy = shown[-1]
  page._controls["difficulty"].value = (1.0, 1.0)
  hard = shown[-1]
  assert np.ptp(hard[:, 2]) > 1.5 * np.ptp(easy[:, 2])
  page._controls["seed"].value += 1
  assert not np.array_equal(shown[-1], hard)
  page._choice.value = "stairs_up"
  steps = shown[-1]
  page._settings["step_height"].value = (0.05, 0.1)
  assert shown[-1][:, 2].max() == pytest.approx(0.5 * steps[:, 2].max())


def test_the_page_listens_on_loopback_names_every_tile_and_ignores_other_connections(
  caplog: pytest.LogCaptureFixture,
) -> None:
  from mjlab_terrain.view.page import open_page

  cfg = TerrainGridCfg(types={"flat": FlatCfg(), "stairs_up": PyramidStairsCfg()}, rows=2, columns=2)
  server = open_page(cfg, "127.0.0.1", 8080)
  try:
    assert server.get_host() == "127.0.0.1"
    labels = [
      message.props.text
      for message in server.scene._websock_interface._broadcast_buffer.message_from_id.values()
      if type(message).__name__ == "LabelMessage"
    ]
    assert sorted(labels) == ["flat", "flat", "stairs up", "stairs up"]
    with socket.create_connection(("127.0.0.1", server.get_port())) as connection:
      connection.shutdown(socket.SHUT_WR)
      while connection.recv(4096):
        pass
  finally:
    server.stop()
  assert "handshake" not in caplog.text


def test_a_plot_names_every_tile() -> None:
  cfg = TerrainGridCfg(types={"flat": FlatCfg()}, rows=2, columns=2, border_width=0.0)
  plain, named = plot(cfg, (200, 200)).astype(int), plot(cfg, (200, 200), names=True).astype(int)
  changed = np.abs(named - plain).sum(-1) > 0
  for rows in (slice(0, 100), slice(100, 200)):
    for columns in (slice(0, 100), slice(100, 200)):
      assert changed[rows, columns].any()
