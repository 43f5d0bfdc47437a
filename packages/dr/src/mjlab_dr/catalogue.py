"""The fields that can be randomised: the one table from which everything else follows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import mujoco

Kind = Literal[
  "option", "body", "joint", "geom", "site", "camera", "light", "material", "tendon", "pair", "equality", "actuator"
]
Operation = Literal["absolute", "add", "scale"]
Form = Literal["plain", "direction", "rotation", "intrinsics", "servo", "pseudo_inertia"]


@dataclass(frozen=True, kw_only=True)
class Field:
  """What there is to know about one randomisable field."""

  kind: Kind
  """Whose field it is: patterns select among the names of this kind."""

  axes: tuple[str, ...] = ("",)
  """Names of what is drawn for one element; a single empty name for a scalar."""

  unit: str = "1"
  """Unit of every axis, one for all or separated by commas."""

  minimum: tuple[float, ...] = (-math.inf,)
  """Smallest admissible value, one for all axes or one each."""

  maximum: tuple[float, ...] = (math.inf,)
  """Largest admissible value, likewise."""

  positive: bool = False
  """Whether the minimum itself is not admissible."""

  ordered: bool = False
  """Whether the first axis must not exceed the second."""

  integer: bool = False
  """Whether it is a choice rather than a quantity: it is only replaced, and only by whole numbers."""

  names: Kind | Literal["texture"] | None = None
  """Of a choice: what its numbers are ids of, so that names can be given for them."""

  form: Form = "plain"
  """`direction`: written with unit length. `rotation`: axes are angles about the parent's x, y and z, written as a
  quaternion. `intrinsics`: written with the field of view that follows. `servo`: written as gain and, negated, as the
  feedback on position. `pseudo_inertia`: the ten log-Cholesky parameters, written as the `fields` of a body."""

  fields: tuple[str, ...] = ()
  """Fields of MjModel that it writes, where that is not the one of its own name."""

  moves_with: str = ""
  """A field that is moved by as much, so that one stays where it was relative to the other."""

  at: Literal["element", "dof", "qpos", "ctrl", "out"] = "element"
  """Where an element has its values: in its own row, or in those of its degrees of freedom, coordinates, controls or
  outputs, which share a draw."""

  derived: tuple[str, ...] = ()
  """Fields of MjModel with a value per world that follow from it through `mj_setConst`."""

  constants: bool = False
  """Whether `mj_setConst` reads it, so that it must run after a change; true wherever something is derived."""

  from_zero: bool = True
  """Whether an element that was compiled with zeros alone can be given a value: engines leave out what is off."""

  operation: Operation = "absolute"
  """What a draw does unless told otherwise."""

  in_model: bool = True
  """Whether MjModel has it. One that it does not have is (number of elements,) with the default zero."""

  note: str = ""
  """What a user should know."""

  @property
  def needs_constants(self) -> bool:
    """Whether derived quantities must be recomputed after a change."""
    return self.constants or bool(self.derived)

  @property
  def width(self) -> int:
    """Number of values of one element in its field."""
    return 4 if self.form == "rotation" else len(self.axes)

  def bounds(self, axis: int) -> tuple[float, float]:
    """Smallest and largest admissible value of an axis."""
    return self.minimum[axis % len(self.minimum)], self.maximum[axis % len(self.maximum)]

  def unit_of(self, axis: int) -> str:
    """Unit of an axis."""
    units = self.unit.split(", ")
    return units[axis % len(units)]


_INERTIA = ("body_invweight0", "dof_invweight0", "dof_M0", "tendon_invweight0", "actuator_acc0")
_CAMERA = ("cam_poscom0", "cam_pos0", "cam_mat0")
_LIGHT = ("light_poscom0", "light_pos0", "light_dir0")
_LENGTH = ("tendon_length0", "actuator_length0")
_KINEMATICS = (*_INERTIA, *_LENGTH, "eq_data", *_CAMERA, *_LIGHT)
# Of tendons that run through a site or around a geom, with their armature, and of actuators at sites.
_ROUTE = (*_LENGTH, *_INERTIA)

_XYZ = ("x", "y", "z")
_ANGLES = ("roll", "pitch", "yaw")
_RGBA = ("red", "green", "blue", "alpha")
_POLY = ("quadratic", "cubic")
_TEN = tuple(str(i) for i in range(10))
_TEXTURES = ("user", "rgb", "occlusion", "roughness", "metallic", "normal", "opacity", "emissive", "rgba", "orm")


def _solref(kind: Kind, **more) -> Field:
  note = "both positive, or both negative: then -stiffness and -damping"
  return Field(kind=kind, axes=("timeconst", "dampratio"), unit="s, 1", note=note, **more)


def _solimp(kind: Kind, **more) -> Field:
  return Field(
    kind=kind,
    axes=("dmin", "dmax", "width", "midpoint", "power"),
    unit="1, 1, m or rad, 1, 1",
    minimum=(0.0001, 0.0001, 0.0, 0.0001, 1.0),
    maximum=(0.9999, 0.9999, math.inf, 0.9999, math.inf),
    **more,
  )


def _at_least_zero(kind: Kind, unit: str, **more) -> Field:
  return Field(kind=kind, unit=unit, minimum=(0.0,), **more)


def _share(kind: Kind, axes: tuple[str, ...] = ("",), **more) -> Field:
  return Field(kind=kind, axes=axes, minimum=(0.0,), maximum=(1.0,), **more)


def _position(kind: Kind, **more) -> Field:
  return Field(kind=kind, axes=_XYZ, unit="m", operation="add", **more)


def _rotation(kind: Kind, **more) -> Field:
  return Field(kind=kind, axes=_ANGLES, unit="rad", form="rotation", operation="add", **more)


def _range(kind: Kind, unit: str, **more) -> Field:
  return Field(kind=kind, axes=("lower", "upper"), unit=unit, ordered=True, **more)


def _choice(kind: Kind, axes: tuple[str, ...] = ("",), **more) -> Field:
  return Field(kind=kind, axes=axes, integer=True, **more)


FIELDS: dict[str, Field] = {
  # Options
  "opt.timestep": Field(
    kind="option", unit="s", minimum=(0.0,), positive=True, note="environments go on counting in the compiled one"
  ),
  "opt.gravity": Field(kind="option", axes=_XYZ, unit="m/s^2", note="world frame"),
  "opt.wind": Field(kind="option", axes=_XYZ, unit="m/s", note="world frame; needs a density or viscosity"),
  "opt.density": _at_least_zero("option", "kg/m^3", from_zero=False),
  "opt.viscosity": _at_least_zero("option", "Pa s", from_zero=False),
  "opt.magnetic": Field(kind="option", axes=_XYZ, unit="T", note="world frame; what magnetometers see"),
  # Bodies
  "body_mass": Field(
    kind="body",
    unit="kg",
    minimum=(0.0,),
    positive=True,
    derived=("body_subtreemass", *_INERTIA, "cam_poscom0", "light_poscom0"),
    note="inertia stays as it is; `pseudo_inertia` changes both as one",
  ),
  "body_inertia": Field(
    kind="body",
    axes=("I1", "I2", "I3"),
    unit="kg m^2",
    minimum=(0.0,),
    derived=_INERTIA,
    note="principal moments, none above the sum of the other two",
  ),
  "body_ipos": _position(
    "body", derived=(*_INERTIA, "cam_poscom0", "light_poscom0"), note="centre of mass in the body frame"
  ),
  "body_iquat": _rotation("body", derived=_INERTIA, note="principal axes of inertia"),
  "pseudo_inertia": Field(
    kind="body",
    axes=("alpha", "d1", "d2", "d3", "s12", "s13", "s23", "t1", "t2", "t3"),
    unit="1, 1, 1, 1, 1, 1, 1, m, m, m",
    form="pseudo_inertia",
    operation="add",
    fields=("body_mass", "body_ipos", "body_inertia", "body_iquat"),
    derived=("body_subtreemass", *_INERTIA, "cam_poscom0", "light_poscom0"),
    note="mass, centre of mass and inertia as one, physical whatever is drawn",
  ),
  "body_pos": _position("body", derived=_KINEMATICS, note="of bodies whose pose is no state"),
  "body_quat": _rotation("body", derived=_KINEMATICS, note="of bodies whose pose is no state"),
  "body_gravcomp": Field(kind="body", constants=True, from_zero=False, note="1 makes it float"),
  # Joints
  "qpos0": Field(
    kind="joint",
    unit="rad or m",
    at="qpos",
    operation="add",
    moves_with="qpos_spring",
    derived=_LENGTH,
    note="what the joint reads where the model was drawn, joints of one coordinate; its spring moves along",
  ),
  "qpos_spring": Field(
    kind="joint",
    unit="rad or m",
    at="qpos",
    operation="add",
    constants=True,
    note="where the spring is at rest, joints of one coordinate",
  ),
  "jnt_pos": _position("joint", derived=_INERTIA, note="anchor in the body frame"),
  "jnt_axis": Field(
    kind="joint", axes=_XYZ, form="direction", operation="add", derived=_INERTIA, note="of hinges and slides"
  ),
  "jnt_range": _range("joint", "rad or m"),
  "jnt_margin": _at_least_zero("joint", "rad or m"),
  "jnt_solref": _solref("joint"),
  "jnt_solimp": _solimp("joint"),
  "jnt_stiffness": _at_least_zero("joint", "N m/rad or N/m"),
  "jnt_stiffnesspoly": Field(kind="joint", axes=_POLY, unit="N m/rad^2 or N/m^2, N m/rad^3 or N/m^3"),
  "jnt_springyield": _at_least_zero("joint", "N m or N", from_zero=False),
  "jnt_actfrcrange": _range("joint", "N m or N", note="of all actuators of a joint together"),
  "dof_damping": _at_least_zero("joint", "N m s/rad or N s/m", at="dof"),
  "dof_dampingpoly": Field(
    kind="joint", axes=_POLY, unit="N m s^2/rad^2 or N s^2/m^2, N m s^3/rad^3 or N s^3/m^3", at="dof"
  ),
  "dof_armature": _at_least_zero("joint", "kg m^2 or kg", at="dof", derived=_INERTIA),
  "dof_frictionloss": _at_least_zero("joint", "N m or N", at="dof"),
  "dof_solref": _solref("joint", at="dof"),
  "dof_solimp": _solimp("joint", at="dof"),
  # Geoms
  "geom_friction": Field(
    kind="geom", axes=("sliding", "torsional", "rolling"), unit="1, m, m", minimum=(0.0,), note="see `geom_friction`"
  ),
  "geom_size": Field(
    kind="geom",
    axes=("size1", "size2", "size3"),
    unit="m",
    minimum=(0.0,),
    positive=True,
    operation="scale",
    derived=("geom_aabb", "geom_rbound", *_ROUTE),
    note="spheres 1, capsules and cylinders 2, boxes and ellipsoids 3; mass and inertia stay",
  ),
  "geom_pos": _position("geom", constants=True, derived=_ROUTE, note="a mesh is where MuJoCo centred it"),
  "geom_quat": _rotation("geom", constants=True, derived=_ROUTE),
  "geom_solref": _solref("geom"),
  "geom_solimp": _solimp("geom"),
  "geom_solmix": _at_least_zero("geom", "1"),
  "geom_margin": _at_least_zero("geom", "m", constants=True),
  "geom_gap": _at_least_zero("geom", "m", constants=True),
  "geom_surfacevel": Field(
    kind="geom", axes=(*_XYZ, *_ANGLES), unit="m/s, m/s, m/s, rad/s, rad/s, rad/s", constants=True, from_zero=False
  ),
  "geom_adhesion": _at_least_zero("geom", "N", constants=True, from_zero=False),
  "geom_rgba": _share("geom", _RGBA, note="takes the place of a material's colour"),
  "geom_matid": _choice("geom", names="material"),
  # Sites, cameras, lights
  "site_pos": _position("site", constants=True, derived=_ROUTE),
  "site_quat": _rotation("site", constants=True, derived=_ROUTE),
  "cam_pos": _position("camera", derived=_CAMERA),
  "cam_quat": _rotation("camera", derived=_CAMERA),
  "cam_fovy": Field(
    kind="camera", unit="deg", minimum=(0.0,), maximum=(180.0,), positive=True, note="of cameras without a sensor size"
  ),
  "cam_intrinsic": Field(
    kind="camera",
    axes=("fx", "fy", "cx", "cy"),
    unit="m",
    minimum=(0.0, 0.0, -math.inf, -math.inf),
    positive=True,
    form="intrinsics",
    fields=("cam_intrinsic", "cam_fovy"),
    operation="scale",
    note="of cameras with a sensor size; their field of view follows",
  ),
  "light_pos": _position("light", derived=_LIGHT),
  "light_dir": Field(kind="light", axes=_XYZ, form="direction", operation="add", derived=_LIGHT),
  "light_active": _choice("light", minimum=(0.0,), maximum=(1.0,)),
  "light_castshadow": _choice("light", minimum=(0.0,), maximum=(1.0,)),
  "light_attenuation": _at_least_zero("light", "1, 1/m, 1/m^2", axes=("constant", "linear", "quadratic")),
  "light_cutoff": Field(kind="light", unit="deg", minimum=(0.0,), maximum=(180.0,), note="of spot lights"),
  "light_exponent": _at_least_zero("light", "1", note="of spot lights"),
  "light_ambient": _at_least_zero("light", "1", axes=_RGBA[:3]),
  "light_diffuse": _at_least_zero("light", "1", axes=_RGBA[:3]),
  "light_specular": _at_least_zero("light", "1", axes=_RGBA[:3]),
  # Materials
  "mat_rgba": _share("material", _RGBA, note="of geoms without a colour of their own"),
  "mat_emission": _at_least_zero("material", "1"),
  "mat_specular": _share("material"),
  "mat_shininess": _share("material"),
  "mat_texid": _choice("material", _TEXTURES, names="texture"),
  "mat_texuniform": _choice("material", minimum=(0.0,), maximum=(1.0,)),
  "mat_texrepeat": Field(kind="material", axes=("u", "v"), minimum=(0.0,), positive=True),
  # Contact pairs
  "pair_friction": Field(
    kind="pair",
    axes=("sliding1", "sliding2", "torsional", "rolling1", "rolling2"),
    unit="1, 1, m, m, m",
    minimum=(0.0,),
  ),
  "pair_solref": _solref("pair"),
  "pair_solreffriction": _solref("pair", from_zero=False),
  "pair_solimp": _solimp("pair"),
  "pair_margin": _at_least_zero("pair", "m"),
  "pair_gap": _at_least_zero("pair", "m"),
  "pair_adhesion": _at_least_zero("pair", "N", constants=True, from_zero=False),
  # Equalities
  "eq_data": Field(
    kind="equality",
    axes=tuple(str(i) for i in range(12)),
    derived=("eq_data",),
    note="connect 0-2, weld 0-2 anchor and 10 torque scale, joint and tendon 0-4 polynomial",
  ),
  "eq_solref": _solref("equality"),
  "eq_solimp": _solimp("equality"),
  # Tendons
  "tendon_range": _range("tendon", "m or rad"),
  "tendon_margin": _at_least_zero("tendon", "m or rad"),
  "tendon_solref_lim": _solref("tendon"),
  "tendon_solimp_lim": _solimp("tendon"),
  "tendon_solref_fri": _solref("tendon"),
  "tendon_solimp_fri": _solimp("tendon"),
  "tendon_actfrcrange": _range("tendon", "N", note="of all actuators of a tendon together"),
  "tendon_stiffness": _at_least_zero("tendon", "N/m", constants=True, from_zero=False),
  "tendon_stiffnesspoly": Field(kind="tendon", axes=_POLY, unit="N/m^2, N/m^3", constants=True, from_zero=False),
  "tendon_damping": _at_least_zero("tendon", "N s/m", constants=True, from_zero=False),
  "tendon_dampingpoly": Field(kind="tendon", axes=_POLY, unit="N s^2/m^2, N s^3/m^3", constants=True, from_zero=False),
  "tendon_armature": _at_least_zero("tendon", "kg", derived=_INERTIA, from_zero=False),
  "tendon_frictionloss": _at_least_zero("tendon", "N", from_zero=False),
  "tendon_lengthspring": _range("tendon", "m or rad", note="slack between the two"),
  "tendon_springyield": _at_least_zero("tendon", "N", from_zero=False),
  # MuJoCo's own actuators
  "actuator_kp": Field(
    kind="actuator",
    axes=("kp",),
    unit="N m/rad or N/m",
    minimum=(0.0,),
    form="servo",
    fields=("actuator_gainprm", "actuator_biasprm"),
    operation="scale",
    note="of position actuators",
  ),
  "actuator_gainprm": Field(
    kind="actuator",
    axes=_TEN,
    note="0 is kp of a position actuator, which reads -kp in biasprm 1: `actuator_kp` is both",
  ),
  "actuator_biasprm": Field(kind="actuator", axes=_TEN, note="1 is -kp, 2 is -kd of a position actuator"),
  "actuator_dynprm": Field(kind="actuator", axes=_TEN, note="0 is the time constant of a filter [s]"),
  "actuator_forcerange": _range("actuator", "N or N m"),
  "actuator_ctrlrange": _range("actuator", "of the control", at="ctrl"),
  "actuator_actrange": _range("actuator", "of the activation"),
  "actuator_lengthrange": _range("actuator", "m or rad", at="out", note="of muscles"),
  "actuator_gear": Field(
    kind="actuator",
    axes=_TEN[:6],
    at="out",
    operation="scale",
    derived=(*_INERTIA, "actuator_length0"),
    note="0 alone at joints and tendons",
  ),
  "actuator_cranklength": Field(
    kind="actuator",
    unit="m",
    minimum=(0.0,),
    positive=True,
    derived=(*_INERTIA, "actuator_length0"),
    note="of slider-cranks",
  ),
  "actuator_armature": _at_least_zero("actuator", "kg m^2 or kg", derived=_INERTIA, from_zero=False),
  "actuator_damping": _at_least_zero("actuator", "N m s/rad or N s/m", constants=True, from_zero=False),
  "actuator_dampingpoly": Field(kind="actuator", axes=_POLY, constants=True, from_zero=False),
  "actuator_delay": _at_least_zero("actuator", "s", note="up to what its buffer of samples holds"),
  # Outside of MjModel
  "encoder_bias": Field(kind="joint", unit="rad or m", in_model=False, note="reading minus truth"),
}
"""Every randomisable field by its name."""

_DERIVED = "follows from other fields"
_LAYOUT = "says where buffers are in memory"
_ACCURACY = "is the accuracy of the solver, no property of the world"

LEFT_OUT: dict[str, str] = {
  **dict.fromkeys(
    (
      *(
        "body_subtreemass",
        "body_invweight0",
        "dof_invweight0",
        "tendon_invweight0",
        "tendon_length0",
        "actuator_acc0",
      ),
      *("geom_aabb", "geom_rbound", *_CAMERA, *_LIGHT),
    ),
    _DERIVED,
  ),
  **dict.fromkeys(("actuator_history", "actuator_historyadr", "sensor_history", "sensor_historyadr"), _LAYOUT),
  **dict.fromkeys((f"opt.{x}tolerance" for x in ("", "ls_", "noslip_", "ccd_", "sleep_")), _ACCURACY),
  "opt.impratio_invsqrt": "belongs to the solver, and MuJoCo Warp alone stores it in this form",
  "sensor_delay": "is a property of the reader: observation terms have a delay of their own",
  "sensor_interval": "fixes how many samples a buffer holds, which is decided when the model is compiled",
  "light_type": "decides which code draws it, when the picture's context is made",
  "geom_dataid": "decides mesh, mass and bounds at once, which is what `VariantEntityCfg` of mjlab-scene is for",
}
"""What MuJoCo Warp can hold per world but is not randomised, and why."""

_OBJECTS: dict[str, tuple[mujoco.mjtObj, str]] = {
  "body": (mujoco.mjtObj.mjOBJ_BODY, "nbody"),
  "joint": (mujoco.mjtObj.mjOBJ_JOINT, "njnt"),
  "geom": (mujoco.mjtObj.mjOBJ_GEOM, "ngeom"),
  "site": (mujoco.mjtObj.mjOBJ_SITE, "nsite"),
  "camera": (mujoco.mjtObj.mjOBJ_CAMERA, "ncam"),
  "light": (mujoco.mjtObj.mjOBJ_LIGHT, "nlight"),
  "material": (mujoco.mjtObj.mjOBJ_MATERIAL, "nmat"),
  "texture": (mujoco.mjtObj.mjOBJ_TEXTURE, "ntex"),
  "tendon": (mujoco.mjtObj.mjOBJ_TENDON, "ntendon"),
  "pair": (mujoco.mjtObj.mjOBJ_PAIR, "npair"),
  "equality": (mujoco.mjtObj.mjOBJ_EQUALITY, "neq"),
  "actuator": (mujoco.mjtObj.mjOBJ_ACTUATOR, "nactuator"),
}


def count(model: mujoco.MjModel, kind: str) -> int:
  """Number of elements of a kind; the options are one."""
  return 1 if kind == "option" else getattr(model, _OBJECTS[kind][1])


def element_names(model: mujoco.MjModel, kind: str) -> list[str]:
  """Names of all elements of a kind in the order of the model; one without a name is called like "(geom 3)"."""
  if kind == "option":
    return ["option"]
  return [
    mujoco.mj_id2name(model, _OBJECTS[kind][0], i) or ("world" if kind == "body" and i == 0 else f"({kind} {i})")
    for i in range(count(model, kind))
  ]


def rows(model: mujoco.MjModel, field: Field, element: int) -> range:
  """Rows of an element in its field: its own, or those of its degrees of freedom, coordinates, controls or outputs."""
  if field.at == "element":
    return range(element, element + 1)
  if field.at == "dof":
    first, number = model.jnt_dofadr[element], _VELOCITIES[int(model.jnt_type[element])]
  elif field.at == "qpos":
    # Only joints of one coordinate have a value that can be moved along a line.
    first, number = model.jnt_qposadr[element], 1
  elif field.at == "ctrl":
    first, number = model.actuator_ctrladr[element], model.actuator_ctrlnum[element]
  else:
    first, number = model.actuator_outadr[element], model.actuator_outnum[element]
  return range(int(first), int(first) + int(number))


_VELOCITIES = {
  int(mujoco.mjtJoint.mjJNT_FREE): 6,
  int(mujoco.mjtJoint.mjJNT_BALL): 3,
  int(mujoco.mjtJoint.mjJNT_SLIDE): 1,
  int(mujoco.mjtJoint.mjJNT_HINGE): 1,
}
