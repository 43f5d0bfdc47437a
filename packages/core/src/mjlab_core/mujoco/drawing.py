"""Debug-drawing interface for sensors and commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, TypeAlias

if TYPE_CHECKING:
  import numpy as np
  from torch import Tensor

  Array: TypeAlias = "Tensor | np.ndarray"
  Color: TypeAlias = "tuple[float, float, float, float] | Array"


class DebugDraw(Protocol):
  """Interface that draws shapes over the present picture; they are gone in the next one.

  A viewer calls `debug_draw(draw)` of sensors and commands once per picture, outside of the step. They draw the
  worlds in `draw.worlds`. Arguments are tensors of any device or arrays, one row per shape and n rows in all; n may
  be 0. All coordinates are in the world frame. A color is red, green, blue and opacity from 0 to 1, one for all
  shapes or one for each, (n, 4); in the same way a radius is one number or (n,) [m].
  """

  @property
  def worlds(self) -> Sequence[int]:
    """Indices of the worlds that are shown."""
    ...

  def arrows(self, start: Array, end: Array, color: Color, radius: float | Array) -> None:
    """Draw arrows from `start` to `end`, both (n, 3) [m]; `radius` is that of the shaft, one or (n,) [m]."""
    ...

  def lines(self, start: Array, end: Array, color: Color, radius: float | Array) -> None:
    """Draw straight lines from `start` to `end`, both (n, 3) [m], `radius` thick, one or (n,) [m]."""
    ...

  def spheres(self, center: Array, radius: float | Array, color: Color) -> None:
    """Draw spheres around `center`, (n, 3) [m]; `radius` is one or (n,) [m]."""
    ...

  def frames(self, position: Array, quaternion: Array, size: float) -> None:
    """Draw three axes (x red, y green, z blue) of length `size` [m] at `position`, (n, 3) [m].

    Args:
      position: origins, (n, 3) [m].
      quaternion: unit (w, x, y, z) from the drawn frame to the world, (n, 4).
      size: length of each axis [m].
    """
    ...

  def ellipsoids(self, center: Array, quaternion: Array, radii: Array, color: Color) -> None:
    """Draw ellipsoids around `center`, (n, 3) [m].

    Args:
      center: middles, (n, 3) [m].
      quaternion: unit (w, x, y, z) from their axes to the world, (n, 4).
      radii: half-lengths along their own axes, (n, 3) [m].
      color: one, or (n, 4).
    """
    ...

  def meshes(self, mesh_name: str, position: Array, quaternion: Array, color: Color) -> None:
    """Draw a mesh of the model at each pose.

    Args:
      mesh_name: full name of the mesh in the model.
      position: origin of the mesh, (n, 3) [m].
      quaternion: unit (w, x, y, z) from the mesh's axes to the world, (n, 4).
      color: one, or (n, 4).
    """
    ...
