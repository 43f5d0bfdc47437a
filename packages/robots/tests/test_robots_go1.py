"""Every compiled quantity of the Go1 against the reference facts in data/go1.json."""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mjlab_actuators import ActuatorSet
from mjlab_core.names import match_values_full
from mjlab_robots import GO1_ACTION_SCALE, GO1_ACTUATORS, GO1_DEFAULT_HEIGHT, GO1_DEFAULT_JOINT_POS, go1_spec

FACTS: dict[str, Any] = json.loads((Path(__file__).parent / "data" / "go1.json").read_text(encoding="utf-8"))
# Relative to the largest entry. What we derive uses pi in full where the facts used eleven digits of it.
TOLERANCE = 1e-9


def configured_spec() -> mujoco.MjSpec:
  spec = go1_spec(meshes="never")
  ActuatorSet(GO1_ACTUATORS).edit_spec(spec)
  return spec


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
  return configured_spec().compile()


@pytest.fixture(scope="module")
def standing(model: mujoco.MjModel) -> mujoco.MjData:
  data = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
  mujoco.mj_forward(model, data)
  return data


def assert_equal(got: Any, wanted: Any, what: str) -> None:
  got, wanted = np.asarray(got, dtype=np.float64), np.asarray(wanted, dtype=np.float64)
  np.testing.assert_allclose(got, wanted, rtol=0.0, atol=TOLERANCE * np.abs(wanted).max(initial=0.0), err_msg=what)


def assert_same_rotation(got: Any, wanted: Any, what: str) -> None:
  got, wanted = np.asarray(got), np.asarray(wanted)
  assert_equal(got * np.sign(got @ wanted), wanted, what)


def by_name(section: str) -> list[Any]:
  return [pytest.param(entry, id=entry["name"]) for entry in FACTS[section]]


@pytest.mark.parametrize("body", by_name("bodies"))
def test_body_equals_the_facts(model: mujoco.MjModel, body: dict[str, Any]) -> None:
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


@pytest.mark.parametrize("joint", by_name("joints"))
def test_joint_equals_the_facts(model: mujoco.MjModel, joint: dict[str, Any]) -> None:
  index = model.joint(joint["name"]).id
  kinds = {"free": mujoco.mjtJoint.mjJNT_FREE, "hinge": mujoco.mjtJoint.mjJNT_HINGE}
  assert model.jnt_type[index] == kinds[joint["type"]]
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


@pytest.mark.parametrize("geom", by_name("geoms_collision"))
def test_collision_shape_and_contact_preset_equal_the_facts(model: mujoco.MjModel, geom: dict[str, Any]) -> None:
  index = model.geom(geom["name"]).id
  assert mujoco.mjtGeom(model.geom_type[index]).name == f"mjGEOM_{geom['type'].upper()}"
  assert model.body(model.geom_bodyid[index]).name == geom["body"]
  assert model.geom_group[index] == geom["group"]
  assert_equal(model.geom_size[index], geom["size"], "size")
  assert_equal(model.geom_pos[index], geom["pos"], "pos")
  assert_same_rotation(model.geom_quat[index], geom["quat"], "quat")
  for name, value in geom["contact_presets"]["full"].items():
    assert_equal(getattr(model, f"geom_{name}")[index], value, name)


def test_what_collides_is_exactly_the_listed_shapes(model: mujoco.MjModel) -> None:
  colliding = {model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i] or model.geom_conaffinity[i]}
  assert colliding == {geom["name"] for geom in FACTS["geoms_collision"]}
  assert not np.any(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)


@pytest.mark.parametrize("site", by_name("sites"))
def test_site_equals_the_facts(model: mujoco.MjModel, site: dict[str, Any]) -> None:
  index = model.site(site["name"]).id
  assert model.body(model.site_bodyid[index]).name == site["body"]
  assert mujoco.mjtGeom(model.site_type[index]).name == f"mjGEOM_{site['type'].upper()}"
  assert model.site_group[index] == site["group"]
  assert_equal(model.site_pos[index], site["pos"], "pos")
  assert_same_rotation(model.site_quat[index], site["quat"], "quat")
  assert_equal(model.site_size[index], site["size"], "size")


@pytest.mark.parametrize("sensor", by_name("sensors"))
def test_sensor_equals_the_facts(model: mujoco.MjModel, sensor: dict[str, Any]) -> None:
  index = model.sensor(sensor["name"]).id
  assert mujoco.mjtSensor(model.sensor_type[index]).name == f"mjSENS_{sensor['type'].upper()}"
  assert mujoco.mj_id2name(model, model.sensor_objtype[index], model.sensor_objid[index]) == sensor["objname"]
  if sensor["refname"] is not None:
    assert mujoco.mj_id2name(model, model.sensor_reftype[index], model.sensor_refid[index]) == sensor["refname"]
  got = (model.sensor_dim[index], model.sensor_adr[index], model.sensor_noise[index], model.sensor_cutoff[index])
  assert got == (sensor["dim"], sensor["adr"], sensor["noise"], sensor["cutoff"])


@pytest.mark.parametrize("camera", by_name("cameras"))
def test_camera_equals_the_facts(model: mujoco.MjModel, camera: dict[str, Any]) -> None:
  index = model.camera(camera["name"]).id
  assert model.body(model.cam_bodyid[index]).name == camera["body"]
  assert model.cam_mode[index] == mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
  assert_equal(model.cam_pos[index], camera["pos"], "pos")
  assert_same_rotation(model.cam_quat[index], camera["quat"], "quat")
  assert_equal(model.cam_fovy[index], camera["fovy_deg"], "fovy")
  assert_equal(model.cam_resolution[index], camera["resolution"], "resolution")


def test_light_and_material_equal_the_facts(model: mujoco.MjModel) -> None:
  (light,) = FACTS["lights"]
  assert model.nlight == 1
  assert model.body(model.light_bodyid[0]).name == light["body"]
  assert model.light_mode[0] == mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
  assert_equal(model.light_pos[0], light["pos"], "pos")
  assert_equal(model.light_dir[0], light["dir"], "dir")
  assert bool(model.light_castshadow[0]) == light["castshadow"]
  (dark,) = FACTS["materials"]
  got = model.material(dark["name"])
  assert_equal(got.rgba, dark["rgba"], "rgba")


@pytest.mark.parametrize("servo", by_name("actuators"))
def test_servo_equals_the_facts(model: mujoco.MjModel, servo: dict[str, Any]) -> None:
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
  (scale,) = [s for name, s in zip(joints(), scales(), strict=True) if name == servo["joint"]]
  assert_equal(scale, servo["action_scale"], "action scale")


def joints() -> list[str]:
  return [joint["name"] for joint in FACTS["joints"] if joint["type"] != "free"]


def scales() -> list[float]:
  return match_values_full(GO1_ACTION_SCALE, joints(), what="joint")


def test_joints_come_in_the_order_of_the_policy(model: mujoco.MjModel) -> None:
  assert [model.joint(i).name for i in range(1, model.njnt)] == FACTS["policy_action_order"]


def test_keyframe_and_default_pose_equal_the_facts(model: mujoco.MjModel) -> None:
  stand = FACTS["keyframes"]["stand"]
  assert model.nkey == 1
  assert_equal(model.key("stand").qpos, stand["qpos"], "qpos")
  assert stand["root_pos"] == [0.0, 0.0, GO1_DEFAULT_HEIGHT]
  pose = dict(zip(joints(), match_values_full(GO1_DEFAULT_JOINT_POS, joints(), what="joint"), strict=True))
  assert pose == stand["joint_pos"]
  ctrl = [pose[model.joint(model.actuator_trnid[i, 0]).name] for i in range(model.nu)]
  assert ctrl == stand["ctrl"]


def test_counts_equal_the_facts_apart_from_what_is_only_drawn(model: mujoco.MjModel) -> None:
  drawn = {"ngeom", "nmesh", "nmat", "total_mass"}
  for name, count in FACTS["counts"].items():
    if name not in drawn:
      assert getattr(model, name) == count, name
  assert_equal(mujoco.mj_getTotalmass(model), FACTS["counts"]["total_mass"], "total mass")
  assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER


def test_derived_quantities_equal_the_facts(model: mujoco.MjModel, standing: mujoco.MjData) -> None:
  facts = FACTS["derived_reference"]
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
    assert_equal(standing.body(body).xpos, position, body)
  assert_equal(standing.subtree_com[1], facts["com_world_at_default_key"], "com")


def test_lowest_point_of_the_default_pose_is_a_foot(model: mujoco.MjModel, standing: mujoco.MjData) -> None:
  lowest = FACTS["derived_reference"]["lowest_collision_point_z_at_default_key"]
  index = model.geom(lowest["geom"]).id
  assert_equal(standing.geom_xpos[index, 2] - model.geom_size[index, 0], lowest["z"], "lowest point")


def test_what_is_drawn_has_neither_mass_nor_contact() -> None:
  bare = configured_spec()
  for geom in [geom for geom in bare.geoms if geom.group == 2]:
    bare.delete(geom)
  drawn, plain = configured_spec().compile(), bare.compile()
  assert drawn.ngeom > plain.ngeom
  for field in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_invweight0"):
    np.testing.assert_array_equal(getattr(drawn, field), getattr(plain, field))


def test_legs_are_mirror_images() -> None:
  """Symmetry augmentation is only valid on a symmetric robot; the trunk's own inertia is not."""
  model = configured_spec().compile()
  for front in "FR":
    for part in ("hip", "thigh", "calf"):
      left, right = model.body(f"{front}L_{part}"), model.body(f"{front}R_{part}")
      np.testing.assert_allclose(left.pos, right.pos * [1, -1, 1], atol=1e-15)
      assert left.mass == right.mass
      np.testing.assert_array_equal(left.inertia, right.inertia)
