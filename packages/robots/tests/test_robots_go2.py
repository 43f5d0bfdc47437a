"""The Go2 compared with the figures of its public MJCF in data/go2.json, and its symmetry."""

import json
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mjlab_actuators import ActuatorSet
from mjlab_robots import GO2_ACTION_SCALE, GO2_ACTUATORS, GO2_DEFAULT_HEIGHT, GO2_DEFAULT_JOINT_POS, go2, go2_spec

FACTS: dict[str, Any] = json.loads((Path(__file__).parent / "data" / "go2.json").read_text(encoding="utf-8"))
LEGS = ("FR", "FL", "RR", "RL")


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
  spec = go2_spec("never")
  ActuatorSet(GO2_ACTUATORS).edit_spec(spec)
  return spec.compile()


@pytest.mark.parametrize("name", FACTS["bodies"])
def test_a_body_has_the_published_frame_mass_and_inertia(model: mujoco.MjModel, name: str) -> None:
  facts, body = FACTS["bodies"][name], model.body(name)
  assert model.body(body.parentid[0]).name == facts["parent"]
  np.testing.assert_allclose(body.pos, facts["pos"])
  np.testing.assert_allclose(body.mass, facts["mass"])
  np.testing.assert_allclose(body.ipos, facts["com"])
  np.testing.assert_allclose(body.inertia, facts["diaginertia"])
  # Six digits of a rotation are published.
  quat = np.array(facts["iquat"])
  np.testing.assert_allclose(body.iquat, quat / np.linalg.norm(quat), atol=1e-9)


def test_bodies_and_mass_are_all_of_the_published_ones(model: mujoco.MjModel) -> None:
  assert {model.body(i).name for i in range(1, model.nbody)} == set(FACTS["bodies"])
  assert model.body_subtreemass[1] == pytest.approx(15.206408)


def test_joints_are_in_the_order_of_the_sdk_with_the_published_ranges(model: mujoco.MjModel) -> None:
  names = [model.joint(i).name for i in range(1, model.njnt)]
  assert names == [f"{leg}_{part}_joint" for leg in LEGS for part in ("hip", "thigh", "calf")]
  for name in names:
    joint = model.joint(name)
    np.testing.assert_allclose(joint.range, FACTS["ranges"][name], err_msg=name)
    np.testing.assert_array_equal(joint.axis, [1, 0, 0] if "_hip_" in name else [0, 1, 0])


def test_motors_have_the_published_efforts_and_servos_of_ten_hertz(model: mujoco.MjModel) -> None:
  for i in range(model.nu):
    actuator = model.actuator(i)
    part = actuator.name.split("_")[1]
    limit = FACTS["effort_limits"][part]
    np.testing.assert_allclose(actuator.forcerange, [-limit, limit])
    inertia = 0.000111842 * (6.33 * (1.0 if part != "calf" else limit / 23.7)) ** 2
    assert model.dof_armature[model.joint(actuator.name).dofadr[0]] == pytest.approx(inertia)
    assert actuator.gainprm[0] == pytest.approx(inertia * (20.0 * math.pi) ** 2)
    assert GO2_ACTION_SCALE[f".*_{part}_joint"] == pytest.approx(0.25 * limit / actuator.gainprm[0])


def test_feet_are_where_the_keyframe_says(model: mujoco.MjModel) -> None:
  data = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
  mujoco.mj_forward(model, data)
  assert data.qpos[2] == GO2_DEFAULT_HEIGHT
  pose = [GO2_DEFAULT_JOINT_POS[f".*_{part}_joint"] for part in ("hip", "thigh", "calf")]
  np.testing.assert_array_equal(data.qpos[7:], pose * 4)
  lowest = [data.geom(f"{leg}_foot_collision").xpos[2] - 0.022 for leg in LEGS]
  # 0.27 m less two links of 0.213 m at 0.9 rad and the foot, 2 mm behind its link.
  expected = 0.27 - 2 * 0.213 * math.cos(0.9) - 0.002 * math.sin(0.9) - 0.022
  np.testing.assert_allclose(lowest, expected, atol=1e-12)
  assert not data.ncon


def test_shapes_of_legs_are_mirror_images(model: mujoco.MjModel) -> None:
  for i in range(model.ngeom):
    name = model.geom(i).name
    if name[:2] in ("FL", "RL"):
      left, right = model.geom(name), model.geom(name[0] + "R" + name[2:])
      np.testing.assert_array_equal(left.size, right.size)
      np.testing.assert_allclose(left.pos, right.pos * np.array([1, -1, 1]), atol=1e-15)


def test_only_feet_collide_with_the_ground_alone_in_the_other_preset() -> None:
  model = go2(meshes="never", collision="feet_only").build("robot").spec.compile()
  colliding = [model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i] or model.geom_conaffinity[i]]
  assert colliding == [f"{leg}_foot_collision" for leg in LEGS]
  assert not model.geom_contype.any()
