"""Table of all types of native sensors: the objects they are attached to, and frame and unit of their readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco

_Type = mujoco.mjtSensor

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


def _site(enum: _Type, unit: str, stage: Stage, frame: ReadingFrame = "own", dim: int = 3) -> NativeType:
  return NativeType(enum=enum, objects=("site",), dim=dim, frame=frame, unit=unit, stage=stage)


def _part(enum: _Type, part: str, unit: str, stage: Stage = "position") -> NativeType:
  return NativeType(enum=enum, objects=(part,), unit=unit, stage=stage)


def _frame(enum: _Type, unit: str = "", stage: Stage = "position", dim: int = 3) -> NativeType:
  return NativeType(enum=enum, objects=_FRAMES, references=_FRAMES, dim=dim, frame="reference", unit=unit, stage=stage)


def _acceleration(enum: _Type, unit: str) -> NativeType:
  return NativeType(enum=enum, objects=_FRAMES, dim=3, frame="world", unit=unit, stage="acceleration")


def _subtree(enum: _Type, unit: str, stage: Stage) -> NativeType:
  return NativeType(enum=enum, objects=("body",), dim=3, frame="world", unit=unit, stage=stage)


def _nearest(enum: _Type, dim: int, frame: ReadingFrame, unit: str) -> NativeType:
  return NativeType(
    enum=enum,
    objects=("geom", "body"),
    references=("geom", "body"),
    needs_reference=True,
    dim=dim,
    frame=frame,
    unit=unit,
  )


_ANGLE, _RATE, _EFFORT = "rad or m", "rad/s or m/s", "N m or N"

NATIVE_TYPES: dict[str, NativeType] = {
  "touch": _site(_Type.mjSENS_TOUCH, "N", "acceleration", "scalar", dim=1),
  "accelerometer": _site(_Type.mjSENS_ACCELEROMETER, "m/s^2", "acceleration"),
  "velocimeter": _site(_Type.mjSENS_VELOCIMETER, "m/s", "velocity"),
  "gyro": _site(_Type.mjSENS_GYRO, "rad/s", "velocity"),
  "force": _site(_Type.mjSENS_FORCE, "N", "acceleration"),
  "torque": _site(_Type.mjSENS_TORQUE, "N m", "acceleration"),
  "magnetometer": _site(_Type.mjSENS_MAGNETOMETER, "T", "position"),
  "rangefinder": NativeType(
    enum=_Type.mjSENS_RANGEFINDER, objects=("site", "camera"), dim=None, frame="world", unit="m"
  ),
  "camprojection": NativeType(
    enum=_Type.mjSENS_CAMPROJECTION,
    objects=("site",),
    references=("camera",),
    needs_reference=True,
    dim=2,
    frame="image",
    unit="pixel",
  ),
  "jointpos": _part(_Type.mjSENS_JOINTPOS, "joint", _ANGLE),
  "jointvel": _part(_Type.mjSENS_JOINTVEL, "joint", _RATE, "velocity"),
  "tendonpos": _part(_Type.mjSENS_TENDONPOS, "tendon", _ANGLE),
  "tendonvel": _part(_Type.mjSENS_TENDONVEL, "tendon", _RATE, "velocity"),
  "actuatorpos": _part(_Type.mjSENS_ACTUATORPOS, "actuator", _ANGLE),
  "actuatorvel": _part(_Type.mjSENS_ACTUATORVEL, "actuator", _RATE, "velocity"),
  "actuatorfrc": _part(_Type.mjSENS_ACTUATORFRC, "actuator", _EFFORT, "acceleration"),
  "jointactuatorfrc": _part(_Type.mjSENS_JOINTACTFRC, "joint", _EFFORT, "acceleration"),
  "tendonactuatorfrc": _part(_Type.mjSENS_TENDONACTFRC, "tendon", _EFFORT, "acceleration"),
  "ballquat": NativeType(enum=_Type.mjSENS_BALLQUAT, objects=("joint",), dim=4, frame="own"),
  "ballangvel": NativeType(
    enum=_Type.mjSENS_BALLANGVEL, objects=("joint",), dim=3, frame="own", unit="rad/s", stage="velocity"
  ),
  "jointlimitpos": _part(_Type.mjSENS_JOINTLIMITPOS, "joint", _ANGLE),
  "jointlimitvel": _part(_Type.mjSENS_JOINTLIMITVEL, "joint", _RATE, "velocity"),
  "jointlimitfrc": _part(_Type.mjSENS_JOINTLIMITFRC, "joint", _EFFORT, "acceleration"),
  "tendonlimitpos": _part(_Type.mjSENS_TENDONLIMITPOS, "tendon", _ANGLE),
  "tendonlimitvel": _part(_Type.mjSENS_TENDONLIMITVEL, "tendon", _RATE, "velocity"),
  "tendonlimitfrc": _part(_Type.mjSENS_TENDONLIMITFRC, "tendon", _EFFORT, "acceleration"),
  "framepos": _frame(_Type.mjSENS_FRAMEPOS, "m"),
  "framequat": _frame(_Type.mjSENS_FRAMEQUAT, dim=4),
  "framexaxis": _frame(_Type.mjSENS_FRAMEXAXIS),
  "frameyaxis": _frame(_Type.mjSENS_FRAMEYAXIS),
  "framezaxis": _frame(_Type.mjSENS_FRAMEZAXIS),
  "framelinvel": _frame(_Type.mjSENS_FRAMELINVEL, "m/s", "velocity"),
  "frameangvel": _frame(_Type.mjSENS_FRAMEANGVEL, "rad/s", "velocity"),
  "framelinacc": _acceleration(_Type.mjSENS_FRAMELINACC, "m/s^2"),
  "frameangacc": _acceleration(_Type.mjSENS_FRAMEANGACC, "rad/s^2"),
  "subtreecom": _subtree(_Type.mjSENS_SUBTREECOM, "m", "position"),
  "subtreelinvel": _subtree(_Type.mjSENS_SUBTREELINVEL, "m/s", "velocity"),
  "subtreeangmom": _subtree(_Type.mjSENS_SUBTREEANGMOM, "kg m^2/s", "velocity"),
  "insidesite": NativeType(
    enum=_Type.mjSENS_INSIDESITE,
    objects=_FRAMES,
    references=("site",),
    needs_reference=True,
    unit="1, or m if enclosed",
  ),
  "distance": _nearest(_Type.mjSENS_GEOMDIST, 1, "scalar", "m"),
  "normal": _nearest(_Type.mjSENS_GEOMNORMAL, 3, "world", ""),
  "fromto": _nearest(_Type.mjSENS_GEOMFROMTO, 6, "world", "m"),
  "contact": NativeType(
    enum=_Type.mjSENS_CONTACT,
    objects=("geom", "body", "xbody", "site"),
    references=("geom", "body", "xbody"),
    dim=None,
    frame="own",
    unit="N, N m and m",
    stage="acceleration",
    declared_by="ContactSensorCfg",
  ),
  "e_potential": NativeType(enum=_Type.mjSENS_E_POTENTIAL, unit="J"),
  "e_kinetic": NativeType(enum=_Type.mjSENS_E_KINETIC, unit="J"),
  "clock": NativeType(enum=_Type.mjSENS_CLOCK, unit="s"),
  "tactile": NativeType(
    enum=_Type.mjSENS_TACTILE,
    objects=("mesh",),
    references=("geom",),
    needs_reference=True,
    dim=None,
    frame="own",
    unit="m and m/s",
    stage="velocity",
  ),
  "plugin": NativeType(
    enum=_Type.mjSENS_PLUGIN, dim=None, frame="own", unit="the plugin's own", stage="acceleration", declared_by=None
  ),
  "user": NativeType(
    enum=_Type.mjSENS_USER, dim=None, frame="own", unit="the callback's own", stage="acceleration", declared_by=None
  ),
}
"""Every type of `mujoco.mjtSensor`, by the name of its MJCF element."""
