"""One small model with something for every row of the catalogue, and how each row is tried on it."""

from typing import Any

import mujoco
import numpy as np
from mjlab_dr import FIELDS, Categorical, FieldRandomizer, randomize_field

EVERYTHING = """
<mujoco>
  <compiler angle="radian"/>
  <option density="1.2" viscosity="0.001" wind="1 0 .5" magnetic="0 -.5 .1"/>
  <default><geom contype="1" conaffinity="2"/></default>
  <asset>
    <texture name="wood" type="2d" builtin="flat" rgb1=".5 .3 .1" width="8" height="8"/>
    <texture name="steel" type="2d" builtin="flat" rgb1=".6 .6 .7" width="8" height="8"/>
    <material name="dull" texture="wood" texrepeat="2 3" emission=".1" specular=".4" shininess=".5" rgba=".8 .7 .6 .9"/>
    <material name="shiny" texture="steel" emission=".2" specular=".6" shininess=".7"/>
    <material name="painted" texture="wood"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" contype="2" conaffinity="1" condim="6"/>
    <light name="spot" type="spot" pos="1 1 4" dir="0 .2 -1" ambient=".1 .1 .1" diffuse=".6 .5 .4" specular=".3 .3 .3"
      attenuation="1 .1 .01" cutoff="40" exponent="8"/>
    <body name="post" pos="2 0 0">
      <inertial pos="0 0 .5" mass="4" diaginertia=".4 .4 .1"/>
      <geom name="post" type="cylinder" size=".1 .5" pos="0 0 .5" material="shiny"/>
    </body>
    <body name="trunk" pos="0 0 1.5">
      <freejoint name="root"/>
      <inertial pos=".02 .01 -.03" quat=".95 .1 .2 .05" mass="3" diaginertia=".05 .06 .07"/>
      <geom name="trunk" type="box" size=".2 .1 .08" pos=".01 0 .02" quat=".9 .1 .3 .2"
        friction=".7 .01 .002" margin=".01" gap=".002" solmix="2"
        surfacevel="0 0 0 0 0 .3" adhesion="1.5" rgba=".4 .5 .6 .9"/>
      <camera name="eye" pos=".2 0 .1" fovy="1"/>
      <camera name="lens" pos="-.2 0 .1" sensorsize=".004 .003" focal=".003 .003" principal=".0001 .0002"
        resolution="8 6"/>
      <camera name="follow" mode="trackcom" pos="1 0 1"/>
      <light name="lamp" type="directional" mode="track" pos="0 0 1" dir=".1 0 -1"/>
      <site name="anchor" pos="0 .1 .1"/>
      <body name="thigh" pos=".2 0 0" gravcomp=".5">
        <joint name="hip" axis="0 1 .1" pos="0 0 .02" range="-1 1.2" stiffness="3 .4 .2" springref=".2"
          damping=".6 .05 .02" armature=".02" frictionloss=".1" actuatorfrcrange="-20 25" margin=".01"/>
        <inertial pos="0 .01 -.15" quat=".9 .1 0 .2" mass="1.2" diaginertia=".02 .025 .012"/>
        <geom name="thigh" type="capsule" size=".04 .12" pos="0 .01 -.15"/>
        <geom name="roller" type="cylinder" size=".03 .05" pos="0 .05 -.1" quat="1 1 0 0" contype="0" conaffinity="0"
          material="painted" rgba=".8 .1 .1 1"/>
        <site name="side" pos="0 .12 0"/>
        <site name="knee" pos=".05 0 -.28"/>
        <body name="shin" pos="0 0 -.3" quat=".98 .1 .05 .1">
          <joint name="slide" type="slide" axis=".1 0 1" pos=".01 0 0" range="-.1 .15" stiffness="40" springref=".03"
            springyield="5" damping="2" frictionloss=".3" armature=".1"/>
          <inertial pos=".01 0 -.1" mass=".8" diaginertia=".01 .011 .004"/>
          <geom name="shin" type="sphere" size=".05" pos="0 0 -.2" condim="6" rgba=".2 .3 .4 1"/>
          <site name="tip" pos="0 0 -.2" quat=".9 .2 .1 0"/>
        </body>
      </body>
      <body name="arm" pos="-.2 0 0">
        <joint name="shoulder" type="ball" pos="0 0 .01" range="0 1" stiffness="2" damping=".3" armature=".01"
          frictionloss=".05" margin=".02"/>
        <inertial pos=".01 0 -.1" mass=".5" diaginertia=".004 .005 .003"/>
        <geom name="arm" type="ellipsoid" size=".03 .04 .1" pos="0 0 -.1"/>
        <body name="rod" pos="0 0 -.2">
          <joint name="crank" axis="0 1 0" damping=".1" limited="false"/>
          <inertial pos="0 0 -.05" mass=".2" diaginertia=".001 .001 .0005"/>
          <geom name="rod" type="capsule" size=".01" fromto="0 0 0 0 0 -.1"/>
          <site name="end" pos="0 0 -.1"/>
        </body>
        <site name="slider" pos="0 0 -.02"/>
      </body>
    </body>
    <body name="target" mocap="true" pos="1 1 1"/>
  </worldbody>
  <contact>
    <pair name="step" geom1="shin" geom2="post" condim="6" friction=".8 .9 .01 .001 .002" solreffriction=".03 1.1"
      margin=".01" gap=".001" adhesion=".7"/>
  </contact>
  <equality>
    <connect name="leash" body1="arm" body2="target" anchor="0 0 -.1" active="false"/>
    <weld name="glue" body1="shin" body2="post" anchor=".1 0 0" torquescale=".5" active="false"/>
    <joint name="couple" joint1="hip" joint2="crank" polycoef=".1 .5 0 0 0" active="false"/>
  </equality>
  <tendon>
    <spatial name="rope" limited="true" range=".1 2" margin=".01" stiffness="20 1 .5"
      damping="1 .1 .05" frictionloss=".2" springlength=".2 .3"
      actuatorfrclimited="true" actuatorfrcrange="-50 60" springyield="9">
      <site site="anchor"/><geom geom="roller" sidesite="side"/><site site="tip"/>
    </spatial>
    <fixed name="belt" stiffness="2" damping=".1" armature=".05">
      <joint joint="hip" coef="1"/><joint joint="crank" coef="-.5"/>
    </fixed>
  </tendon>
  <actuator>
    <position name="hip" joint="hip" kp="30" kv="2" forcerange="-40 45" ctrlrange="-1 1" delay=".004" nsample="8"
      armature=".01" damping=".2 .02 .01"/>
    <general name="rope" tendon="rope" dyntype="filter" dynprm=".05" gainprm="3" biastype="affine" biasprm=".1 -.2 -.3"
      actlimited="true" actrange="-2 3" gear="1.5"/>
    <muscle name="belt" tendon="belt" lengthrange=".1 .5" force="20"/>
    <general name="piston" cranksite="end" slidersite="slider" cranklength=".12"/>
    <motor name="pull" site="tip" refsite="anchor" gear="0 0 1 0 .2 0"/>
  </actuator>
</mujoco>
"""

_CHOICES: dict[str, Any] = {
  "geom_matid": ("post", Categorical(("dull", "shiny"))),
  "mat_texid": (".*", {"rgb": Categorical(("wood", "steel"), (1.0, 3.0))}),
  **dict.fromkeys(("light_active", "light_castshadow"), ("spot|lamp", Categorical((0, 1)))),
  "mat_texuniform": (".*", Categorical((0, 1))),
}
_ADDED: dict[str, tuple[float, float]] = {
  "opt.gravity": (-0.5, 0.5),
  "actuator_gainprm": (0.1, 0.3),
  "actuator_biasprm": (-0.3, -0.1),
  "actuator_dynprm": (0.001, 0.01),
  "eq_data": (-0.02, 0.02),
  "qpos0": (-0.1, 0.1),
  "qpos_spring": (-0.1, 0.1),
  "geom_surfacevel": (0.1, 0.2),
  "jnt_margin": (0.0, 0.01),
  "dof_frictionloss": (0.1, 0.2),
  "dof_armature": (0.01, 0.02),
  "jnt_stiffness": (0.0, 1.0),
  "jnt_stiffnesspoly": (0.0, 0.1),
  "dof_damping": (0.1, 0.2),
  "dof_dampingpoly": (0.0, 0.1),
  "geom_margin": (0.0, 0.01),
  "geom_gap": (0.0, 0.01),
  "light_ambient": (0.0, 0.3),
  "light_diffuse": (0.0, 0.3),
  "light_specular": (0.0, 0.3),
  "mat_emission": (0.0, 0.3),
  "tendon_stiffnesspoly": (0.0, 0.1),
  "tendon_dampingpoly": (0.0, 0.1),
  "tendon_margin": (0.0, 0.01),
}


def trial(name: str) -> FieldRandomizer:
  """A randomiser of all elements of `EVERYTHING` that one row of the catalogue makes sense for."""
  field = FIELDS[name]
  if name in _CHOICES:
    pattern, values = _CHOICES[name]
    return randomize_field(name, pattern, values)
  if name == "pseudo_inertia":
    sizes = {axis: 0.01 if axis.startswith("t") else 0.2 for axis in field.axes}
    return randomize_field(name, ".*", {axis: (-size, size) for axis, size in sizes.items()})
  if name == "cam_intrinsic":
    return randomize_field(name, ".*", {"fx": (0.8, 1.2), "fy": (0.8, 1.2), "cx": (-1.0, 1.0), "cy": (0.5, 2.0)})
  if name == "tendon_lengthspring":
    return randomize_field(name, ".*", (-0.05, 0.05), operation="add", isotropic=True)
  if name in _ADDED:
    return randomize_field(name, ".*", _ADDED[name], operation="add")
  if field.form == "rotation":
    return randomize_field(name, ".*", (-0.3, 0.3))
  if field.form == "direction":
    return randomize_field(name, ".*", (-0.2, 0.2))
  if name == "encoder_bias":
    return randomize_field(name, ".*", (-0.02, 0.02))
  if field.operation == "add":
    return randomize_field(name, ".*", (-0.01, 0.02))
  return randomize_field(name, ".*", (0.8, 1.0), operation="scale")


def owner_of(model: mujoco.MjModel, name: str) -> Any:
  """What holds a field, which is called without `opt.` there."""
  return model.opt if name.startswith("opt.") else model


def written_by(name: str) -> tuple[str, ...]:
  """Return the fields of a model that one row of the catalogue writes."""
  field = FIELDS[name]
  return field.fields or ((name, field.moves_with) if field.moves_with else (name,))


def numbers(model: mujoco.MjModel) -> dict[str, np.ndarray]:
  """Return every array of numbers of a compiled model, and its options."""
  out = {name: getattr(model, name, None) for name in dir(model) if not name.startswith("_")}
  options = ("timestep", "gravity", "wind", "density", "viscosity", "magnetic")
  out |= {f"opt.{name}": np.asarray(getattr(model.opt, name)) for name in options}
  return {name: value for name, value in out.items() if isinstance(value, np.ndarray) and value.dtype.kind in "fib"}


def check_numbers(actual: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
  """Compare all expected numbers of a model; MjModel has some in single precision, cam_fovy follows from those."""
  for name, value in expected.items():
    # What is equal, nearly everything, need not be compared slowly.
    if not np.array_equal(actual[name], value):
      is_single = value.dtype == np.float32 or name == "cam_fovy"
      np.testing.assert_allclose(actual[name], value, rtol=1e-6 if is_single else 1e-9, atol=1e-12, err_msg=name)


def put(model: mujoco.MjModel, name: str, value: np.ndarray) -> None:
  """Writes a field of a compiled model."""
  owner, attribute = owner_of(model, name), name.removeprefix("opt.")
  if np.ndim(value) == 0:
    setattr(owner, attribute, float(value))
  else:
    getattr(owner, attribute)[:] = np.reshape(value, getattr(owner, attribute).shape)


def recompiled(values: dict[str, np.ndarray]) -> mujoco.MjModel:
  """`EVERYTHING` compiled from a spec into which these values of fields were written."""
  spec = mujoco.MjSpec.from_string(EVERYTHING)
  model = spec.compile()
  numbers = {name: value for name, value in values.items() if not FIELDS[name].integer}
  if "cam_intrinsic" in numbers:
    # The compiler computes that of cameras with a sensor size, and refuses another.
    has_sensor = model.cam_sensorsize.any(axis=1)
    numbers["cam_fovy"] = np.where(has_sensor, model.cam_fovy, numbers["cam_fovy"])
  for name, value in numbers.items():
    put(model, name, value)
  mujoco.mj_setConst(model, mujoco.MjData(model))
  spec.copy_back(model)
  for name, value in values.items():
    if FIELDS[name].integer:
      _choose(spec, name, value)
    elif name in _NOT_COPIED:
      attribute, elements = _NOT_COPIED[name]
      for element in getattr(spec, elements):
        setattr(element, attribute, value[element.id])
  for tendon in spec.tendons:
    # The compiler measures a missing rest length; it is a value like any other, and does not follow from others.
    tendon.springlength = model.tendon_lengthspring[tendon.id]
  return spec.compile()


_NOT_COPIED = {
  "body_gravcomp": ("gravcomp", "bodies"),
  "jnt_actfrcrange": ("actfrcrange", "joints"),
  "actuator_delay": ("delay", "actuators"),
}
"""What `copy_back` does not write to a spec: the attribute there, and whose it is."""


def _choose(spec: mujoco.MjSpec, name: str, value: np.ndarray) -> None:
  """Writes a field of ids or switches into a spec."""
  if name == "geom_matid":
    for geom in spec.geoms:
      material = int(value[geom.id])
      geom.material = spec.materials[material].name if material >= 0 else ""
  elif name == "mat_texid":
    for material in spec.materials:
      material.textures[1] = spec.textures[int(value[material.id][1])].name
  else:
    attribute = name.partition("_")[2]
    for element in spec.lights if name.startswith("light") else spec.materials:
      setattr(element, attribute, bool(value[element.id]))
