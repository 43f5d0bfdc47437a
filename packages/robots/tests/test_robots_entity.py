"""The Go1 as an entity: what the scene makes of its config is what the facts say."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjlab_actuators import ActuatorSet
from mjlab_robots import GO1_ACTUATORS, GO1_SOFT_JOINT_POS_LIMIT_FACTOR, go1, go1_spec
from mjlab_robots.go1 import CollisionPreset

FACTS = json.loads((Path(__file__).parent / "data" / "go1.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("preset", ["full", "feet_only"])
def test_contact_parameters_follow_the_preset(preset: CollisionPreset) -> None:
  cfg = go1(meshes="never", collision=preset)
  model = cfg.build("robot").spec.compile()
  for geom in FACTS["geoms_collision"]:
    index = model.geom(geom["name"]).id
    wanted = geom["contact_presets"][preset]
    collides = wanted["contype"] or wanted["conaffinity"]
    # Of a shape that touches nothing, nothing else matters.
    for name in wanted if collides else ("contype", "conaffinity"):
      np.testing.assert_allclose(getattr(model, f"geom_{name}")[index], wanted[name], err_msg=f"{geom['name']} {name}")


def test_an_unknown_preset_is_refused() -> None:
  with pytest.raises(ValueError, match="'full' or 'feet_only'"):
    go1(collision="feet")  # pyright: ignore[reportArgumentType]  # ty: ignore[invalid-argument-type]


def test_entity_starts_in_the_default_keyframe_with_the_facts_servos() -> None:
  entity = go1(meshes="never").build("robot")
  stand = FACTS["keyframes"]["stand"]
  state = entity.initial_state
  assert state.root_pose.tolist() == [*stand["root_pos"], *stand["root_quat"]]
  assert {name: float(value[0]) for name, value in state.joint_pos.items()} == stand["joint_pos"]
  assert [state.ctrl[servo["name"]] for servo in FACTS["actuators"]] == stand["ctrl"]
  model = entity.spec.compile()
  assert [model.actuator(i).name for i in range(model.nu)] == [servo["name"] for servo in FACTS["actuators"]]
  gains = [servo["kp"] for servo in FACTS["actuators"]]
  np.testing.assert_allclose(model.actuator_gainprm[:, 0], gains, rtol=1e-9)


def test_soft_limits_are_those_of_the_facts() -> None:
  assert FACTS["soft_joint_pos_limit_factor"] == GO1_SOFT_JOINT_POS_LIMIT_FACTOR
  articulation = go1(meshes="never").articulation
  assert articulation is not None
  assert articulation.soft_joint_pos_limit_factor == GO1_SOFT_JOINT_POS_LIMIT_FACTOR


def test_each_config_is_a_copy_of_its_own() -> None:
  first, second = go1(meshes="never"), go1(meshes="never")
  assert first.articulation is not None
  assert second.articulation is not None
  first.init_state.joint_pos = {".*": 0.0}
  first.articulation.actuators[0].armature = 1.0
  assert second.init_state.joint_pos != {".*": 0.0}
  assert second.articulation.actuators[0].armature != 1.0
  assert GO1_ACTUATORS[0].armature != 1.0


def test_servos_hold_the_robot_up() -> None:
  spec = go1_spec(meshes="never")
  ActuatorSet(GO1_ACTUATORS).edit_spec(spec)
  spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
  spec.option.timestep = 0.005
  spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
  model = spec.compile()
  data = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, data, 0)
  data.qpos[2] += 0.02
  for index in range(model.nu):
    data.ctrl[index] = data.joint(model.actuator(index).name).qpos[0]
  mujoco.mj_step(model, data, nstep=300)
  assert 0.2 < data.qpos[2] < 0.32
  assert data.body("trunk").xmat[8] > 0.98
  assert np.abs(data.qvel).max() < 0.5
