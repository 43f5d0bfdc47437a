"""Objects to lift."""

import colorsys
import math
from collections.abc import Callable

import mujoco

CUBE_EDGE = 0.04
"""Edge of the cube [m]."""
CUBE_MASS = 0.05
"""Mass of the cube [kg]."""
DENSITY = CUBE_MASS / CUBE_EDGE**3
"""Density of the cube and of all other objects [kg/m^3]."""
ROLLING = {"condim": 6, "friction": (1.0, 0.005, 0.001)}
"""Attributes of geoms with rolling friction."""

Rgba = tuple[float, float, float, float]


def cube_spec(rgba: Rgba = (0.85, 0.35, 0.2, 1.0)) -> mujoco.MjSpec:
  """Return a free cube with MuJoCo's default friction and contact parameters."""
  half = 0.5 * CUBE_EDGE
  return _object("cube", mujoco.mjtGeom.mjGEOM_BOX, (half, half, half), rgba)


def red_cube_spec() -> mujoco.MjSpec:
  """Return a red cube."""
  return cube_spec(_hue(0.0))


def green_cube_spec() -> mujoco.MjSpec:
  """Return a green cube."""
  return cube_spec(_hue(1 / 3))


def blue_cube_spec() -> mujoco.MjSpec:
  """Return a blue cube."""
  return cube_spec(_hue(2 / 3))


def small_cube_spec() -> mujoco.MjSpec:
  """Return a cube of 3 cm."""
  return _object("cube", mujoco.mjtGeom.mjGEOM_BOX, (0.015, 0.015, 0.015), _hue(0.55))


def large_cube_spec() -> mujoco.MjSpec:
  """Return a cube of 5 cm."""
  return _object("cube", mujoco.mjtGeom.mjGEOM_BOX, (0.025, 0.025, 0.025), _hue(0.1))


def brick_spec() -> mujoco.MjSpec:
  """Return a brick of 6 x 4 x 3 cm that lies flat."""
  return _object("brick", mujoco.mjtGeom.mjGEOM_BOX, (0.03, 0.02, 0.015), _hue(0.0))


def small_ball_spec() -> mujoco.MjSpec:
  """Return a ball of 4 cm with rolling friction."""
  return _object("ball", mujoco.mjtGeom.mjGEOM_SPHERE, (0.02, 0.0, 0.0), _hue(0.3), **ROLLING)


def large_ball_spec() -> mujoco.MjSpec:
  """Return a ball of 5 cm with rolling friction."""
  return _object("ball", mujoco.mjtGeom.mjGEOM_SPHERE, (0.025, 0.0, 0.0), _hue(0.4), **ROLLING)


def cylinder_spec() -> mujoco.MjSpec:
  """Return a cylinder of 4 cm that stands, 6 cm high."""
  return _object("cylinder", mujoco.mjtGeom.mjGEOM_CYLINDER, (0.02, 0.03, 0.0), _hue(0.75))


def capsule_spec() -> mujoco.MjSpec:
  """Return a capsule of 3.5 cm that lies, 7 cm long, with rolling friction."""
  lying = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
  return _object("capsule", mujoco.mjtGeom.mjGEOM_CAPSULE, (0.0175, 0.0175, 0.0), _hue(0.9), quat=lying, **ROLLING)


OBJECTS: dict[str, Callable[[], mujoco.MjSpec]] = {
  "cube_30mm": small_cube_spec,
  "cube_40mm": cube_spec,
  "cube_50mm": large_cube_spec,
  "brick": brick_spec,
  "ball_40mm": small_ball_spec,
  "ball_50mm": large_ball_spec,
  "cylinder": cylinder_spec,
  "capsule": capsule_spec,
}
"""Objects that the gripper, which opens by 7.5 cm, can hold from any side."""


def _object(
  name: str, kind: mujoco.mjtGeom, size: tuple[float, float, float], rgba: Rgba, **geom: object
) -> mujoco.MjSpec:
  """Return a free body of one geom with the cube's density, and with other attributes of the geom."""
  spec = mujoco.MjSpec()
  body = spec.worldbody.add_body(name=name)
  body.add_freejoint(name=name)
  body.add_geom(name=name, type=kind, size=size, density=DENSITY, rgba=rgba, **geom)
  return spec


def _hue(share: float) -> Rgba:
  """Return a saturated colour of the colour circle."""
  return (*colorsys.hsv_to_rgb(share, 0.8, 0.9), 1.0)
