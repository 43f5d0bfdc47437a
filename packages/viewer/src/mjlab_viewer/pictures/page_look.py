"""Ground, sky and light of the browser page, for pictures."""

from __future__ import annotations

import mujoco
import numpy as np

_GROUND = 255
_CELL, _SECTION = 205, 150
"""Grey of the thin lines and of the thick ones."""
_GLOW = 0.17
"""Emission of the ground, which makes it white outside shadows."""


def look_like_the_page(model: mujoco.MjModel) -> None:
  """Give a model the white ground with grey lines, the white sky and the one shadow of the browser page, in place.

  A ground with a texture gets two cells for each repetition of it; one without gets no lines.
  """
  for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE):
    material = int(model.geom_matid[geom])
    model.geom_rgba[geom] = (1.0, 1.0, 1.0, model.geom_rgba[geom, 3])
    if material >= 0:
      model.mat_rgba[material, :3] = 1.0
      model.mat_reflectance[material] = model.mat_specular[material] = 0.0
      model.mat_emission[material] = _GLOW
      for texture in model.mat_texid[material]:
        if texture >= 0 and model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D:
          _paint_grid(_pixels(model, int(texture)))
  for texture in np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX):
    _pixels(model, int(texture))[:] = _GROUND
  visual = model.vis
  visual.rgba.haze[:] = 1.0
  visual.headlight.ambient[:], visual.headlight.diffuse[:], visual.headlight.specular[:] = 0.45, 0.3, 0.0
  # The page has one lamp with shadows, which is far away.
  is_far = model.light_type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
  casting = sorted(np.flatnonzero(model.light_castshadow), key=lambda light: not is_far[light])
  model.light_castshadow[casting[1:]] = False
  if casting and is_far[casting[0]]:
    model.light_diffuse[:] = 0.0
  model.light_diffuse[casting[:1]] = 0.3


def _pixels(model: mujoco.MjModel, texture: int) -> np.ndarray:
  """Return the pixels of a texture, (height, width, channels), to be written to."""
  shape = (int(model.tex_height[texture]), int(model.tex_width[texture]), int(model.tex_nchannel[texture]))
  start = int(model.tex_adr[texture])
  return model.tex_data[start : start + int(np.prod(shape))].reshape(shape)


def _paint_grid(pixels: np.ndarray) -> None:
  height, width = pixels.shape[:2]
  line = max(height // 150, 1)
  pixels[:] = _GROUND
  pixels[height // 2 : height // 2 + line] = pixels[:, width // 2 : width // 2 + line] = _CELL
  pixels[:line] = pixels[-line:] = pixels[:, :line] = pixels[:, -line:] = _SECTION
