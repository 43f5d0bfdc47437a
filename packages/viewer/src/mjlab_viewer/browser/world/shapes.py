"""Drawn shapes on the page."""

from __future__ import annotations

import functools
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser

from mjlab_viewer.drawing.draw_list import Shapes, turns_from_z
from mjlab_viewer.drawing.mjv import mesh_id

# Share of the shaft of an arrow, as MuJoCo draws it, and width of its head relative to the shaft.
_SHAFT = 0.8
_HEAD_WIDTH = 2.0

_PARTS = {"arrow": ("shaft", "head"), "line": ("line",), "ellipsoid": ("ellipsoid",)}
"""Batches that show a kind of shapes."""


class BatchedShapes:
  """Drawn shapes, one batch of meshes for each kind.

  Args:
    server: Server of the page.
    model: Holds the meshes of ghosts.
    path: Node that they are under.
  """

  def __init__(self, server: viser.ViserServer, model: mujoco.MjModel, path: str = "/drawn") -> None:
    self._server, self._path = server, path
    self._model = model
    self._handles: dict[str, viser.BatchedMeshHandle] = {}

  def show(self, drawn: Sequence[Shapes], offset: np.ndarray) -> None:
    """Replace the shapes that are shown; `offset` moves all of them, (3,) [m].

    The offset is added here: on a busy browser, a node that moves is shown at its new place long before its children.
    """
    batches: dict[str, list[Shapes]] = defaultdict(list)
    for shapes in drawn:
      if shapes.kind != "mesh":
        for part in _PARTS[shapes.kind]:
          batches[part].append(shapes)
      elif mesh_id(self._model, shapes.mesh) >= 0:
        batches[f"mesh/{shapes.mesh}"].append(shapes)
    for name, parts in batches.items():
      self._show_batch(name, parts, offset)
    for name, handle in self._handles.items():
      if name not in batches:
        handle.visible = False

  def _show_batch(self, name: str, parts: list[Shapes], offset: np.ndarray) -> None:
    position, direction, size, color = (
      np.concatenate([getattr(shapes, field) for shapes in parts])
      for field in ("position", "direction", "size", "color")
    )
    position = position + offset
    if name in ("shaft", "head", "line"):
      length = np.linalg.norm(direction, axis=1, keepdims=True)
      share = {"shaft": _SHAFT, "head": 1.0 - _SHAFT, "line": 1.0}[name]
      width = size * (_HEAD_WIDTH if name == "head" else 1.0)
      scale = np.concatenate([width, width, share * length], axis=1)
      if name == "head":
        position = position + _SHAFT * direction
      wxyz = turns_from_z(direction)
    else:
      scale, wxyz = np.broadcast_to(size, (len(size), 3)), direction
    rgb, opacity = (255 * color[:, :3]).astype(np.uint8), color[:, 3]
    if (opacity == 1.0).all():
      # Opaque shapes hide each other.
      opacity = None
    look: dict[str, Any] = {
      "batched_wxyzs": wxyz.astype(np.float32),
      "batched_positions": position.astype(np.float32),
      "batched_scales": scale.astype(np.float32),
      "batched_colors": rgb,
      "batched_opacities": opacity,
    }
    handle = self._handles.get(name)
    if handle is None:
      mesh = self._unit_mesh(name)
      self._handles[name] = self._server.scene.add_batched_meshes_simple(
        f"{self._path}/{name}",
        np.asarray(mesh.vertices, dtype=np.float32),
        np.asarray(mesh.faces, dtype=np.uint32),
        **look,
        lod="off",
        cast_shadow=False,
        receive_shadow=False,
      )
      return
    for field, value in look.items():
      setattr(handle, field, value)
    handle.visible = True

  def _unit_mesh(self, name: str) -> trimesh.Trimesh:
    if not name.startswith("mesh/"):
      return _primitive(name)
    mesh = mesh_id(self._model, name.removeprefix("mesh/"))
    vertices = self._model.mesh_vertadr[mesh] + np.arange(self._model.mesh_vertnum[mesh])
    faces = self._model.mesh_faceadr[mesh] + np.arange(self._model.mesh_facenum[mesh])
    return trimesh.Trimesh(self._model.mesh_vert[vertices], self._model.mesh_face[faces], process=False)


@functools.cache
def _primitive(name: str) -> trimesh.Trimesh:
  if name == "ellipsoid":
    return trimesh.creation.icosphere(subdivisions=2, radius=1.0)
  if name == "head":
    return trimesh.creation.cone(radius=1.0, height=1.0, sections=16)
  rod = trimesh.creation.cylinder(radius=1.0, height=1.0, sections=12)
  rod.apply_translation([0.0, 0.0, 0.5])
  return rod
