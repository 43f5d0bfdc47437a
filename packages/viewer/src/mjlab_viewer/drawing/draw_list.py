"""Debug drawings as plain arrays, for the browser, the window and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import torch
from mjlab_core.rotations import matrix_from_quat

if TYPE_CHECKING:
  from numpy.typing import ArrayLike

  Array: TypeAlias = "torch.Tensor | np.ndarray"
  Color: TypeAlias = "tuple[float, float, float, float] | Array"

ShapeKind: TypeAlias = Literal["arrow", "line", "ellipsoid", "mesh"]


@dataclass
class Shapes:
  """Shapes of one kind, one row each."""

  kind: ShapeKind
  position: np.ndarray
  """Start of an arrow or line, else the middle, (n, 3) [m]."""
  direction: np.ndarray
  """From start to end of an arrow or line, else a unit quaternion, (n, 3) or (n, 4)."""
  size: np.ndarray
  """Radius of an arrow or line, (n, 1) [m]; half axes of an ellipsoid, (n, 3) [m]; ones of a mesh."""
  color: np.ndarray
  """Red, green, blue, opacity, (n, 4)."""
  mesh: str = ""
  """Full name of the mesh."""

  def __len__(self) -> int:
    return len(self.position)

  def rows(self, rows: np.ndarray) -> Shapes:
    """Return some of them, by number."""
    parts = (array[rows] for array in (self.position, self.direction, self.size, self.color))
    return Shapes(self.kind, *parts, mesh=self.mesh)


class DrawList:
  """List of drawn shapes; implements `mjlab_core.DebugDraw`.

  Tensors stay on their device until `finish`, so that all of them come to the host together. Rows that are not finite
  are left out: a world that diverged must not spoil the picture of the others.
  """

  def __init__(self, worlds: Sequence[int] = (0,)) -> None:
    self.worlds: Sequence[int] = tuple(worlds)
    """Numbers of the worlds that are shown."""
    self._batches: list[tuple[ShapeKind, str, tuple[Any, ...]]] = []
    self.shapes: list[Shapes] = []
    """Drawn shapes, after `finish`."""

  def arrows(self, start: Array, end: Array, color: Color, radius: float | Array) -> None:
    self._add("arrow", start, end, color, _column(radius))

  def lines(self, start: Array, end: Array, color: Color, radius: float | Array) -> None:
    self._add("line", start, end, color, _column(radius))

  def spheres(self, center: Array, radius: float | Array, color: Color) -> None:
    self._add("ellipsoid", center, _UPRIGHT, color, _column(radius))

  def frames(self, position: Array, quaternion: Array, size: float) -> None:
    # Rotated on the device, so that the axes come to the host with everything else.
    quat = torch.as_tensor(quaternion)
    position = torch.as_tensor(position, device=quat.device)
    for axis, color in zip(matrix_from_quat(quat).unbind(-1), _AXIS_COLORS, strict=True):
      self.lines(position, position + size * axis, color, 0.05 * size)

  def ellipsoids(self, center: Array, quaternion: Array, radii: Array, color: Color) -> None:
    self._add("ellipsoid", center, quaternion, color, radii)

  def meshes(self, mesh_name: str, position: Array, quaternion: Array, color: Color) -> None:
    self._add("mesh", position, quaternion, color, 1.0, mesh_name)

  @property
  def pending(self) -> list[torch.Tensor]:
    """Drawn tensors that are not on the host yet, in the order that `finish` expects."""
    return [array for _, _, arrays in self._batches for array in arrays if isinstance(array, torch.Tensor)]

  def finish(self, arrived: Iterator[np.ndarray]) -> None:
    """Make `shapes`; `arrived` yields the `pending` tensors as arrays."""
    for kind, mesh, arrays in self._batches:
      shapes = _shapes(kind, mesh, *(next(arrived) if isinstance(array, torch.Tensor) else array for array in arrays))
      if len(shapes):
        self.shapes.append(shapes)
    self._batches.clear()

  def _add(
    self, kind: ShapeKind, first: Array, second: Array, color: Color, size: float | Array, mesh: str = ""
  ) -> None:
    self._batches.append((kind, mesh, (first, second, color, size)))


_Z = np.array([0.0, 0.0, 1.0], dtype=float)
_UPRIGHT = np.array([[1.0, 0.0, 0.0, 0.0]])
_AXIS_COLORS = ((0.9, 0.2, 0.2, 1.0), (0.2, 0.8, 0.2, 1.0), (0.2, 0.3, 0.9, 1.0))


def _column(radius: float | Array) -> float | Array:
  return radius.reshape(-1, 1) if isinstance(radius, torch.Tensor | np.ndarray) else radius


def _shapes(
  kind: ShapeKind, mesh: str, first: ArrayLike, second: ArrayLike, color: ArrayLike, size: ArrayLike
) -> Shapes:
  position = np.asarray(first, dtype=float).reshape(-1, 3)
  n = len(position)
  is_segment = kind in ("arrow", "line")
  direction = np.broadcast_to(np.asarray(second, dtype=float), (n, 3 if is_segment else 4))
  if is_segment:
    direction = direction - position
  width = 3 if kind == "ellipsoid" else 1
  size = np.broadcast_to(np.atleast_2d(np.asarray(size, dtype=float)), (n, width))
  color = np.clip(np.broadcast_to(np.atleast_2d(np.asarray(color, dtype=float)), (n, 4)), 0.0, 1.0)
  finite = np.flatnonzero(np.isfinite(np.concatenate([position, direction, size, color], axis=1)).all(axis=1))
  return Shapes(kind, position, direction, size, color, mesh).rows(finite)


def turns_from_z(direction: np.ndarray) -> np.ndarray:
  """Return unit quaternions (n, 4) that rotate z to these directions, (n, 3); the identity for zero length."""
  length = np.linalg.norm(direction, axis=1, keepdims=True)
  unit = np.divide(direction, length, out=np.tile(_Z, (len(direction), 1)), where=length > 0)
  # Half the angle between z and the direction: (1 + cos, z x direction), normalised.
  w = 1.0 + unit[:, 2]
  quaternion = np.stack([w, -unit[:, 1], unit[:, 0], np.zeros_like(w)], axis=1)
  opposite = w < 1e-6
  quaternion[opposite] = [0.0, 1.0, 0.0, 0.0]
  return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
