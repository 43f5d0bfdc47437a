"""Table of everything that can be randomised, one row per field of MjModel or quantity beside it."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

from mjlab_core.mujoco.model_fields import SOURCES, followers

from mjlab_dr.fields import Field

_XYZ = ("x", "y", "z")
_ANGLES = ("roll", "pitch", "yaw")
_RGBA = ("red", "green", "blue", "alpha")
_POLY = ("quadratic", "cubic")
_TEN = tuple(str(i) for i in range(10))
_TEXTURES = ("user", "rgb", "occlusion", "roughness", "metallic", "normal", "opacity", "emissive", "rgba", "orm")


def _solref(**more) -> Field:
  note = "both positive, or both negative: then -stiffness and -damping"
  return Field("s, 1", axes=("timeconst", "dampratio"), note=note, **more)


def _solimp(**more) -> Field:
  return Field(
    "1, 1, m or rad, 1, 1",
    axes=("dmin", "dmax", "width", "midpoint", "power"),
    minimum=(0.0001, 0.0001, 0.0, 0.0001, 1.0),
    maximum=(0.9999, 0.9999, math.inf, 0.9999, math.inf),
    **more,
  )


def _at_least_zero(unit: str, **more) -> Field:
  return Field(unit, minimum=(0.0,), **more)


def _share(axes: tuple[str, ...] = ("",), **more) -> Field:
  return Field(axes=axes, minimum=(0.0,), maximum=(1.0,), **more)


def _position(**more) -> Field:
  return Field("m", axes=_XYZ, operation="add", **more)


def _rotation(**more) -> Field:
  return Field("rad", axes=_ANGLES, form="rotation", operation="add", **more)


def _range(unit: str, **more) -> Field:
  return Field(unit, axes=("lower", "upper"), ordered=True, **more)


def _flag() -> Field:
  return _share(integer=True)


def _parameter(unit: str, **more) -> Field:
  return Field(unit, minimum=(0.0,), operation="scale", in_model=False, **more)


_ROWS: dict[str, Field] = {
  # Options
  "opt.timestep": _at_least_zero("s", positive=True, note="environments count time in the compiled one"),
  "opt.gravity": Field("m/s^2", axes=_XYZ, note="world frame"),
  "opt.wind": Field("m/s", axes=_XYZ, note="world frame; needs a density or viscosity"),
  "opt.density": _at_least_zero("kg/m^3", from_zero=False),
  "opt.viscosity": _at_least_zero("Pa s", from_zero=False),
  "opt.magnetic": Field("T", axes=_XYZ, note="world frame; read by magnetometers"),
  # Bodies
  "body_mass": _at_least_zero(
    "kg",
    positive=True,
    note="inertia stays as it is; `pseudo_inertia` changes both together",
  ),
  "body_inertia": _at_least_zero(
    "kg m^2",
    axes=("I1", "I2", "I3"),
    note="principal moments, none above the sum of the other two",
  ),
  "body_ipos": _position(note="centre of mass in the body frame; not of simple bodies"),
  "body_iquat": _rotation(note="principal axes of inertia; not of simple bodies"),
  "pseudo_inertia": Field(
    "1, 1, 1, 1, 1, 1, 1, m, m, m",
    axes=("alpha", "d1", "d2", "d3", "s12", "s13", "s23", "t1", "t2", "t3"),
    form="pseudo_inertia",
    operation="add",
    fields=("body_mass", "body_ipos", "body_inertia", "body_iquat"),
    note="mass, centre of mass and inertia together, always physical; of simple bodies alpha and d alone",
  ),
  "body_pos": _position(note="not of floating and mocap bodies"),
  "body_quat": _rotation(note="not of floating and mocap bodies"),
  "body_gravcomp": Field(from_zero=False, note="1 makes it float"),
  # Joints
  "qpos0": Field(
    "rad or m",
    at="qpos",
    operation="add",
    moves_with="qpos_spring",
    note="reading of the joint in the pose of the MJCF, joints of one coordinate; its spring moves along",
  ),
  "qpos_spring": Field(
    "rad or m",
    at="qpos",
    operation="add",
    note="rest position of the spring, joints of one coordinate",
  ),
  "jnt_pos": _position(note="anchor in the body frame; not of simple bodies with several degrees of freedom"),
  "jnt_axis": Field(
    axes=_XYZ,
    form="direction",
    operation="add",
    note="of hinges and slides; not of simple bodies with several degrees of freedom",
  ),
  "jnt_range": _range("rad or m"),
  "jnt_margin": _at_least_zero("rad or m"),
  "jnt_solref": _solref(),
  "jnt_solimp": _solimp(),
  "jnt_stiffness": _at_least_zero("N m/rad or N/m"),
  "jnt_stiffnesspoly": Field(
    "N m/rad^2 or N/m^2, N m/rad^3 or N/m^3",
    axes=_POLY,
  ),
  "jnt_springyield": _at_least_zero("N m or N", from_zero=False),
  "jnt_actfrcrange": _range("N m or N", note="of all actuators of a joint together"),
  "dof_damping": _at_least_zero("N m s/rad or N s/m", at="dof"),
  "dof_dampingpoly": Field("N m s^2/rad^2 or N s^2/m^2, N m s^3/rad^3 or N s^3/m^3", axes=_POLY, at="dof"),
  "dof_armature": _at_least_zero("kg m^2 or kg", at="dof"),
  "dof_frictionloss": _at_least_zero("N m or N", at="dof"),
  "dof_solref": _solref(at="dof"),
  "dof_solimp": _solimp(at="dof"),
  # Geoms
  "geom_friction": _at_least_zero("1, m, m", axes=("sliding", "torsional", "rolling"), note="see `geom_friction`"),
  "geom_size": _at_least_zero(
    "m",
    axes=("size1", "size2", "size3"),
    positive=True,
    operation="scale",
    note="spheres 1, capsules and cylinders 2, boxes and ellipsoids 3; mass and inertia stay",
  ),
  "geom_pos": _position(note="a mesh is where MuJoCo centred it"),
  "geom_quat": _rotation(),
  "geom_solref": _solref(),
  "geom_solimp": _solimp(),
  "geom_solmix": _at_least_zero("1"),
  "geom_margin": _at_least_zero("m"),
  "geom_gap": _at_least_zero("m"),
  "geom_surfacevel": Field("m/s, m/s, m/s, rad/s, rad/s, rad/s", axes=(*_XYZ, *_ANGLES), from_zero=False),
  "geom_adhesion": _at_least_zero("N", from_zero=False),
  "geom_rgba": _share(_RGBA, note="takes the place of a material's colour"),
  "geom_matid": Field(integer=True, names="material"),
  # Sites, cameras, lights
  "site_pos": _position(),
  "site_quat": _rotation(),
  "cam_pos": _position(),
  "cam_quat": _rotation(),
  "cam_fovy": _at_least_zero("deg", maximum=(180.0,), positive=True, note="of cameras without a sensor size"),
  "cam_intrinsic": Field(
    "m",
    axes=("fx", "fy", "cx", "cy"),
    minimum=(0.0, 0.0, -math.inf, -math.inf),
    positive=True,
    form="intrinsics",
    fields=("cam_intrinsic", "cam_fovy"),
    operation="scale",
    note="of cameras with a sensor size; their field of view follows",
  ),
  "light_pos": _position(),
  "light_dir": Field(axes=_XYZ, form="direction", operation="add"),
  "light_active": _flag(),
  "light_castshadow": _flag(),
  "light_attenuation": _at_least_zero("1, 1/m, 1/m^2", axes=("constant", "linear", "quadratic")),
  "light_cutoff": _at_least_zero("deg", maximum=(180.0,), note="of spot lights"),
  "light_exponent": _at_least_zero("1", note="of spot lights"),
  "light_ambient": _at_least_zero("1", axes=_RGBA[:3]),
  "light_diffuse": _at_least_zero("1", axes=_RGBA[:3]),
  "light_specular": _at_least_zero("1", axes=_RGBA[:3]),
  # Materials
  "mat_rgba": _share(_RGBA, note="of geoms without a separate colour"),
  "mat_emission": _at_least_zero("1"),
  "mat_specular": _share(),
  "mat_shininess": _share(),
  "mat_texid": Field(axes=_TEXTURES, integer=True, names="texture"),
  "mat_texuniform": _flag(),
  "mat_texrepeat": _at_least_zero("1", axes=("u", "v"), positive=True),
  # Contact pairs
  "pair_friction": _at_least_zero(
    "1, 1, m, m, m",
    axes=("sliding1", "sliding2", "torsional", "rolling1", "rolling2"),
  ),
  "pair_solref": _solref(),
  "pair_solreffriction": _solref(from_zero=False),
  "pair_solimp": _solimp(),
  "pair_margin": _at_least_zero("m"),
  "pair_gap": _at_least_zero("m"),
  "pair_adhesion": _at_least_zero("N", from_zero=False),
  # Equalities
  "eq_data": Field(
    axes=tuple(str(i) for i in range(12)),
    note="connect 0-2, weld 0-2 anchor and 10 torque scale, joint and tendon 0-4 polynomial",
  ),
  "eq_solref": _solref(),
  "eq_solimp": _solimp(),
  # Tendons
  "tendon_range": _range("m or rad"),
  "tendon_margin": _at_least_zero("m or rad"),
  "tendon_solref_lim": _solref(),
  "tendon_solimp_lim": _solimp(),
  "tendon_solref_fri": _solref(),
  "tendon_solimp_fri": _solimp(),
  "tendon_actfrcrange": _range("N", note="of all actuators of a tendon together"),
  "tendon_stiffness": _at_least_zero("N/m", from_zero=False),
  "tendon_stiffnesspoly": Field("N/m^2, N/m^3", axes=_POLY, from_zero=False),
  "tendon_damping": _at_least_zero("N s/m", from_zero=False),
  "tendon_dampingpoly": Field("N s^2/m^2, N s^3/m^3", axes=_POLY, from_zero=False),
  "tendon_armature": _at_least_zero("kg", from_zero=False),
  "tendon_frictionloss": _at_least_zero("N", from_zero=False),
  "tendon_lengthspring": _range("m or rad", note="slack between the two"),
  "tendon_springyield": _at_least_zero("N", from_zero=False),
  # MuJoCo's own actuators
  "actuator_kp": _at_least_zero(
    "N m/rad or N/m",
    axes=("kp",),
    form="servo",
    fields=("actuator_gainprm", "actuator_biasprm"),
    operation="scale",
    note="of position actuators",
  ),
  "actuator_gainprm": Field(
    axes=_TEN,
    note="0 is kp of a position actuator, which reads -kp in biasprm 1: `actuator_kp` is both",
  ),
  "actuator_biasprm": Field(axes=_TEN, note="1 is -kp, 2 is -kd of a position actuator"),
  "actuator_dynprm": Field(axes=_TEN, note="0 is the time constant of a filter [s]"),
  "actuator_forcerange": _range("N or N m"),
  "actuator_ctrlrange": _range("of the control", at="ctrl"),
  "actuator_actrange": _range("of the activation"),
  "actuator_lengthrange": _range("m or rad", at="out", note="of muscles"),
  "actuator_gear": Field(
    axes=_TEN[:6],
    at="out",
    operation="scale",
    note="0 alone at joints and tendons",
  ),
  "actuator_cranklength": _at_least_zero(
    "m",
    positive=True,
    note="of slider-cranks",
  ),
  "actuator_armature": _at_least_zero("kg m^2 or kg", from_zero=False),
  "actuator_damping": _at_least_zero("N m s/rad or N s/m", from_zero=False),
  "actuator_dampingpoly": Field(axes=_POLY, from_zero=False),
  "actuator_delay": _at_least_zero("s", note="up to what its buffer of samples holds"),
  # Outside MjModel
  "encoder_bias": Field("rad or m", in_model=False, note="reading minus truth"),
  # Actuator models, for each joint, tendon or site that they drive
  "stiffness": _parameter("N m/rad or N/m"),
  "damping": _parameter("N m s/rad or N s/m"),
  "effort_limit": _parameter("N m or N", note="limits that the MJCF puts on the joint or tendon follow"),
  "delay": Field("physics steps", integer=True, minimum=(0.0,), in_model=False, note="one for a delay setting"),
}
_KINDS = {
  "opt": "option",
  "pseudo": "body",
  **dict.fromkeys(("jnt", "dof", "qpos", "encoder"), "joint"),
  "cam": "camera",
  "mat": "material",
  "eq": "equality",
  **dict.fromkeys(("stiffness", "damping", "effort", "delay"), "target"),
}
"""Kinds of elements by the first word of a field, where the word is another."""


def _kind(name: str) -> Any:
  word = re.split(r"[^a-z]", name)[0]
  return _KINDS.get(word, word)


FIELDS = {name: replace(row, kind=_kind(name)) for name, row in _ROWS.items()}
"""Every randomisable field by its name."""


def written_fields(name: str) -> tuple[str, ...]:
  """Return the fields of MjModel that the row `name` writes, the one that moves along left out."""
  return FIELDS[name].fields or (name,)


def followers_of(name: str) -> tuple[str, ...]:
  """Return the fields of MjModel that `mj_setConst` derives from what the row `name` writes."""
  return tuple(dict.fromkeys(follower for field in written_fields(name) for follower in followers(field)))


def needs_constants(name: str) -> bool:
  """Return True if `mj_setConst` must run after a change of the row `name`."""
  return not SOURCES.isdisjoint(written_fields(name))
