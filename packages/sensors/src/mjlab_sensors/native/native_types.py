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


@dataclass(frozen=True)
class NativeType:
  """Type of native sensor."""

  name: str
  """Name of its MJCF element."""
  objects: tuple[str, ...] = ()
  """Kinds of elements it can be attached to; none for a sensor of the whole world."""
  unit: str = ""
  """Unit of a reading; empty for a pure number."""
  frame: ReadingFrame = "scalar"
  """Frame of the components."""
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
  NativeType("touch", _SITE, "N"),
  NativeType("accelerometer", _SITE, "m/s^2", "own"),
  NativeType("velocimeter", _SITE, "m/s", "own"),
  NativeType("gyro", _SITE, "rad/s", "own"),
  NativeType("force", _SITE, "N", "own"),
  NativeType("torque", _SITE, "N m", "own"),
  NativeType("magnetometer", _SITE, "T", "own"),
  NativeType("rangefinder", ("site", "camera"), "m", "world"),
  NativeType("camprojection", _SITE, "pixel", "image", ("camera",), needs_reference=True),
  NativeType("jointpos", _JOINT, _ANGLE),
  NativeType("jointvel", _JOINT, _RATE),
  NativeType("tendonpos", _TENDON, _ANGLE),
  NativeType("tendonvel", _TENDON, _RATE),
  NativeType("actuatorpos", _ACTUATOR, _ANGLE),
  NativeType("actuatorvel", _ACTUATOR, _RATE),
  NativeType("actuatorfrc", _ACTUATOR, _EFFORT),
  NativeType("jointactuatorfrc", _JOINT, _EFFORT),
  NativeType("tendonactuatorfrc", _TENDON, _EFFORT),
  NativeType("ballquat", _JOINT, "", "own"),
  NativeType("ballangvel", _JOINT, "rad/s", "own"),
  NativeType("jointlimitpos", _JOINT, _ANGLE),
  NativeType("jointlimitvel", _JOINT, _RATE),
  NativeType("jointlimitfrc", _JOINT, _EFFORT),
  NativeType("tendonlimitpos", _TENDON, _ANGLE),
  NativeType("tendonlimitvel", _TENDON, _RATE),
  NativeType("tendonlimitfrc", _TENDON, _EFFORT),
  NativeType("framepos", _FRAMES, "m", "reference", _FRAMES),
  NativeType("framequat", _FRAMES, "", "reference", _FRAMES),
  NativeType("framexaxis", _FRAMES, "", "reference", _FRAMES),
  NativeType("frameyaxis", _FRAMES, "", "reference", _FRAMES),
  NativeType("framezaxis", _FRAMES, "", "reference", _FRAMES),
  NativeType("framelinvel", _FRAMES, "m/s", "reference", _FRAMES),
  NativeType("frameangvel", _FRAMES, "rad/s", "reference", _FRAMES),
  NativeType("framelinacc", _FRAMES, "m/s^2", "world"),
  NativeType("frameangacc", _FRAMES, "rad/s^2", "world"),
  NativeType("subtreecom", ("body",), "m", "world"),
  NativeType("subtreelinvel", ("body",), "m/s", "world"),
  NativeType("subtreeangmom", ("body",), "kg m^2/s", "world"),
  NativeType("insidesite", _FRAMES, "1, or m if enclosed", references=_SITE, needs_reference=True),
  NativeType("distance", _SHAPES, "m", references=_SHAPES, needs_reference=True),
  NativeType("normal", _SHAPES, "", "world", _SHAPES, needs_reference=True),
  NativeType("fromto", _SHAPES, "m", "world", _SHAPES, needs_reference=True),
  NativeType("contact", ("geom", "body", "xbody", "site"), "N, N m and m", "own", ("geom", "body", "xbody")),
  NativeType("e_potential", unit="J"),
  NativeType("e_kinetic", unit="J"),
  NativeType("clock", unit="s"),
  NativeType("tactile", ("mesh",), "m and m/s", "own", ("geom",), needs_reference=True),
  NativeType("plugin", (), "the plugin's own", "own"),
  NativeType("user", (), "the callback's own", "own"),
)

NATIVE_TYPES: dict[str, NativeType] = {kind.name: kind for kind in _TYPES}
"""Every type of `mujoco.mjtSensor`, by the name of its MJCF element."""
