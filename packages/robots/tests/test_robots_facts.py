"""Every compiled quantity of each robot against the reference facts in data/."""

import json
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mjlab_robots
import mujoco
import numpy as np
import pytest
from mjlab_actuators import ActuatorSet
from mjlab_core.names import match_values_full

# Relative to the largest entry. The facts used eleven digits of pi.
TOLERANCE = 1e-9


@dataclass(eq=False)
class Robot:
  """Robot with its reference facts."""

  name: str

  def constant(self, name: str) -> Any:
    """Return what the package exports under the robot's name."""
    return getattr(mjlab_robots, f"{self.name.upper()}_{name}")

  @cached_property
  def facts(self) -> dict[str, Any]:
    return json.loads((Path(__file__).parent / "data" / f"{self.name}.json").read_text(encoding="utf-8"))

  @cached_property
  def model(self) -> mujoco.MjModel:
    return compiled(self.configured_spec())

  @cached_property
  def standing(self) -> mujoco.MjData:
    """In the default keyframe."""
    data = mujoco.MjData(self.model)
    mujoco.mj_resetDataKeyframe(self.model, data, self.model.key(self.default_key).id)
    mujoco.mj_forward(self.model, data)
    return data

  @property
  def default_key(self) -> str:
    (name,) = [name for name, key in self.facts["keyframes"].items() if key["is_default"]]
    return name

  @property
  def joints(self) -> list[str]:
    return [joint["name"] for joint in self.facts["joints"] if joint["type"] != "free"]

  def configured_spec(self) -> mujoco.MjSpec:
    spec = getattr(mjlab_robots, f"{self.name}_spec")("never")
    ActuatorSet(self.constant("ACTUATORS")).edit_spec(spec)
    if any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints):
      return spec
    # A scene places a fixed base by a mocap body.
    scene = mujoco.MjSpec()
    base = scene.worldbody.add_body(name="mocap_base", mocap=True, pos=[0, 0, self.constant("DEFAULT_HEIGHT")])
    scene.attach(spec, prefix="", frame=base.add_frame())
    return scene


ROBOTS = tuple(Robot(name) for name in ("go1", "g1", "yam"))
GO2 = Robot("go2")
each_robot = pytest.mark.parametrize("robot", ROBOTS, ids=[robot.name for robot in ROBOTS])


def each(argument: str, section: str) -> pytest.MarkDecorator:
  """One test for each entry of a section of the facts of each robot."""
  return pytest.mark.parametrize(
    ("robot", argument),
    [
      pytest.param(robot, entry, id=f"{robot.name}-{entry['name']}")
      for robot in ROBOTS
      for entry in robot.facts[section]
    ],
  )


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
  with warnings.catch_warnings():
    # The spec is not saved.
    warnings.filterwarnings("ignore", "Attaching a spec with an empty prefix")
    return spec.compile()


def assert_equal(got: Any, wanted: Any, what: str) -> None:
  got, wanted = np.asarray(got, dtype=np.float64), np.asarray(wanted, dtype=np.float64)
  np.testing.assert_allclose(got, wanted, rtol=0.0, atol=TOLERANCE * np.abs(wanted).max(initial=0.0), err_msg=what)


def assert_same_rotation(got: Any, wanted: Any, what: str) -> None:
  got, wanted = np.asarray(got), np.asarray(wanted)
  assert_equal(got * np.sign(got @ wanted), wanted, what)


@each("body", "bodies")
def test_body_equals_the_facts(robot: Robot, body: dict[str, Any]) -> None:
  model = robot.model
  got = model.body(body["name"])
  index = got.id
  assert model.body(model.body_parentid[index]).name == body["parent"]
  assert_equal(model.body_pos[index], body["pos"], "pos")
  assert_same_rotation(model.body_quat[index], body["quat"], "quat")
  assert_equal(model.body_mass[index], body["mass"], "mass")
  assert_equal(model.body_ipos[index], body["com"], "com")
  assert_same_rotation(model.body_iquat[index], body["iquat"], "iquat")
  np.testing.assert_allclose(model.body_inertia[index], body["diaginertia"], rtol=TOLERANCE)
  assert_equal(model.body_subtreemass[index], body["subtree_mass"], "subtree mass")
  assert_equal(model.body_gravcomp[index], body["gravcomp"], "gravcomp")
  assert (model.body_mocapid[index] >= 0) == body["mocap"]
  rotation = np.zeros(9)
  mujoco.mju_quat2Mat(rotation, model.body_iquat[index])
  rotation = rotation.reshape(3, 3)
  inertia = rotation @ np.diag(model.body_inertia[index]) @ rotation.T
  wanted = body["fullinertia_at_com_body_axes"]
  rows = [[wanted[min(a, b) + max(a, b)] for b in "xyz"] for a in "xyz"]
  np.testing.assert_allclose(inertia, rows, rtol=0, atol=TOLERANCE * np.abs(rows).max())


@each("joint", "joints")
def test_joint_equals_the_facts(robot: Robot, joint: dict[str, Any]) -> None:
  model = robot.model
  index = model.joint(joint["name"]).id
  assert mujoco.mjtJoint(model.jnt_type[index]).name == f"mjJNT_{joint['type'].upper()}"
  assert model.body(model.jnt_bodyid[index]).name == joint["body"]
  dof = model.jnt_dofadr[index]
  assert (model.jnt_qposadr[index], dof) == (joint["qposadr"], joint["dofadr"])
  if joint["type"] == "free":
    return
  got = {
    "axis": model.jnt_axis[index],
    "pos": model.jnt_pos[index],
    "limited": model.jnt_limited[index],
    "range": model.jnt_range[index],
    "armature": model.dof_armature[dof],
    "damping": model.dof_damping[dof],
    "dampingpoly": model.dof_dampingpoly[dof],
    "frictionloss": model.dof_frictionloss[dof],
    "stiffness": model.jnt_stiffness[index],
    "ref_qpos0": model.qpos0[joint["qposadr"]],
    "springref": model.qpos_spring[joint["qposadr"]],
    "margin": model.jnt_margin[index],
    "solref_limit": model.jnt_solref[index],
    "solimp_limit": model.jnt_solimp[index],
    "solref_friction": model.dof_solref[dof],
    "solimp_friction": model.dof_solimp[dof],
    "actfrclimited": model.jnt_actfrclimited[index],
    "actfrcrange": model.jnt_actfrcrange[index],
  }
  for name, value in got.items():
    assert_equal(value, joint[name], name)


# Numbers of a placed element in the model, by their names in the facts.
PLACED = {
  "geom": ("geoms_collision", ("size", "group")),
  "site": ("sites", ("size", "group")),
  "cam": ("cameras", ("resolution", "sensorsize")),
}


@pytest.mark.parametrize(
  ("robot", "kind", "entry"),
  [
    pytest.param(robot, kind, entry, id=f"{robot.name}-{kind}-{entry['name']}")
    for robot in ROBOTS
    for kind, (section, _) in PLACED.items()
    for entry in robot.facts[section]
  ],
)
def test_geom_site_and_camera_equal_the_facts(robot: Robot, kind: str, entry: dict[str, Any]) -> None:
  model = robot.model
  # One geom has no name in the facts.
  index = getattr(model, kind)(entry["name"] or "camera_housing").id
  got = {name: getattr(model, f"{kind}_{name}")[index] for name in (*PLACED[kind][1], "bodyid", "pos", "quat")}
  assert model.body(got.pop("bodyid")).name == entry["body"]
  assert_same_rotation(got.pop("quat"), entry["quat"], "quat")
  wanted = dict(entry)
  if kind == "cam":
    assert mujoco.mjtCamLight(model.cam_mode[index]).name == f"mjCAMLIGHT_{entry['mode'].upper()}"
    got |= {"fovy_deg": model.cam_fovy[index], "intrinsic_focal_xy_principal_xy": model.cam_intrinsic[index]}
  else:
    kinds = getattr(model, f"{kind}_type")
    assert mujoco.mjtGeom(kinds[index]).name == f"mjGEOM_{entry['type'].upper()}"
  if kind == "geom":
    contact = {name: value for name, value in entry["contact_presets"]["full"].items() if value is not None}
    got |= {name: getattr(model, f"geom_{name}")[index] for name in contact}
    wanted |= contact
  for name, value in got.items():
    assert_equal(value, wanted[name], name)


@each_robot
def test_exactly_the_listed_shapes_collide(robot: Robot) -> None:
  model = robot.model
  colliding = {model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i] or model.geom_conaffinity[i]}
  listed = robot.facts["geoms_collision"]
  assert colliding == {geom["name"] for geom in listed if geom["contact_presets"]["full"]["contype"]}
  assert not np.any(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)


@each_robot
def test_excluded_pairs_equal_the_facts(robot: Robot) -> None:
  model = robot.model
  pairs = [{model.body(int(pair) >> 16).name, model.body(int(pair) & 0xFFFF).name} for pair in model.exclude_signature]
  assert sorted(map(sorted, pairs)) == sorted(map(sorted, robot.facts["contact_excludes"]))


@each("sensor", "sensors")
def test_sensor_equals_the_facts(robot: Robot, sensor: dict[str, Any]) -> None:
  model = robot.model
  index = model.sensor(sensor["name"]).id
  assert mujoco.mjtSensor(model.sensor_type[index]).name == f"mjSENS_{sensor['type'].upper()}"
  assert mujoco.mj_id2name(model, model.sensor_objtype[index], model.sensor_objid[index]) == sensor["objname"]
  if sensor["refname"] is not None:
    assert mujoco.mj_id2name(model, model.sensor_reftype[index], model.sensor_refid[index]) == sensor["refname"]
  got = (model.sensor_dim[index], model.sensor_adr[index], model.sensor_noise[index], model.sensor_cutoff[index])
  assert got == (sensor["dim"], sensor["adr"], sensor["noise"], sensor["cutoff"])


@each_robot
def test_light_and_materials_equal_the_facts(robot: Robot) -> None:
  model = robot.model
  (light,) = robot.facts["lights"]
  assert model.nlight == 1
  assert model.body(model.light_bodyid[0]).name == light["body"]
  assert mujoco.mjtCamLight(model.light_mode[0]).name == f"mjCAMLIGHT_{light['mode'].upper()}"
  if light["target"] is not None:
    assert model.body(model.light_targetbodyid[0]).name == light["target"]
  assert_equal(model.light_pos[0], light["pos"], "pos")
  assert_equal(model.light_dir[0], light["dir"], "dir")
  assert bool(model.light_castshadow[0]) == light["castshadow"]
  for material in robot.facts["materials"]:
    assert_equal(model.material(material["name"]).rgba, material["rgba"], material["name"])


@each_robot
def test_equalities_equal_the_facts(robot: Robot) -> None:
  model, facts = robot.model, robot.facts["equalities"]
  assert model.neq == len(facts)
  for index, equality in enumerate(facts):
    assert model.eq_type[index] == mujoco.mjtEq.mjEQ_JOINT
    joints = [model.joint(ids[index]).name for ids in (model.eq_obj1id, model.eq_obj2id)]
    assert joints == [equality["joint1"], equality["joint2"]]
    assert bool(model.eq_active0[index]) == equality["active"]
    assert_equal(model.eq_data[index, :5], equality["polycoef"], "polycoef")
    assert_equal(model.eq_solref[index], equality["solref"], "solref")
    assert_equal(model.eq_solimp[index], equality["solimp"], "solimp")


@each("servo", "actuators")
def test_servo_equals_the_facts(robot: Robot, servo: dict[str, Any]) -> None:
  model = robot.model
  index = model.actuator(servo["name"]).id
  assert index == model.actuator_ctrladr[index] == servo["ctrl_index"]
  assert model.joint(model.actuator_trnid[index, 0]).name == servo["joint"]
  got = {
    "gainprm": model.actuator_gainprm[index, :3],
    "biasprm": model.actuator_biasprm[index, :3],
    "gear": model.actuator_gear[index],
    "forcelimited": model.actuator_forcelimited[index],
    "forcerange": model.actuator_forcerange[index],
    "ctrllimited": model.actuator_ctrllimited[index],
    "ctrlrange_informational": model.actuator_ctrlrange[index],
  }
  for name, value in got.items():
    assert_equal(value, servo[name], name)
  assert model.actuator_dyntype[index] == mujoco.mjtDyn.mjDYN_NONE
  assert model.actuator_gaintype[index] == mujoco.mjtGain.mjGAIN_FIXED
  assert model.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_AFFINE
  driven = robot.facts["policy_action_order"]
  scale = dict(zip(driven, match_values_full(robot.constant("ACTION_SCALE"), driven, what="joint"), strict=True))
  assert_equal(scale[servo["joint"]], servo["action_scale"], "action scale")


@each_robot
def test_joints_come_in_the_order_of_the_policy(robot: Robot) -> None:
  actions = robot.facts["policy_action_order"]
  assert [name for i in range(robot.model.njnt) if (name := robot.model.joint(i).name) in actions] == actions


@each_robot
def test_keyframes_and_default_pose_equal_the_facts(robot: Robot) -> None:
  model, keys = robot.model, robot.facts["keyframes"]
  assert model.nkey == len(keys)
  for name, key in keys.items():
    assert_equal(model.key(name).qpos, key["qpos"], name)
  default = keys[robot.default_key]
  assert model.key(0).name == robot.default_key
  assert default["root_pos"] == [0.0, 0.0, robot.constant("DEFAULT_HEIGHT")]
  values = match_values_full(robot.constant("DEFAULT_JOINT_POS"), robot.joints, what="joint", default=0.0)
  pose = dict(zip(robot.joints, values, strict=True))
  assert pose == default["joint_pos"]
  ctrl = [pose[model.joint(model.actuator_trnid[i, 0]).name] for i in range(model.nu)]
  assert ctrl == default["ctrl"]


@each_robot
def test_counts_equal_the_facts_except_for_drawn_geoms(robot: Robot) -> None:
  drawn = {"ngeom", "nmesh", "nmat"}
  # The facts are those of a configured robot, whose only keyframe is its initial state.
  for name, count in robot.facts["counts"].items():
    if name not in drawn | {"nkey", "total_mass"}:
      assert getattr(robot.model, name) == count, name
  assert_equal(mujoco.mj_getTotalmass(robot.model), robot.facts["counts"]["total_mass"], "total mass")
  assert robot.model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER


@each_robot
def test_derived_quantities_equal_the_facts(robot: Robot) -> None:
  model, facts = robot.model, robot.facts["derived_reference"]
  assert_equal(model.qpos0, facts["qpos0"], "qpos0")
  data = mujoco.MjData(model)
  mujoco.mj_forward(model, data)
  mass = np.zeros((model.nv, model.nv))
  mujoco.mj_fullM(model, data, mass)
  np.testing.assert_allclose(np.diag(mass), facts["mass_matrix_diag_at_qpos0"], rtol=TOLERANCE)
  np.testing.assert_allclose(model.dof_invweight0, facts["dof_invweight0"], rtol=TOLERANCE)
  assert_equal(model.stat.meaninertia, facts["stat"]["meaninertia"], "meaninertia")
  assert_equal(model.stat.meanmass, facts["stat"]["meanmass"], "meanmass")
  for body, position in facts["bodies_world_xpos_at_default_key"].items():
    assert_equal(robot.standing.body(body).xpos, position, body)
  assert_equal(robot.standing.subtree_com[1], facts["com_world_at_default_key"], "com")


@each_robot
def test_lowest_point_of_the_default_pose_is_that_of_the_facts(robot: Robot) -> None:
  lowest = robot.facts["derived_reference"]["lowest_collision_point_z_at_default_key"]
  index = robot.model.geom(lowest["geom"]).id
  radius, half_length, _ = robot.model.geom_size[index]
  upright = abs(robot.standing.geom_xmat[index, 8])
  assert_equal(robot.standing.geom_xpos[index, 2] - half_length * upright - radius, lowest["z"], "lowest point")


@pytest.mark.parametrize("robot", [*ROBOTS, GO2], ids=lambda robot: robot.name)
def test_drawn_geoms_have_neither_mass_nor_contact(robot: Robot) -> None:
  drawn = robot.model.geom_group == 2
  assert not (robot.model.geom_contype[drawn] | robot.model.geom_conaffinity[drawn]).any()
  bare = robot.configured_spec()
  for geom in [geom for geom in bare.geoms if geom.group == 2]:
    bare.delete(geom)
  plain = compiled(bare)
  assert robot.model.ngeom > plain.ngeom
  for field in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_invweight0"):
    np.testing.assert_array_equal(getattr(robot.model, field), getattr(plain, field))


# Symmetry augmentation needs symmetric robots. Parts on the middle plane are not quite symmetric.
LIMBS = [
  (robot, f"{end}L_{part}", f"{end}R_{part}")
  for robot in (ROBOTS[0], GO2)
  for end in "FR"
  for part in ("hip", "thigh", "calf")
]
LIMBS += [
  (ROBOTS[1], f"left_{part}_link", f"right_{part}_link")
  for part in (
    *("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll"),
    *("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw"),
  )
]
# Deviations in the figures of the robots, which are kept.
KEPT = {
  "go1 FL_calf": {"ipos": 2e-3},
  "go1 RL_calf": {"ipos": 2e-3},
  "g1 left_shoulder_pitch_link": {"pos": 1.1e-5},
  "g1 left_knee_link": {"inertia": 7e-6},
}


@pytest.mark.parametrize(("robot", "left", "right"), LIMBS, ids=[f"{robot.name}-{left}" for robot, left, _ in LIMBS])
def test_limbs_are_mirror_images(robot: Robot, left: str, right: str) -> None:
  one, other = robot.model.body(left), robot.model.body(right)
  for field, mirror in {"pos": [1, -1, 1], "ipos": [1, -1, 1], "inertia": [1, 1, 1], "mass": [1]}.items():
    tolerance = KEPT.get(f"{robot.name} {left}", {}).get(field, 1e-15)
    np.testing.assert_allclose(getattr(one, field), getattr(other, field) * mirror, rtol=0, atol=tolerance)
