"""Flat ground without end."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import mujoco

from mjlab_terrain.terrain import Terrain

Rgb = tuple[float, float, float]


@dataclass(kw_only=True)
class PlaneCfg:
  """An infinite plane at height zero with a checkered look."""

  name: str = "terrain"
  """Name of the body, of its geom, and of the light, material and texture that come with it."""

  friction: tuple[float, float, float] = (1.0, 0.005, 0.0001)
  """Sliding, torsional and rolling friction [1, m, m]."""

  square: float = 0.5
  """Edge length of one square of the checker [m]."""

  colors: tuple[Rgb, Rgb] = ((0.20, 0.30, 0.40), (0.10, 0.20, 0.30))
  """Colors of the squares, red, green and blue in [0, 1]."""

  line_color: Rgb | None = (0.80, 0.80, 0.80)
  """Color of the lines around each pair of squares; None draws none."""

  reflectance: float = 0.2
  """How much the ground mirrors, in [0, 1]."""

  light: bool = True
  """Whether a directional light from above comes with it."""

  def add_to(self, spec: mujoco.MjSpec) -> Terrain:
    """Adds a static body with the plane to the world of `spec`, in geom group 0.

    Raises:
      ValueError: a setting is out of its range, or `spec` already has an element of this name; `spec` is as it was.
    """
    self._check(spec)
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

    body = spec.worldbody.add_body(name=self.name)
    # Two zeros make the plane infinite; the third number is the spacing of the squares that the renderer cuts it into.
    geom = body.add_geom(
      name=self.name,
      type=mujoco.mjtGeom.mjGEOM_PLANE,
      size=(0.0, 0.0, 0.01),
      material=self.name,
      friction=self.friction,
      # Said although they are MuJoCo's defaults: the model may have defaults of its own.
      condim=3,
      contype=1,
      conaffinity=1,
      group=0,
      rgba=(0.5, 0.5, 0.5, 1.0),
    )
    if self.light:
      body.add_light(
        name=self.name,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=(0.0, 0.0, 3.0),
        dir=(0.2, 0.1, -1.0),
        diffuse=(0.6, 0.6, 0.6),
        castshadow=True,
      )
    return Terrain(name=body.name, geom_names=(geom.name,))

  def _check(self, spec: mujoco.MjSpec) -> None:
    if not self.name:
      raise ValueError("PlaneCfg: name must not be empty.")
    if any(not 0.0 <= f < math.inf for f in self.friction):
      raise ValueError(f"PlaneCfg {self.name!r}: friction must not be negative, got {self.friction}.")
    if not 0.0 < self.square < math.inf:
      raise ValueError(f"PlaneCfg {self.name!r}: square must be a positive length, got {self.square}.")
    taken: dict[str, Callable[[str], object]] = {
      "body": spec.body,
      "geom": spec.geom,
      "material": spec.material,
      "texture": spec.texture,
    }
    if self.light:
      taken["light"] = spec.light
    for kind, find in taken.items():
      if find(self.name) is not None:
        raise ValueError(
          f"PlaneCfg {self.name!r}: the model {spec.modelname!r} already has a {kind} named {self.name!r}. "
          "Give the plane another name, or add it once."
        )
