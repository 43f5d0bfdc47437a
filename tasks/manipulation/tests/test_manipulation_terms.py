"""Rewards, observations and stages against NumPy on chosen states."""

from typing import Any

import numpy as np
import pytest
import torch
from manipulation_worlds import in_mujoco, lift, metric, place
from mjlab_envs import ManagerBasedRlEnv
from mjlab_manipulation import mdp as lifting
from mjlab_manipulation.lift import COMMAND, DECIMATION, HOLD, PHYSICS_DT, hand

STEP = DECIMATION * PHYSICS_DT


def scatter(env: ManagerBasedRlEnv, seed: int) -> None:
  """Arms in different poses, and cubes around the hands."""
  rng = np.random.default_rng(seed)
  robot = env.scene["robot"]
  limits = robot.data.joint_pos_limits[0].numpy()
  share = rng.uniform(-0.1, 1.1, (env.num_envs, 8))
  position = torch.from_numpy(limits[:, 0] + share * (limits[:, 1] - limits[:, 0]))
  robot.write_joint_state(position, torch.from_numpy(2.0 * rng.normal(size=(env.num_envs, 8))))
  hand = (robot.data.site_pos_w[:, 1] - env.scene.env_origins).numpy()
  place(env, hand + 0.15 * rng.normal(size=hand.shape))


def test_the_lift_rewards_grow_at_every_stage() -> None:
  env, term = lift(5)
  site = env.scene["robot"].data.site_pos_w[:, 1] - env.scene.env_origins
  term.command[:2] = 9.0
  term.command[2:] = site[2:]
  place(env, site.numpy() + np.array([[0.3], [0.0], [0.3], [0.05], [0.0]]) * [1.0, 0.0, 0.0])
  env.reward_manager.compute()
  # Far from everything; holding it far from the goal; at neither but nearer; 5 cm from both; holding it there.
  lift_, precise = env.reward_manager._values[:, :2].T
  near, far = np.exp(-((0.05 / np.array([0.2, 0.3])) ** 2)), np.exp(-((0.3 / np.array([0.2, 0.3])) ** 2))
  expected = [far[0], 1.0, far[0] * (1 + far[1]), near[0] * (1 + near[1]), 2.0]
  assert lift_.tolist() == pytest.approx(expected, rel=1e-5)
  assert precise.tolist() == pytest.approx([0.0, 0.0, np.exp(-36.0), np.exp(-1.0), 1.0], rel=1e-5, abs=1e-9)


def test_observations_are_ways_in_the_frame_of_the_root() -> None:
  env, term = lift(8)
  scatter(env, 1)
  turn = torch.tensor([[0.8, 0.0, 0.0, 0.6]], dtype=torch.float64)
  env.scene["robot"].write_root_pose(torch.cat([env.scene.env_origins, turn.expand(8, 4)], dim=-1))
  env.observation_manager.compute()
  critic: Any = env.get_observations()["critic"]
  for world in range(8):
    data = in_mujoco(env, world)
    root = data.body("robot/mocap_base").xmat.reshape(3, 3)
    cube, hand = data.body("cube/cube").xpos, data.site("robot/grasp_site").xpos
    goal = term.goal_pos_w[world].numpy()
    home = env.scene["robot"].data.default_joint_pos[0].numpy()
    expected = np.concatenate(
      [data.qpos[:8] - home, data.qvel[:8], root.T @ (cube - hand), root.T @ (goal - cube), np.zeros(7)]
    )
    np.testing.assert_allclose(critic[world].numpy(), expected, rtol=1e-5, atol=1e-6)


def test_the_goal_is_seen_from_the_hand() -> None:
  env, term = lift(4)
  scatter(env, 2)
  got = lifting.goal_in_hand(env, command=COMMAND, hand=hand().resolve(env.scene, env.device))
  for world in range(4):
    frame = in_mujoco(env, world).site("robot/grasp_site")
    expected = frame.xmat.reshape(3, 3).T @ (term.goal_pos_w[world].numpy() - frame.xpos)
    np.testing.assert_allclose(got[world].numpy(), expected, atol=1e-9)


def test_success_is_to_stay_at_the_goal_for_the_whole_time() -> None:
  env, term = lift(3)
  steps = round(HOLD / STEP)
  off = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.06, 0.0, 0.0]])
  for step in range(steps):
    goal = term.command.numpy()
    here = off.copy()
    # The second one leaves for a single step, just before it would have been enough.
    if step == steps - 2:
      here[1, 0] = 0.3
    place(env, goal + here)
    env.metrics_manager.compute()
    env.episode_length_buf += 1
    held = metric(env, "held").tolist()
    assert held == ([1.0, 0.0, 0.0] if step == steps - 1 else [0.0, 0.0, 0.0])
    at_goal = metric(env, "at_goal").tolist()
    assert at_goal == [1.0, float(step != steps - 2), 0.0]
  # As long in all, but not on end.
  for _ in range(steps - 2):
    env.metrics_manager.compute()
    assert metric(env, "held").tolist() == [1.0, 0.0, 0.0]
  place(env, term.command.numpy() + 0.5)
  for _ in range(7):
    env.metrics_manager.compute()
  # What was won stays won, and its time stands still.
  assert metric(env, "held").tolist() == [1.0, 0.0, 0.0]
  times = metric(env, "time_to_success").tolist()
  late = HOLD + (steps + 5) * STEP
  assert times == pytest.approx([HOLD, late, late])
  env.reset(env_ids=[0])
  assert env.drain_log()["Episode_Metrics/held"] == 1.0
  env.metrics_manager.compute()
  assert metric(env, "held")[0] == 0.0


def test_falls_from_high_up_are_counted() -> None:
  env, _ = lift(2)
  for height, falls in ((0.05, 0), (0.02, 0), (0.1, 0), (0.05, 0), (0.02, 1), (0.02, 1), (0.09, 1), (0.02, 2)):
    place(env, np.array([[0.3, 0.0, height], [0.3, 0.0, 0.1]]))
    env.metrics_manager.compute()
    assert metric(env, "dropped").tolist() == [falls, 0]
    assert metric(env, "lifted").tolist() == [float(height > 0.08), 1.0]


def test_fingers_around_the_cube_reach_touch_and_grasp_it() -> None:
  env, _ = lift(3)
  robot = env.scene["robot"]
  site = (robot.data.site_pos_w[:, 1] - env.scene.env_origins).numpy()
  # Between the tips; beside the left finger's; out of reach. The gripper is open by 37.5 mm, narrower than the cube.
  axis = robot.data.body_link_pos_w[:, robot.body_names.index("lf_down")]
  axis = (axis - robot.data.body_link_pos_w[:, robot.body_names.index("rf_down")]).numpy()
  axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
  where = site + np.array([[0.0], [0.038], [0.3]]) * axis
  state = torch.zeros(3, 13, dtype=torch.float64)
  state[:, :3] = env.scene.env_origins + torch.from_numpy(where)
  state[:, 3:7] = robot.data.site_quat_w[:, 1]
  env.scene["cube"].write_root_state(state)
  env.sim.step()
  env.metrics_manager.compute()
  assert metric(env, "reached").tolist() == [1.0, 1.0, 0.0]
  assert metric(env, "touched").tolist() == [1.0, 1.0, 0.0]
  assert metric(env, "grasped").tolist() == [1.0, 0.0, 0.0]


def test_the_weight_of_joint_speed_follows_its_stages() -> None:
  env, _ = lift(2)
  weights = []
  for counter in (0, 11_998, 11_999, 23_998, 23_999, 10**6):
    env.common_step_counter.fill_(counter)
    env.step(torch.zeros(2, 7))
    weights.append(env.drain_log()["Curriculum/joint_vel_hinge_weight/weight"])
  assert weights == pytest.approx([-0.01, -0.01, -0.1, -0.1, -1.0, -1.0])
