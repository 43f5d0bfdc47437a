"""What is lifted."""

import colorsys

import mujoco

CUBE_EDGE = 0.04
"""Edge of the cube [m]."""
CUBE_MASS = 0.05
"""Mass of the cube [kg]."""


def cube_spec(rgba: tuple[float, float, float, float] = (0.85, 0.35, 0.2, 1.0)) -> mujoco.MjSpec:
  """A cube that nothing holds; friction and contact parameters are MuJoCo's defaults."""
  spec = mujoco.MjSpec()
  body = spec.worldbody.add_body(name="cube")
  body.add_freejoint(name="cube")
  body.add_geom(name="cube", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.5 * CUBE_EDGE] * 3, mass=CUBE_MASS, rgba=rgba)
  return spec


def red_cube_spec() -> mujoco.MjSpec:
  """A red cube."""
  return cube_spec(_hue(0.0))


def green_cube_spec() -> mujoco.MjSpec:
  """A green cube."""
  return cube_spec(_hue(1 / 3))


def blue_cube_spec() -> mujoco.MjSpec:
  """A blue cube."""
  return cube_spec(_hue(2 / 3))


def _hue(share: float) -> tuple[float, float, float, float]:
  """A strong colour from round the colour circle."""
  return (*colorsys.hsv_to_rgb(share, 0.8, 0.9), 1.0)
