"""Writes: the whole batch in, masked worlds written, everything else bit-identical."""

from typing import Any

import pytest
import torch
from mjlab_actuators import IdealPdActuatorCfg, NativePositionActuatorCfg
from mjlab_scene import EntityArticulationCfg, InitialStateCfg
from mjlab_sim import Simulation
from scene_models import MakeWorlds, entity

FLOATING = """
<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 1">
      <freejoint/>
      <geom size=".1" pos=".2 .1 0"/>
      <body name="arm"><joint name="a"/><geom size=".1"/></body>
      <body name="ball"><joint name="b" type="ball"/><geom size=".1"/></body>
      <body name="rail"><joint name="c" type="slide"/><geom size=".1"/></body>
    </body>
  </worldbody>
</mujoco>
"""
FIXED = """
<mujoco><worldbody><body name="post" pos="0 0 .3"><joint name="h" range="-1 1"/><geom size=".1"/>
  <body><joint name="k"/><geom size=".1"/></body></body></worldbody>
  <compiler angle="radian"/></mujoco>
"""
MASK = torch.tensor([False, True, False])


def random(*shape: int) -> torch.Tensor:
  return torch.randn(shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)


def snapshot(sim: Simulation) -> list[torch.Tensor]:
  names = ("qpos", "qvel", "mocap_pos", "mocap_quat", "xfrc_applied", "ctrl")
  return [getattr(sim.data, name).clone() for name in names]


def test_writes_touch_only_masked_worlds(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(3, robot=FLOATING, arm=FIXED)
  robot, arm = scene["robot"], scene["arm"]
  before = snapshot(sim)
  robot.write_root_state(random(3, 13), MASK)
  robot.write_joint_state(random(3, 6), random(3, 5), MASK)
  robot.write_joint_velocity(random(3, 2), MASK, joint_ids=[2, 0])
  robot.write_external_wrench(random(3, 4, 3), random(3, 4, 3), mask=MASK)
  arm.write_root_pose(random(3, 7), MASK)
  after = snapshot(sim)
  for old, new in zip(before, after, strict=True):
    assert torch.equal(old[~MASK], new[~MASK])
  assert all(not torch.equal(old[MASK], new[MASK]) for old, new in list(zip(before, after, strict=True))[:5])


def test_root_state_reads_back_as_written(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(3, robot=FLOATING)
  robot, state = scene["robot"], random(3, 13)
  robot.write_root_state(state)
  quat = state[:, 3:7] / state[:, 3:7].norm(dim=-1, keepdim=True)
  data = robot.data
  torch.testing.assert_close(data.root_link_pose_w, torch.cat((state[:, :3], quat), -1))
  torch.testing.assert_close(data.root_link_vel_w, state[:, 7:])


def test_velocities_in_the_link_frame_and_at_the_mass_centre_read_back_as_written(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(3, robot=FLOATING)
  robot, velocity = scene["robot"], random(3, 6)
  robot.write_root_pose(random(3, 7))
  robot.write_root_com_velocity(velocity)
  torch.testing.assert_close(robot.data.root_com_vel_w, velocity)
  robot.write_root_velocity_b(velocity)
  torch.testing.assert_close(torch.cat((robot.data.root_link_lin_vel_b, robot.data.root_link_ang_vel_b), -1), velocity)


def test_values_of_single_precision_are_written_as_they_are(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(3, robot=FLOATING)
  robot = scene["robot"]
  root, joints, wrench = random(3, 13).float(), (random(3, 6).float(), random(3, 5).float()), random(3, 4, 3).float()

  def written(dtype: torch.dtype) -> list[torch.Tensor]:
    robot.write_root_state(root.to(dtype))
    robot.write_joint_state(*(values.to(dtype) for values in joints))
    robot.write_external_wrench(wrench.to(dtype), wrench.to(dtype))
    states = snapshot(sim)
    for write in (robot.write_root_velocity_b, robot.write_root_com_velocity):
      write(root[:, 7:].to(dtype))
      states.append(sim.data.qvel.clone())
    return states

  for single, double in zip(written(torch.float32), written(torch.float64), strict=True):
    torch.testing.assert_close(single, double, atol=1e-6, rtol=1e-6)


def test_one_torque_serves_the_forces_of_all_worlds(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(3, robot=FLOATING)
  forces, torques = random(3, 4, 3), random(1, 4, 3)
  scene["robot"].write_external_wrench(forces, torques, mask=MASK)
  assert torch.equal(scene["robot"].data.body_external_wrench[1], torch.cat((forces[1], torques[0]), -1))
  assert sim.data.xfrc_applied[~MASK].eq(0).all()


def test_quaternions_are_normalised_on_write_and_a_zero_one_is_the_identity(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(3, robot=FLOATING, arm=FIXED)
  pose = torch.tensor([[0, 0, 0, 0, 0, 0, 2], [0, 0, 0, 0, 0, 0, 0], [0, 0, 0, 3, 0, 0, 0]], dtype=torch.float64)
  expected = [[0, 0, 0, 1], [1, 0, 0, 0], [1, 0, 0, 0]]
  for name in ("robot", "arm"):
    scene[name].write_root_pose(pose)
    assert scene[name].data.root_link_quat_w.tolist() == expected
  joints = scene["robot"].data.joint_pos.clone()
  joints[:, 1:5] = pose[:, 3:]
  scene["robot"].write_joint_position(joints)
  assert scene["robot"].data.joint_pos[:, 1:5].tolist() == expected


def test_default_state_of_ball_hinge_and_slide_joints_round_trips(make_worlds: MakeWorlds) -> None:
  start = InitialStateCfg(joint_pos={"a": 0.1, "b": (0.0, 1.0, 0.0, 0.0), "c": 0.3}, joint_vel={"b": (1.0, 2.0, 3.0)})
  scene, sim = make_worlds(3, robot=entity(FLOATING, init_state=start))
  data = scene["robot"].data
  sim.data.qpos.add_(0.4)
  scene.write_default_state()
  assert data.joint_pos.tolist() == [[0.1, 0.0, 1.0, 0.0, 0.0, 0.3]] * 3
  assert data.joint_vel.tolist() == [[0.0, 1.0, 2.0, 3.0, 0.0]] * 3
  assert torch.equal(data.joint_pos_biased, data.joint_pos)
  data.encoder_bias.fill_(0.01)
  assert torch.equal(data.joint_pos_biased, data.joint_pos + 0.01)


@pytest.mark.parametrize("wrong", [[False, True], torch.tensor([False, True]), [0.0, 1.0], torch.ones(2)], ids=str)
def test_ids_that_are_no_whole_numbers_are_refused(make_worlds: MakeWorlds, wrong) -> None:
  scene, _ = make_worlds(3, robot=FLOATING)
  scene["robot"].write_joint_position(random(3, 5), joint_ids=[0, 1])
  with pytest.raises(ValueError, match="entity 'robot': joint position: ids must be a whole number"):
    scene["robot"].write_joint_position(random(3, 5), joint_ids=wrong)


def test_ids_count_as_they_are_now_and_are_not_kept(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(3, robot=FLOATING)
  robot, ids = scene["robot"], torch.tensor([0])
  robot.write_joint_velocity(torch.ones(3, 1), joint_ids=ids)
  ids.fill_(2)
  views = robot._columns["joint velocity"]._views
  kept = len(views)
  for _ in range(9):
    robot.write_joint_velocity(torch.full((3, 1), 5.0), joint_ids=ids.clone())
  robot.write_joint_velocity(torch.full((3, 1), 7.0), joint_ids=ids)
  assert robot.data.joint_vel[0].tolist() == [1.0, 0.0, 0.0, 0.0, 7.0]
  assert len(views) == kept + 1


@pytest.mark.parametrize("selection", [slice(1, 3), [2, 0], torch.tensor([2, 1])], ids=["slice", "list", "tensor"])
def test_joint_ids_select_joints_of_any_width(make_worlds: MakeWorlds, selection) -> None:
  scene, _ = make_worlds(2, robot=FLOATING)
  robot = scene["robot"]
  ids = list(range(3))[selection] if isinstance(selection, slice) else [int(i) for i in selection]
  columns = [column for joint in ids for column in ([0], [1, 2, 3], [4])[joint]]
  velocity = random(2, len(columns))
  robot.write_joint_velocity(velocity, joint_ids=selection)
  robot.set_joint_velocity_target(velocity, joint_ids=selection)
  for tensor in (robot.data.joint_vel, robot.data.joint_vel_target):
    assert torch.equal(tensor[:, columns], velocity)
    assert tensor.count_nonzero() == velocity.numel()


def test_one_row_serves_all_worlds_and_any_other_batch_size_is_refused(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(3, robot=FLOATING)
  robot = scene["robot"]
  robot.write_joint_velocity(random(1, 5))
  assert (robot.data.joint_vel == random(1, 5)).all()
  for name, write, (rows, columns) in (
    ("root state", robot.write_root_state, (2, 13)),
    ("root pose", robot.write_root_pose, (3, 6)),
    ("root velocity", robot.write_root_velocity, (4, 6)),
    ("joint position", robot.write_joint_position, (3, 5)),
    ("joint position target", robot.set_joint_position_target, (2, 6)),
  ):
    with pytest.raises(ValueError, match=rf"entity 'robot': {name}: shape \({rows}, {columns}\)"):
      write(random(rows, columns))


def test_writes_of_missing_elements_are_refused(make_worlds: MakeWorlds) -> None:
  block = '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
  scene, _ = make_worlds(1, arm=FIXED, block=block)
  with pytest.raises(ValueError, match="does not float"):
    scene["arm"].write_root_velocity(random(1, 6))
  with pytest.raises(ValueError, match="has no joints"):
    scene["block"].write_joint_position(random(1, 1))
  with pytest.raises(ValueError, match=r"ids must be in \[-2, 1\]"):
    scene["arm"].write_joint_position(random(1, 1), joint_ids=[2])


def test_a_wrench_acts_at_the_mass_centre_of_the_chosen_body(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(2, robot=FLOATING.replace("<mujoco>", '<mujoco><option gravity="0 0 0"/>', 1))
  robot = scene["robot"]
  force = torch.tensor([[[0.0, 0.0, 3.0]]], dtype=torch.float64).expand(2, 1, 3)
  robot.write_external_wrench(force, torch.zeros_like(force), body_ids=[0], mask=torch.tensor([True, False]))
  assert robot.data.body_external_force[:, 0].tolist() == [[0, 0, 3], [0, 0, 0]]
  sim.step()
  assert robot.data.root_com_lin_vel_w[0, 2] > 0
  assert (robot.data.root_com_lin_vel_w[1] == 0).all()


def servo(**kwargs: Any) -> EntityArticulationCfg:
  return EntityArticulationCfg(
    actuators=(NativePositionActuatorCfg(target_names_expr=(".*",), stiffness=50.0, damping=1.0, **kwargs),)
  )


def test_targets_start_and_reset_at_the_default_pose(make_worlds: MakeWorlds) -> None:
  start = InitialStateCfg(joint_pos={"h": 0.5})
  scene, sim = make_worlds(3, arm=entity(FIXED, init_state=start, articulation=servo()))
  arm = scene["arm"]
  assert arm.data.joint_pos_target.tolist() == [[0.5, 0.0]] * 3
  arm.set_joint_position_target(random(3, 2))
  arm.reset(MASK)
  assert arm.data.joint_pos_target[1].tolist() == [0.5, 0.0]
  assert torch.equal(arm.data.joint_pos_target[~MASK], random(3, 2)[~MASK])
  scene.write_ctrl()
  assert torch.equal(sim.data.ctrl, arm.data.joint_pos_target)


def test_a_delayed_robot_holds_its_default_pose_after_a_reset(make_worlds: MakeWorlds) -> None:
  start = InitialStateCfg(joint_pos={"h": 0.5})
  scene, sim = make_worlds(2, arm=entity(FIXED, init_state=start, articulation=servo(delay_min_lag=2, delay_max_lag=2)))
  arm = scene["arm"]
  arm.set_joint_position_target(torch.full((2, 2), 0.9, dtype=torch.float64))
  seen = []
  for _ in range(4):
    scene.write_ctrl()
    seen.append(sim.data.ctrl[0, 0].item())
    sim.step()
  assert seen == [0.5, 0.5, 0.9, 0.9]


def test_controls_are_written_once_while_no_target_changes_and_again_after_a_reset(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(2, arm=entity(FIXED, articulation=servo()))
  scene["arm"].set_joint_position_target(random(2, 2))
  scene.write_ctrl()
  version = sim.data.ctrl._version
  scene.write_ctrl()
  assert sim.data.ctrl._version == version
  mask = torch.tensor([True, False])
  sim.reset(mask)
  scene.reset(mask)
  scene.write_ctrl()
  assert torch.equal(sim.data.ctrl[0], torch.zeros(2, dtype=torch.float64))
  assert torch.equal(sim.data.ctrl[1], random(2, 2)[1])


def test_actuator_models_with_feedback_are_computed_in_every_substep(make_worlds: MakeWorlds) -> None:
  pd = IdealPdActuatorCfg(target_names_expr=(".*",), stiffness=10.0, damping=0.0, effort_limit=100.0)
  scene, sim = make_worlds(2, arm=entity(FIXED, articulation=EntityArticulationCfg(actuators=(pd,))))
  arm = scene["arm"]
  arm.set_joint_position_target(random(2, 2))
  for _ in range(3):
    scene.write_ctrl()
    torch.testing.assert_close(sim.data.ctrl.clone(), 10.0 * (random(2, 2) - arm.data.joint_pos))
    sim.step()


def test_actuators_drive_the_scalar_joints_of_a_robot_with_a_ball_joint(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(1, robot=entity(FLOATING, articulation=servo()))
  scene["robot"].set_joint_position_target(torch.tensor([[0.1, 1.0, 0, 0, 0, 0.3]], dtype=torch.float64))
  scene.write_ctrl()
  assert sim.data.ctrl.tolist() == [[0.1, 0.3]]


def test_actuators_without_a_config_keep_the_controls_that_are_set(make_worlds: MakeWorlds) -> None:
  text = FIXED.replace("</mujoco>", '<actuator><motor joint="h"/></actuator></mujoco>')
  scene, sim = make_worlds(2, arm=text)
  scene["arm"].set_ctrl(torch.tensor([[2.0], [3.0]], dtype=torch.float64), mask=torch.tensor([False, True]))
  scene.write_ctrl()
  assert sim.data.ctrl.tolist() == [[0.0], [3.0]]
