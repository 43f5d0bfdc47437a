"""Browser page that shows a terrain, with controls for its settings."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import logging
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np

from mjlab_terrain.assembly import gather
from mjlab_terrain.checked_fields import rule_of
from mjlab_terrain.colors import GroundColor, as_pixels, color_of
from mjlab_terrain.grid import TerrainGridCfg
from mjlab_terrain.presets import all_types, walking_types
from mjlab_terrain.solids import HeightField
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import TileCfg

# Extras, which may be missing where types are checked.
try:
  trimesh: Any = import_module("trimesh")
  viser: Any = import_module("viser")
except ImportError as error:
  raise ImportError("the page needs trimesh and viser, of the extra 'view' of mjlab-terrain") from error

_GIVEN = "as given"


def ground_mesh(tiles: Sequence[Tile], color: GroundColor) -> Any:
  """Return the ground as one `trimesh.Trimesh` in the world frame, with colors of vertices."""
  sides = trimesh.creation.box().faces
  vertices, faces, colors, count = [], [], [], 0
  for solid in gather(tiles):
    if isinstance(solid, HeightField):
      nx, ny = solid.heights.shape
      x, y = (np.linspace(-half, half, num) for half, num in zip(solid.half, (nx, ny), strict=True))
      points = solid.center + np.stack((*np.meshgrid(x, y, indexing="ij"), solid.heights), -1).reshape(-1, 3)
      near = (np.arange(nx - 1)[:, None] * ny + np.arange(ny - 1)).ravel()
      triangles = trimesh.geometry.triangulate_quads(near[:, None] + (0, ny, ny + 1, 1))
      z = points[:, 2]
    else:
      # Vertices are not shared between sides, so that edges stay sharp. Corners have the order of trimesh's.
      points = solid.corners[sides].reshape(-1, 3)
      triangles = np.arange(36).reshape(-1, 3)
      z = np.full(36, solid.center[2])
    vertices.append(points)
    faces.append(triangles + count)
    colors.append(as_pixels(color_of(color, solid.kind, z)))
    count += len(points)
  return trimesh.Trimesh(*map(np.concatenate, (vertices, faces)), vertex_colors=np.concatenate(colors), process=False)


class Page:
  """Page of one terrain, and the controls that change it."""

  def __init__(self, cfg: TerrainGridCfg, server: Any) -> None:
    self._given, self._server = cfg, server
    gui = server.gui
    gui.configure_theme(control_width="large", show_share_button=False)
    # Beside the terrain, not over it.
    gui.main_panel.dock_right()
    self._sets = {_GIVEN: cfg.types, "walking": walking_types(), "all": all_types()}
    self._sets |= {name: {name: single} for name, single in all_types().items()}
    self._choice = gui.add_dropdown("Terrain", tuple(self._sets), initial_value=_GIVEN)
    color = "type" if cfg.color == "type" else "height"
    # Controls of fields of the grid, by name.
    self._controls = {
      "difficulty": gui.add_multi_slider("Difficulty", min=0.0, max=1.0, step=0.01, initial_value=cfg.difficulty),
      "rows": gui.add_slider("Rows", min=1, max=20, step=1, initial_value=min(cfg.rows, 20)),
      "seed": gui.add_number("Seed", cfg.seed, min=0, step=1),
      "tile_size": gui.add_vector2("Tile size [m]", cfg.tile_size, min=(1.0, 1.0), step=0.5),
      "layout": gui.add_dropdown("Layout", ("curriculum", "random"), initial_value=cfg.layout),
      "color": gui.add_dropdown("Color", ("height", "type"), initial_value=color),
    }
    self._spawns = gui.add_checkbox("Spawn points", True)
    self._names = gui.add_checkbox("Names of tiles", True)
    self._status = gui.add_markdown("")
    self._folder = gui.add_folder("Settings")
    self._settings: dict[str, Any] = {}
    self._choice.on_update(lambda _: self._choose())
    for control in (*self._controls.values(), self._spawns, self._names):
      control.on_update(lambda _: self.draw())
    self._choose()

  def _choose(self) -> None:
    """Show the chosen types, with controls for the settings of a single one."""
    self._types = {name: dataclasses.replace(cfg) for name, cfg in self._sets[self._choice.value].items()}
    for control in self._settings.values():
      control.remove()
    self._settings.clear()
    self._folder.visible = len(self._types) == 1
    if self._folder.visible:
      (cfg,) = self._types.values()
      with self._folder:
        for setting in dataclasses.fields(cfg):
          self._add_control(cfg, setting)
    self.draw()

  def _add_control(self, cfg: TileCfg, setting: dataclasses.Field[Any]) -> None:
    """Add a control for a setting, except for a share, a file, or a number that is None."""
    gui, label = self._server.gui, setting.name.replace("_", " ")
    value, rule = getattr(cfg, setting.name), rule_of(setting)
    if isinstance(value, bool):
      control = gui.add_checkbox(label, value)
    elif setting.name == "share" or value is None or not rule:
      return
    elif words := rule.get("words"):
      control = gui.add_dropdown(label, words, initial_value=value)
    elif isinstance(value, tuple):
      control = gui.add_vector2(label, value, min=(rule["least"],) * 2, step=0.01)
    else:
      control = gui.add_number(label, value, min=rule["least"], step=1 if rule["whole"] else 0.01)

    def change(_: Any) -> None:
      setattr(cfg, setting.name, control.value)
      self.draw()

    control.on_update(change)
    self._settings[setting.name] = control

  def draw(self) -> None:
    """Build the terrain and show it, or the reason why that fails."""
    columns = self._given.columns if self._choice.value == _GIVEN else None
    values = {name: control.value for name, control in self._controls.items()}
    cfg = dataclasses.replace(self._given, types=self._types, columns=columns, **values)
    try:
      tiles = cfg.tiles()
    except ValueError as error:
      self._status.content = f"**Cannot be built.** {error}"
      return
    mesh = ground_mesh(tiles, cfg.color)
    origins = np.array([tile.origin for tile in tiles])
    scene, red = self._server.scene, np.tile((210, 40, 60), (len(tiles), 1))
    scene.reset()
    scene.add_mesh_trimesh("/terrain", mesh)
    spawns = origins + np.array([0.0, 0.0, 0.05])
    scene.add_point_cloud("/spawns", spawns, red, point_size=0.1, visible=self._spawns.value)
    names = [name.replace("_", " ") for name in cfg.types]
    if self._names.value:
      for tile, origin in zip(tiles, origins, strict=True):
        above = origin + np.array([0.0, 0.0, 0.6])
        scene.add_label(f"/names/{tile.place}", names[tile.kind], position=above, anchor="bottom-center")
    num_solids = sum(len(tile.solids) for tile in tiles)
    self._status.content = f"{len(tiles)} tiles of {num_solids} solids, {len(mesh.faces)} triangles"


def open_page(cfg: TerrainGridCfg, host: str, port: int) -> Any:
  """Serve a page of `cfg`, at the next free port if this one is taken, and return its server."""
  logging.getLogger("websockets.server").addFilter(_is_not_a_failed_handshake)
  # viser prints a greeting, but standard output is for the caller.
  with contextlib.redirect_stdout(io.StringIO()):
    server = viser.ViserServer(host=host, port=port, label="terrain", verbose=False)
  extent = max(cfg.tile_size[0] * cfg.rows, cfg.tile_size[1] * (cfg.columns or len(cfg.types)))
  server.initial_camera.position = (-0.8 * extent, -0.5 * extent, 0.7 * extent)
  server.initial_camera.look_at = (0.0, 0.0, 0.0)
  Page(cfg, server)
  return server


def serve(cfg: TerrainGridCfg, port: int, host: str = "127.0.0.1") -> None:
  """Serve a page of `cfg` until interrupted, and print its address."""
  server = open_page(cfg, host, port)
  shown = "localhost" if host in ("0.0.0.0", "127.0.0.1") else host
  print(f"open http://{shown}:{server.get_port()} (Ctrl-C ends)", flush=True)
  try:
    server.sleep_forever()
  except KeyboardInterrupt:
    server.stop()


def _is_not_a_failed_handshake(record: logging.LogRecord) -> bool:
  """Suppress the traceback of connections that are not from a browser, such as port scans."""
  return record.getMessage() != "opening handshake failed"
