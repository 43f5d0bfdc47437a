"""Table of all types of native sensors: the objects they are attached to, and frame and unit of their readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

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


@dataclass(kw_only=True, frozen=True)
class NativeType:
  """Type of native sensor."""

  enum: mujoco.mjtSensor
  """MuJoCo's number for it."""
  objects: tuple[str, ...] = ()
  """Kinds of elements it can be attached to; none for a sensor of the whole world."""
  references: tuple[str, ...] = ()
  """Kinds of elements it can be measured relative to."""
  needs_reference: bool = False
  """True if a reference is required."""
  dim: int | None = 1
  """Numbers of a reading; None where that depends on the sensor's settings."""
  frame: ReadingFrame = "scalar"
  """Frame of the components."""
  unit: str = ""
  """Unit of a reading; empty for a pure number."""
  stage: Stage = "position"
  """Stage in which MuJoCo computes it. Readings of the acceleration stage are those of the substep just done."""
  declared_by: str | None = "BuiltinSensorCfg"
  """Config that adds a new one; None if only an MJCF can. Existing ones can always be read."""


_FRAMES = ("body", "xbody", "geom", "site", "camera")


def _row(**fields: Any) -> dict[str, Any]:
  """Return fields of a `NativeType`, all but its number."""
  return fields


def _site(unit: str, stage: Stage, frame: ReadingFrame = "own", dim: int = 3) -> dict[str, Any]:
  return _row(objects=("site",), dim=dim, frame=frame, unit=unit, stage=stage)


def _part(part: str, unit: str, stage: Stage = "position") -> dict[str, Any]:
  return _row(objects=(part,), unit=unit, stage=stage)


def _frame(unit: str = "", stage: Stage = "position", dim: int = 3) -> dict[str, Any]:
  return _row(objects=_FRAMES, references=_FRAMES, dim=dim, frame="reference", unit=unit, stage=stage)


def _acceleration(unit: str) -> dict[str, Any]:
  return _row(objects=_FRAMES, dim=3, frame="world", unit=unit, stage="acceleration")


def _subtree(unit: str, stage: Stage) -> dict[str, Any]:
  return _row(objects=("body",), dim=3, frame="world", unit=unit, stage=stage)


def _nearest(dim: int, frame: ReadingFrame, unit: str) -> dict[str, Any]:
  return _row(
    objects=("geom", "body"),
    references=("geom", "body"),
    needs_reference=True,
    dim=dim,
    frame=frame,
    unit=unit,
  )


_ANGLE, _RATE, _EFFORT = "rad or m", "rad/s or m/s", "N m or N"

_ROWS: dict[str, dict[str, Any]] = {
  "touch": _site("N", "acceleration", "scalar", dim=1),
  "accelerometer": _site("m/s^2", "acceleration"),
  "velocimeter": _site("m/s", "velocity"),
  "gyro": _site("rad/s", "velocity"),
  "force": _site("N", "acceleration"),
  "torque": _site("N m", "acceleration"),
  "magnetometer": _site("T", "position"),
  "rangefinder": _row(objects=("site", "camera"), dim=None, frame="world", unit="m"),
  "camprojection": _row(
    objects=("site",),
    references=("camera",),
    needs_reference=True,
    dim=2,
    frame="image",
    unit="pixel",
  ),
  "jointpos": _part("joint", _ANGLE),
  "jointvel": _part("joint", _RATE, "velocity"),
  "tendonpos": _part("tendon", _ANGLE),
  "tendonvel": _part("tendon", _RATE, "velocity"),
  "actuatorpos": _part("actuator", _ANGLE),
  "actuatorvel": _part("actuator", _RATE, "velocity"),
  "actuatorfrc": _part("actuator", _EFFORT, "acceleration"),
  "jointactuatorfrc": _part("joint", _EFFORT, "acceleration"),
  "tendonactuatorfrc": _part("tendon", _EFFORT, "acceleration"),
  "ballquat": _row(objects=("joint",), dim=4, frame="own"),
  "ballangvel": _row(objects=("joint",), dim=3, frame="own", unit="rad/s", stage="velocity"),
  "jointlimitpos": _part("joint", _ANGLE),
  "jointlimitvel": _part("joint", _RATE, "velocity"),
  "jointlimitfrc": _part("joint", _EFFORT, "acceleration"),
  "tendonlimitpos": _part("tendon", _ANGLE),
  "tendonlimitvel": _part("tendon", _RATE, "velocity"),
  "tendonlimitfrc": _part("tendon", _EFFORT, "acceleration"),
  "framepos": _frame("m"),
  "framequat": _frame(dim=4),
  "framexaxis": _frame(),
  "frameyaxis": _frame(),
  "framezaxis": _frame(),
  "framelinvel": _frame("m/s", "velocity"),
  "frameangvel": _frame("rad/s", "velocity"),
  "framelinacc": _acceleration("m/s^2"),
  "frameangacc": _acceleration("rad/s^2"),
  "subtreecom": _subtree("m", "position"),
  "subtreelinvel": _subtree("m/s", "velocity"),
  "subtreeangmom": _subtree("kg m^2/s", "velocity"),
  "insidesite": _row(
    objects=_FRAMES,
    references=("site",),
    needs_reference=True,
    unit="1, or m if enclosed",
  ),
  "distance": _nearest(1, "scalar", "m"),
  "normal": _nearest(3, "world", ""),
  "fromto": _nearest(6, "world", "m"),
  "contact": _row(
    objects=("geom", "body", "xbody", "site"),
    references=("geom", "body", "xbody"),
    dim=None,
    frame="own",
    unit="N, N m and m",
    stage="acceleration",
    declared_by="ContactSensorCfg",
  ),
  "e_potential": _row(unit="J"),
  "e_kinetic": _row(unit="J"),
  "clock": _row(unit="s"),
  "tactile": _row(
    objects=("mesh",),
    references=("geom",),
    needs_reference=True,
    dim=None,
    frame="own",
    unit="m and m/s",
    stage="velocity",
  ),
  "plugin": _row(dim=None, frame="own", unit="the plugin's own", stage="acceleration", declared_by=None),
  "user": _row(dim=None, frame="own", unit="the callback's own", stage="acceleration", declared_by=None),
}
# Names of MuJoCo's types that are not those of their MJCF elements.
_OTHER_NAMES = {
  "jointactuatorfrc": "jointactfrc",
  "tendonactuatorfrc": "tendonactfrc",
  "distance": "geomdist",
  "normal": "geomnormal",
  "fromto": "geomfromto",
}

NATIVE_TYPES: dict[str, NativeType] = {
  name: NativeType(enum=getattr(mujoco.mjtSensor, f"mjSENS_{_OTHER_NAMES.get(name, name).upper()}"), **row)
  for name, row in _ROWS.items()
}
"""Every type of `mujoco.mjtSensor`, by the name of its MJCF element."""
