"""Infinite flat ground."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from mjlab_terrain.assembly import FRICTION, add_geom, add_light, new_body
from mjlab_terrain.checked_fields import check_fields, number
from mjlab_terrain.colors import Rgb
from mjlab_terrain.terrain import Terrain


@dataclass(kw_only=True)
class PlaneCfg:
  """Infinite plane at height zero with a checkered look."""

  name: str = "terrain"
  """Name of the body, and of its geom, light, material and texture."""

  friction: tuple[float, float, float] = number(FRICTION)
  """Sliding, torsional and rolling friction [1, m, m]."""

  square: float = number(0.5, least=1e-3)
  """Edge length of one square of the checker [m]."""

  colors: tuple[Rgb, Rgb] = ((0.20, 0.30, 0.40), (0.10, 0.20, 0.30))
  """Colors of the squares, red, green and blue in [0, 1]."""

  line_color: Rgb | None = (0.80, 0.80, 0.80)
  """Color of the lines around each pair of squares; None for no lines."""

  reflectance: float = number(0.2, most=1.0)
  """Share of the light that the ground reflects, in [0, 1]."""

  light: bool = True
  """True adds a directional light from above."""

  def add_to(self, spec: mujoco.MjSpec) -> Terrain:
    """Add a static body with the plane to the world of `spec`, in geom group 0.

    Raises:
      ValueError: a setting is out of its range, or `spec` already has a body or geom of this name; it is unchanged.
    """
    check_fields(self, self.name)
    body = new_body(spec, self.name, [self.name])
    texture = spec.add_texture(
      name=self.name,
      type=mujoco.mjtTexture.mjTEXTURE_2D,
      builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
      rgb1=self.colors[0],
      rgb2=self.colors[1],
      width=300,
      height=300,
    )
    if self.line_color is not None:
      texture.mark, texture.markrgb = mujoco.mjtMark.mjMARK_EDGE, self.line_color
    material = spec.add_material(
      name=self.name, texuniform=True, texrepeat=(0.5 / self.square, 0.5 / self.square), reflectance=self.reflectance
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = self.name
    # Two zeros make the plane infinite; the third number is the spacing of the squares that the renderer cuts it into.
    add_geom(
      body,
      self.name,
      self.friction,
      type=mujoco.mjtGeom.mjGEOM_PLANE,
      size=(0.0, 0.0, 0.01),
      material=self.name,
      rgba=(0.5, 0.5, 0.5, 1.0),
    )
    if self.light:
      add_light(body, height=3.0, direction=(0.2, 0.1, -1.0))
    return Terrain(name=body.name, geom_names=(self.name,))
