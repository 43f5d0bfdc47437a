"""Browser page that shows a terrain, with controls for its settings."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import logging
from importlib import import_module
from typing import Any

import numpy as np

from mjlab_terrain.colors import coloring_of
from mjlab_terrain.grid import TerrainGridCfg
from mjlab_terrain.presets import all_types, walking_types
from mjlab_terrain.tile_cfg import TileCfg
from mjlab_terrain.view.settings import Setting, settings_of
from mjlab_terrain.view.triangles import triangles

# Extras, which may be missing where types are checked.
trimesh: Any = import_module("trimesh")
viser: Any = import_module("viser")

_GIVEN, _WALKING, _ALL = "as given", "walking", "all"


class Page:
  """Page of one terrain, and the controls that change it."""

  def __init__(self, cfg: TerrainGridCfg, server: Any) -> None:
    self._given, self._server = cfg, server
    self._types = dict(cfg.types)
    gui = server.gui
    gui.configure_theme(control_width="large", show_share_button=False)
    # Beside the terrain, not over it.
    gui.main_panel.dock_right()
    self._choice = gui.add_dropdown("Terrain", (_GIVEN, _WALKING, _ALL, *all_types()), initial_value=_GIVEN)
    self._easiest = gui.add_slider("Easiest", min=0.0, max=1.0, step=0.01, initial_value=cfg.difficulty[0])
    self._hardest = gui.add_slider("Hardest", min=0.0, max=1.0, step=0.01, initial_value=cfg.difficulty[1])
    self._rows = gui.add_slider("Rows", min=1, max=20, step=1, initial_value=min(cfg.rows, 20))
    self._seed = gui.add_number("Seed", cfg.seed, min=0, step=1)
    self._tile_size = gui.add_vector2("Tile size [m]", tuple(cfg.tile_size), min=(1.0, 1.0), step=0.5)
    self._layout = gui.add_dropdown("Layout", ("curriculum", "random"), initial_value=cfg.layout)
    self._color = gui.add_dropdown(
      "Color", ("height", "type"), initial_value="type" if cfg.color == "type" else "height"
    )
    self._spawns = gui.add_checkbox("Spawn points", True)
    self._names = gui.add_checkbox("Names of tiles", True)
    self._labels: list[Any] = []
    self._status = gui.add_markdown("")
    self._settings: dict[str, Any] = {}
    self._folder: Any = None
    self._choice.on_update(lambda _: self._choose())
    for control in (
      *(self._easiest, self._hardest, self._rows, self._seed, self._tile_size, self._layout, self._color),
      self._spawns,
      self._names,
    ):
      control.on_update(lambda _: self.draw())
    self._choose()

  def _choose(self) -> None:
    """Take over the chosen types, with controls for the settings of a single one."""
    name = self._choice.value
    sets: dict[str, dict[str, TileCfg]] = {_GIVEN: self._given.types, _WALKING: walking_types(), _ALL: all_types()}
    types = sets[name] if name in sets else {name: all_types()[name]}
    self._types = {key: dataclasses.replace(cfg) for key, cfg in types.items()}
    if self._folder is not None:
      self._folder.remove()
      self._folder = None
      self._settings.clear()
    if len(self._types) == 1:
      self._folder = self._server.gui.add_folder("Settings")
      with self._folder:
        for cfg in self._types.values():
          for setting in settings_of(cfg):
            self._add_control(cfg, setting)
    self.draw()

  def _add_control(self, cfg: TileCfg, setting: Setting) -> None:
    gui, value, label = self._server.gui, getattr(cfg, setting.name), setting.name.replace("_", " ")
    if setting.kind == "pair":
      control = gui.add_vector2(label, tuple(float(v) for v in value), min=(setting.least,) * 2, step=0.01)
    elif setting.kind == "flag":
      control = gui.add_checkbox(label, value)
    elif setting.kind == "choice":
      control = gui.add_dropdown(label, setting.choices, initial_value=value)
    else:
      control = gui.add_number(label, value, min=setting.least, step=1 if setting.kind == "whole" else 0.01)

    def change(_: Any) -> None:
      whole = setting.kind == "pair" and all(isinstance(v, int) for v in value)
      new = tuple(round(v) if whole else v for v in control.value) if setting.kind == "pair" else control.value
      setattr(cfg, setting.name, new)
      self.draw()

    control.on_update(change)
    self._settings[setting.name] = control

  def draw(self) -> None:
    """Build the terrain and show it, or show why it cannot be built."""
    low, high = sorted((self._easiest.value, self._hardest.value))
    cfg = dataclasses.replace(
      self._given,
      types=self._types,
      difficulty=(low, high),
      rows=int(self._rows.value),
      columns=self._given.columns if self._choice.value == _GIVEN else None,
      seed=int(self._seed.value),
      tile_size=tuple(self._tile_size.value),
      layout=self._layout.value,
      color=self._color.value,
    )
    try:
      placed = cfg.tiles()
    except ValueError as error:
      self._status.content = f"**Cannot be built.** {error}"
      return
    vertices, faces, colors = triangles(placed, coloring_of(cfg.color))
    alpha = np.full((len(colors), 1), 255, dtype=np.uint8)
    mesh = trimesh.Trimesh(vertices, faces, vertex_colors=np.hstack((colors, alpha)), process=False)
    self._server.scene.add_mesh_trimesh("/terrain", mesh)
    spawns = np.array([p.origin for p in placed])
    self._server.scene.add_point_cloud(
      "/spawns", spawns + np.array([0.0, 0.0, 0.05]), np.full((len(spawns), 3), (210, 40, 60)), point_size=0.1,
      visible=self._spawns.value,
    )  # fmt: skip
    for label in self._labels:
      label.remove()
    self._labels.clear()
    if self._names.value:
      names = [name.replace("_", " ") for name in cfg.types]
      for p in placed:
        label = self._server.scene.add_label(
          f"/names/{p.row}/{p.column}",
          names[p.kind],
          position=p.origin + np.array([0.0, 0.0, 0.6]),
          anchor="bottom-center",
          # As large in the distance.
          font_size_mode="screen",
        )
        self._labels.append(label)
    num_solids = sum(len(p.tile.solids) for p in placed)
    self._status.content = f"{len(placed)} tiles of {num_solids} solids, {len(faces)} triangles"


def open_page(cfg: TerrainGridCfg, host: str, port: int) -> Any:
  """Serve a page of `cfg`, at the next free port if this one is taken, and return its server."""
  logging.getLogger("websockets.server").addFilter(_is_no_failed_handshake)
  # viser prints a greeting, but standard output belongs to the caller.
  with contextlib.redirect_stdout(io.StringIO()):
    server = viser.ViserServer(host=host, port=port, label="terrain", verbose=False)
  server.scene.set_up_direction("+z")
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


def _is_no_failed_handshake(record: logging.LogRecord) -> bool:
  """Leave out the traceback of connections that are not from a browser, such as scans of ports."""
  return record.getMessage() != "opening handshake failed"
