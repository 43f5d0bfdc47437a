"""Objects to lift."""

import colorsys
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco

CUBE_EDGE = 0.04
"""Edge of the cube [m]."""
CUBE_MASS = 0.05
"""Mass of the cube [kg]."""
DENSITY = CUBE_MASS / CUBE_EDGE**3
"""Density of the cube and of all other objects [kg/m^3]."""
ROLLING = (1.0, 0.005, 0.001)
"""Friction of objects that roll: sliding [1], torsional and rolling [m]."""

Rgba = tuple[float, float, float, float]


@dataclass(frozen=True)
class ObjectSpec:
  """Function that returns a new spec: a free body of one geom with the cube's density."""

  name: str
  """Name of the body and of its geom."""
  shape: str
  """Type of the geom in MJCF: "box", "sphere" ..."""
  size: tuple[float, float, float]
  """Size of the geom [m]."""
  rgba: Rgba
  rolls: bool = False
  """True adds rolling friction."""
  quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
  """Orientation of the geom in the body."""

  def __call__(self) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name=self.name)
    body.add_freejoint(name=self.name)
    kind = getattr(mujoco.mjtGeom, f"mjGEOM_{self.shape.upper()}")
    geom = body.add_geom(name=self.name, type=kind, size=self.size, quat=self.quat, density=DENSITY, rgba=self.rgba)
    if self.rolls:
      geom.condim, geom.friction = 6, ROLLING
    return spec


_CUBE = ObjectSpec("cube", "box", (0.5 * CUBE_EDGE, 0.5 * CUBE_EDGE, 0.5 * CUBE_EDGE), (0.85, 0.35, 0.2, 1.0))


def cube_spec() -> mujoco.MjSpec:
  """Return a free cube with MuJoCo's default friction and contact parameters."""
  return _CUBE()


def _hue(share: float) -> Rgba:
  """Return a saturated colour of the colour circle."""
  return (*colorsys.hsv_to_rgb(share, 0.8, 0.9), 1.0)


CUBES = {f"{color}_cube": replace(_CUBE, rgba=_hue(k / 3)) for k, color in enumerate(("red", "green", "blue"))}
"""Cubes of the three basic colours."""

_LYING = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
OBJECTS: dict[str, Callable[[], mujoco.MjSpec]] = {
  "cube_30mm": ObjectSpec("cube", "box", (0.015, 0.015, 0.015), _hue(0.55)),
  "cube_40mm": cube_spec,
  "cube_50mm": ObjectSpec("cube", "box", (0.025, 0.025, 0.025), _hue(0.1)),
  "brick": ObjectSpec("brick", "box", (0.03, 0.02, 0.015), _hue(0.0)),
  "ball_40mm": ObjectSpec("ball", "sphere", (0.02, 0.0, 0.0), _hue(0.3), rolls=True),
  "ball_50mm": ObjectSpec("ball", "sphere", (0.025, 0.0, 0.0), _hue(0.4), rolls=True),
  # It stands, 6 cm high.
  "cylinder": ObjectSpec("cylinder", "cylinder", (0.02, 0.03, 0.0), _hue(0.75)),
  # It lies, 7 cm long.
  "capsule": ObjectSpec("capsule", "capsule", (0.0175, 0.0175, 0.0), _hue(0.9), rolls=True, quat=_LYING),
}
"""Objects that the gripper, which opens by 7.5 cm, can hold from any side."""
