"""Table of all types of native sensors: the objects they are attached to, and frame and unit of their readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco

ReadingFrame = Literal["scalar", "own", "reference", "world", "image"]
"""Frame of the components of a reading.

- "scalar": none, it is a number without direction;
- "own": the axes of the site, joint, geom or contact that the sensor reads;
- "reference": the axes of the reference frame, or the world's without one;
- "world": the axes of the world;
- "image": columns and rows of a camera's image, from its top left corner.
"""

Stage = Literal["position", "velocity", "acceleration"]


@dataclass(frozen=True)
class NativeType:
  """Type of native sensor."""

  name: str
  """Name of its MJCF element."""
  objects: tuple[str, ...] = ()
  """Kinds of elements it can be attached to; none for a sensor of the whole world."""
  unit: str = ""
  """Unit of a reading; empty for a pure number."""
  stage: Stage = "position"
  """Stage in which MuJoCo computes it. Readings of the acceleration stage are those of the substep just done."""
  frame: ReadingFrame = "scalar"
  """Frame of the components."""
  dim: int | None = 1
  """Numbers of a reading; None where that depends on the sensor's settings."""
  references: tuple[str, ...] = ()
  """Kinds of elements it can be measured relative to."""
  needs_reference: bool = False
  """True if a reference is required."""

  @property
  def enum(self) -> mujoco.mjtSensor:
    """MuJoCo's number for it."""
    return getattr(mujoco.mjtSensor, f"mjSENS_{_OTHER_NAMES.get(self.name, self.name).upper()}")


# Names of MuJoCo's types that are not those of their MJCF elements.
_OTHER_NAMES = {
  "jointactuatorfrc": "jointactfrc",
  "tendonactuatorfrc": "tendonactfrc",
  "distance": "geomdist",
  "normal": "geomnormal",
  "fromto": "geomfromto",
}
_SITE, _JOINT, _TENDON, _ACTUATOR = ("site",), ("joint",), ("tendon",), ("actuator",)
_FRAMES, _SHAPES = ("body", "xbody", "geom", "site", "camera"), ("geom", "body")
_ANGLE, _RATE, _EFFORT = "rad or m", "rad/s or m/s", "N m or N"

_TYPES = (
  NativeType("touch", _SITE, "N", "acceleration"),
  NativeType("accelerometer", _SITE, "m/s^2", "acceleration", "own", 3),
  NativeType("velocimeter", _SITE, "m/s", "velocity", "own", 3),
  NativeType("gyro", _SITE, "rad/s", "velocity", "own", 3),
  NativeType("force", _SITE, "N", "acceleration", "own", 3),
  NativeType("torque", _SITE, "N m", "acceleration", "own", 3),
  NativeType("magnetometer", _SITE, "T", "position", "own", 3),
  NativeType("rangefinder", ("site", "camera"), "m", "position", "world", None),
  NativeType("camprojection", _SITE, "pixel", "position", "image", 2, ("camera",), needs_reference=True),
  NativeType("jointpos", _JOINT, _ANGLE),
  NativeType("jointvel", _JOINT, _RATE, "velocity"),
  NativeType("tendonpos", _TENDON, _ANGLE),
  NativeType("tendonvel", _TENDON, _RATE, "velocity"),
  NativeType("actuatorpos", _ACTUATOR, _ANGLE),
  NativeType("actuatorvel", _ACTUATOR, _RATE, "velocity"),
  NativeType("actuatorfrc", _ACTUATOR, _EFFORT, "acceleration"),
  NativeType("jointactuatorfrc", _JOINT, _EFFORT, "acceleration"),
  NativeType("tendonactuatorfrc", _TENDON, _EFFORT, "acceleration"),
  NativeType("ballquat", _JOINT, "", "position", "own", 4),
  NativeType("ballangvel", _JOINT, "rad/s", "velocity", "own", 3),
  NativeType("jointlimitpos", _JOINT, _ANGLE),
  NativeType("jointlimitvel", _JOINT, _RATE, "velocity"),
  NativeType("jointlimitfrc", _JOINT, _EFFORT, "acceleration"),
  NativeType("tendonlimitpos", _TENDON, _ANGLE),
  NativeType("tendonlimitvel", _TENDON, _RATE, "velocity"),
  NativeType("tendonlimitfrc", _TENDON, _EFFORT, "acceleration"),
  NativeType("framepos", _FRAMES, "m", "position", "reference", 3, _FRAMES),
  NativeType("framequat", _FRAMES, "", "position", "reference", 4, _FRAMES),
  NativeType("framexaxis", _FRAMES, "", "position", "reference", 3, _FRAMES),
  NativeType("frameyaxis", _FRAMES, "", "position", "reference", 3, _FRAMES),
  NativeType("framezaxis", _FRAMES, "", "position", "reference", 3, _FRAMES),
  NativeType("framelinvel", _FRAMES, "m/s", "velocity", "reference", 3, _FRAMES),
  NativeType("frameangvel", _FRAMES, "rad/s", "velocity", "reference", 3, _FRAMES),
  NativeType("framelinacc", _FRAMES, "m/s^2", "acceleration", "world", 3),
  NativeType("frameangacc", _FRAMES, "rad/s^2", "acceleration", "world", 3),
  NativeType("subtreecom", ("body",), "m", "position", "world", 3),
  NativeType("subtreelinvel", ("body",), "m/s", "velocity", "world", 3),
  NativeType("subtreeangmom", ("body",), "kg m^2/s", "velocity", "world", 3),
  NativeType("insidesite", _FRAMES, "1, or m if enclosed", references=_SITE, needs_reference=True),
  NativeType("distance", _SHAPES, "m", references=_SHAPES, needs_reference=True),
  NativeType("normal", _SHAPES, "", "position", "world", 3, _SHAPES, needs_reference=True),
  NativeType("fromto", _SHAPES, "m", "position", "world", 6, _SHAPES, needs_reference=True),
  NativeType(
    "contact",
    ("geom", "body", "xbody", "site"),
    "N, N m and m",
    "acceleration",
    "own",
    None,
    ("geom", "body", "xbody"),
  ),
  NativeType("e_potential", unit="J"),
  NativeType("e_kinetic", unit="J"),
  NativeType("clock", unit="s"),
  NativeType("tactile", ("mesh",), "m and m/s", "velocity", "own", None, ("geom",), needs_reference=True),
  NativeType("plugin", (), "the plugin's own", "acceleration", "own", None),
  NativeType("user", (), "the callback's own", "acceleration", "own", None),
)

NATIVE_TYPES: dict[str, NativeType] = {kind.name: kind for kind in _TYPES}
"""Every type of `mujoco.mjtSensor`, by the name of its MJCF element."""
