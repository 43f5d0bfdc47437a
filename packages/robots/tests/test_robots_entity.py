"""Each robot as an entity, compared with the facts."""

import json
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjlab_actuators import ActuatorCfg, ActuatorSet
from mjlab_robots import G1_ACTUATORS, GO1_ACTUATORS, YAM_ACTUATORS, MeshMode, g1, g1_spec, go1, go1_spec, yam
from mjlab_robots.yam import CollisionPreset
from mjlab_scene import EntityCfg

ROBOTS: dict[str, Callable[..., EntityCfg]] = {"go1": go1, "g1": g1, "yam": yam}
FACTS = {
  name: json.loads((Path(__file__).parent / "data" / f"{name}.json").read_text(encoding="utf-8")) for name in ROBOTS
}
each_robot = pytest.mark.parametrize("name", ROBOTS)


@pytest.mark.parametrize(
  ("name", "preset"),
  [(name, preset) for name in ROBOTS for preset in FACTS[name]["geoms_collision"][0]["contact_presets"]],
)
def test_contact_parameters_follow_the_preset(name: str, preset: str) -> None:
  model = ROBOTS[name](meshes="never", collision=preset).build("robot").spec.compile()
  for geom in FACTS[name]["geoms_collision"]:
    index = model.geom(geom["name"] or "camera_housing").id
    wanted = geom["contact_presets"][preset]
    collides = wanted["contype"] or wanted["conaffinity"]
    # Other parameters of a shape without contacts do not matter.
    for field in wanted if collides else ("contype", "conaffinity"):
      np.testing.assert_allclose(
        getattr(model, f"geom_{field}")[index], wanted[field], err_msg=f"{geom['name']} {field}"
      )


@each_robot
def test_an_unknown_preset_is_refused_with_those_that_exist(name: str) -> None:
  with pytest.raises(ValueError, match="collision preset 'paws' does not exist") as refusal:
    ROBOTS[name](collision="paws")
  for preset in FACTS[name]["geoms_collision"][0]["contact_presets"]:
    assert preset in str(refusal.value)


@each_robot
def test_entity_starts_in_the_default_keyframe_with_the_facts_servos(name: str) -> None:
  entity, facts = ROBOTS[name](meshes="never").build("robot"), FACTS[name]
  (default,) = [key for key in facts["keyframes"].values() if key["is_default"]]
  state = entity.initial_state
  assert state.root_pose.tolist() == [*default["root_pos"], *default["root_quat"]]
  assert {joint: float(value[0]) for joint, value in state.joint_pos.items()} == default["joint_pos"]
  assert [x for servo in facts["actuators"] for x in state.ctrl[servo["name"]]] == default["ctrl"]
  model = entity.spec.compile()
  assert [model.actuator(i).name for i in range(model.nu)] == [servo["name"] for servo in facts["actuators"]]
  gains = [servo["kp"] for servo in facts["actuators"]]
  np.testing.assert_allclose(model.actuator_gainprm[:, 0], gains, rtol=1e-9)


@each_robot
def test_soft_limits_are_those_of_the_facts(name: str) -> None:
  articulation = ROBOTS[name](meshes="never").articulation
  assert articulation is not None
  assert articulation.soft_joint_pos_limit_factor == FACTS[name]["soft_joint_pos_limit_factor"]


@each_robot
def test_configs_share_nothing(name: str) -> None:
  first, second = ROBOTS[name](meshes="never"), ROBOTS[name](meshes="never")
  assert first.articulation is not None
  assert second.articulation is not None
  first.init_state.joint_pos = {".*": 0.0}
  first.articulation.actuators[0].armature = 1.0
  assert second.init_state.joint_pos != {".*": 0.0}
  assert second.articulation.actuators[0].armature != 1.0
  assert GO1_ACTUATORS[0].armature != 1.0
  assert G1_ACTUATORS[0].armature != 1.0
  assert YAM_ACTUATORS[0].armature != 1.0


# Ankles are too soft to balance a humanoid for longer than the time it takes its legs to settle.
@pytest.mark.parametrize(
  ("spec_fn", "actuators", "lift", "steps", "lowest", "highest"),
  [
    pytest.param(go1_spec, GO1_ACTUATORS, 0.02, 300, 0.2, 0.32, id="go1"),
    pytest.param(g1_spec, G1_ACTUATORS, 0.0, 60, 0.72, 0.77, id="g1"),
  ],
)
def test_servos_hold_the_robot_up(
  spec_fn: Callable[[MeshMode], mujoco.MjSpec],
  actuators: tuple[ActuatorCfg, ...],
  lift: float,
  steps: int,
  lowest: float,
  highest: float,
) -> None:
  spec = spec_fn("never")
  ActuatorSet(actuators).edit_spec(spec)
  spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
  spec.option.timestep = 0.005
  spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
  model = spec.compile()
  data = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, data, 0)
  data.qpos[2] += lift
  for index in range(model.nu):
    data.ctrl[index] = data.joint(model.actuator(index).name).qpos[0]
  mujoco.mj_step(model, data, nstep=steps)
  assert lowest < data.qpos[2] < highest
  assert data.xmat[1, 8] > 0.98
  assert np.abs(data.qvel).max() < 1.0


def grasping(collision: CollisionPreset) -> tuple[mujoco.MjModel, mujoco.MjData]:
  """Return the arm at home on a floor, with a cube of 4 cm to move."""
  spec = yam(meshes="never", collision=collision).build("robot").spec
  spec.option.timestep = 0.005
  spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
  spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1], pos=[0, 0, -0.05])
  cube = spec.worldbody.add_body(name="cube", mocap=True, pos=[0.0, 0.0, -1.0])
  cube.add_geom(name="cube", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02] * 3)
  model = spec.compile()
  data = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, data, 0)
  data.ctrl[:] = data.qpos[:7]
  mujoco.mj_forward(model, data)
  return model, data


def touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[frozenset[str]]:
  return {frozenset(model.geom(int(g)).name for g in contact.geom) for contact in data.contact}


@pytest.mark.parametrize("collision", ["full", "gripper_only"])
def test_the_arm_at_home_touches_nothing_at_any_opening(collision: CollisionPreset) -> None:
  model, data = grasping(collision)
  _, high = model.joint("left_finger").range
  for opening in np.linspace(0.002, high, 5):
    data.qpos[6:8] = opening, -opening
    mujoco.mj_forward(model, data)
    assert not touching(model, data)


@pytest.mark.parametrize("collision", ["full", "gripper_only"])
def test_only_the_full_preset_has_contacts_of_the_arm(collision: CollisionPreset) -> None:
  model, data = grasping(collision)
  data.mocap_pos[0] = data.geom("link3_1_collision").xpos
  mujoco.mj_forward(model, data)
  assert (frozenset({"cube", "link3_1_collision"}) in touching(model, data)) == (collision == "full")
  data.mocap_pos[0, 2] = -1.0
  # The forearm is folded onto the upper arm, then the arm lies down.
  data.qpos[:6] = 1.0, 1.0, 0.15, -1.5, 1.0, 1.7
  mujoco.mj_forward(model, data)
  bodies = [{model.body(model.geom_bodyid[int(g)]).name for g in contact.geom} for contact in data.contact]
  folded = any(pair <= {"link_2", "link_5"} for pair in bodies)
  data.qpos[:6] = 0.0, 3.6, 3.2, 0.0, 0.0, 0.0
  mujoco.mj_forward(model, data)
  laid = frozenset({"floor", "link3_1_collision"}) in touching(model, data)
  assert (folded, laid) == ((True, True) if collision == "full" else (False, False))


def test_the_right_finger_follows_the_left_one_under_load() -> None:
  model, data = grasping("gripper_only")
  for target in (0.035, 0.002):
    data.ctrl[6] = target
    mujoco.mj_step(model, data, nstep=400)
    np.testing.assert_allclose(data.joint("left_finger").qpos, target, atol=2e-3)
    np.testing.assert_allclose(data.joint("right_finger").qpos, -data.joint("left_finger").qpos, atol=1e-4)


def test_the_servos_carry_the_arm() -> None:
  model, data = grasping("full")
  home = data.qpos.copy()
  mujoco.mj_step(model, data, nstep=600)
  assert np.abs(data.qvel).max() < 1e-3
  # They are soft (2 Hz) and do not compensate the weight of the arm.
  assert np.abs(data.qpos - home).max() < 0.25
