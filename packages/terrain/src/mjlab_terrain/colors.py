"""Colors of the ground, and the pictures that color height fields."""

from __future__ import annotations

import colorsys
import io
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mjlab_terrain.solids import Floats, HeightField

Rgb = tuple[float, float, float]
GroundColor = Literal["height", "type"] | Rgb

# Largest edge of a picture [pixels].
_PICTURE = 96

# Height [m] and color: deep water, slate, stone at the rim's height, sand, clay.
_GRADIENT = (
  (-2.0, (0.08, 0.11, 0.17)),
  (-1.0, (0.13, 0.24, 0.36)),
  (-0.4, (0.24, 0.43, 0.52)),
  (0.0, (0.58, 0.65, 0.62)),
  (0.3, (0.85, 0.76, 0.56)),
  (0.8, (0.82, 0.52, 0.33)),
  (2.0, (0.62, 0.25, 0.22)),
)


def color_of(color: GroundColor, kind: int, z: Floats) -> Floats:
  """Return the color of ground of a type, given by its index, at heights (...) [m]: (..., 3) in [0, 1]."""
  if color == "height":
    at, colors = zip(*_GRADIENT, strict=True)
    return np.stack([np.interp(z, at, channel) for channel in np.transpose(colors)], axis=-1)
  if color == "type":
    # Multiples of the golden ratio spread hues evenly, however many types there are. Higher ground is lighter.
    shade = np.clip(1.0 + 0.35 * np.asarray(z), 0.45, 1.6)
    return np.clip(shade[..., None] * colorsys.hsv_to_rgb(0.6 + 0.618 * kind, 0.4, 0.75), 0.0, 1.0)
  return np.broadcast_to(np.array(color, dtype=np.float64), (*np.shape(z), 3))


def as_pixels(colors: Floats) -> NDArray[np.uint8]:
  """Return colors in [0, 255]."""
  return np.round(255.0 * np.clip(colors, 0.0, 1.0)).astype(np.uint8)


def picture_of(field: HeightField, color: GroundColor) -> bytes:
  """Return a PNG file with the colors of a height field, seen from above with x to the right."""
  rows = [np.linspace(0, n - 1, min(n, _PICTURE)).round().astype(np.int64) for n in field.heights.shape]
  colors = color_of(color, field.kind, field.center[2] + field.heights[np.ix_(*rows)])
  # The first row of a picture is at the far end of y.
  pixels = np.ascontiguousarray(as_pixels(colors).transpose(1, 0, 2)[::-1])
  # A file, because MuJoCo cannot write textures without one as XML.
  file = io.BytesIO()
  Image.fromarray(pixels).save(file, "png")
  return file.getvalue()
