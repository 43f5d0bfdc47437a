"""The numbers of the tasks, by joints and by the hand."""

from importlib.metadata import entry_points
from typing import Any

import numpy as np
import pytest
import torch
from manipulation_worlds import lift, place
from mjlab_envs import mdp
from mjlab_manipulation import lift_cube, lift_cube_env, lift_cube_ik, lift_cube_ik_env, lift_objects_env
from mjlab_manipulation.arm import ACTION_SCALE, ARM, JOINT_RANGE
from mjlab_manipulation.lift import COMMAND
from mjlab_robots import YAM_ACTION_SCALE

TASKS: dict[str, Any] = {"Mjlab-Lift-Cube-Yam": lift_cube, "Mjlab-Lift-Cube-Yam-IK": lift_cube_ik}
each_task = pytest.mark.parametrize("name", TASKS)


@each_task
def test_the_task_is_found_under_its_name(name: str) -> None:
  (entry,) = entry_points(group="mjlab.tasks", name=name)
  assert entry.load()().env == TASKS[name]().env


@each_task
def test_a_task_has_the_numbers_of_its_table(name: str) -> None:
  task = TASKS[name]()
  cfg, sim, agent = task.env, task.env.sim, task.agent
  assert (cfg.decimation, sim.timestep, cfg.episode_length_s) == (4, 0.005, 20.0)
  assert (sim.iterations, sim.ls_iterations, sim.cone, sim.impratio) == (10, 20, "elliptic", 10.0)
  assert (sim.nconmax, sim.njmax, cfg.scene.env_spacing) == ("auto", "auto", 1.0)
  weights = {"lift": 1.0, "lift_precise": 1.0, "action_rate_l2": -0.01, "joint_pos_limits": -10.0}
  assert {name: term.weight for name, term in cfg.rewards.items()} == {**weights, "joint_vel_hinge": -0.01}
  assert cfg.commands[COMMAND].goal_time_range == (8.0, 12.0)
  assert {name for name, term in cfg.terminations.items() if term.time_out} == {"time_out", "goal_over"}
  assert agent.actor.hidden_dims == agent.critic.hidden_dims == (512, 256, 128)
  assert (agent.algorithm.entropy_coef, agent.max_iterations, agent.save_interval) == (0.005, 5000, 100)
  noise = {name: term.noise for name, term in cfg.observations["actor"].terms.items() if term.noise is not None}
  sizes = {"joint_pos": 0.01, "joint_vel": 1.5, "ee_to_cube": 0.01, "cube_to_goal": 0.01}
  assert {name: (-term.n_min, term.n_max) for name, term in noise.items()} == {n: (s, s) for n, s in sizes.items()}
  assert (cfg.observations["actor"].corrupt, cfg.observations["critic"].corrupt) == (True, False)


@pytest.mark.parametrize("make", [lift_cube_env, lift_cube_ik_env], ids=["joints", "hand"])
def test_observations_and_actions_are_as_wide_as_the_table_says(make: Any) -> None:
  env, _ = lift(2, make)
  observations: Any = env.get_observations()
  assert {group: values.shape for group, values in observations.items()} == {"actor": (2, 29), "critic": (2, 29)}
  assert env.action_manager.total_action_dim == 7


def test_the_play_config_has_no_noise_and_a_goal_every_four_seconds() -> None:
  task: Any = lift_cube()
  cfg = task.play(task.env)
  assert not any(group.corrupt for group in cfg.observations.values() if group is not None)
  assert cfg.episode_length_s == 1e9
  assert not cfg.curriculum
  env, term = lift(2, lambda: cfg)
  assert term.goal_time.tolist() == [4.0, 4.0]
  assert env.max_episode_length == pytest.approx(5e10)


def test_one_unit_of_action_is_a_quarter_of_the_effort_but_never_more_than_half_the_range() -> None:
  env, _ = lift(1)
  model = env.sim.mj_model
  for joint, (low, high) in JOINT_RANGE.items():
    assert model.joint(f"robot/{joint}").range.tolist() == [low, high]
    assert ACTION_SCALE[joint] == min(YAM_ACTION_SCALE[joint], 0.5 * (high - low))
  limited = {joint for joint in JOINT_RANGE if ACTION_SCALE[joint] < YAM_ACTION_SCALE[joint]}
  assert limited == {"joint5", "joint6", "left_finger"}


def test_targets_stay_within_the_range_of_each_joint() -> None:
  env, _ = lift(4)
  env.step(100.0 * torch.tensor([[1.0], [-1.0], [0.5], [-0.5]]).expand(4, 7))
  targets = env.scene["robot"].data.joint_pos_target[:, :7].numpy()
  bounds = np.array(list(JOINT_RANGE.values()))
  np.testing.assert_allclose(targets[0], bounds[:, 1])
  np.testing.assert_allclose(targets[1], bounds[:, 0])


def test_one_world_draws_one_friction_for_all_its_finger_tips() -> None:
  env, _ = lift(8)
  model = env.sim.mj_model
  tips = [i for i in range(model.ngeom) if model.geom_condim[i] == 6]
  friction = env.sim.model.geom_friction[:, tips].numpy()
  assert len(tips) == 12
  assert np.ptp(friction, axis=1).max() == 0.0
  assert (np.ptp(friction, axis=0)[0] > [0.3, 1e-4, 1e-6]).all()
  for axis, (low, high) in enumerate([(0.3, 1.5), (1e-4, 2e-2), (1e-5, 5e-3)]):
    assert low <= friction[..., axis].min() <= friction[..., axis].max() <= high


@pytest.mark.parametrize("make", [lift_cube_env, lift_cube_ik_env], ids=["joints", "hand"])
def test_an_arm_without_actions_lasts_until_the_end_of_its_goal(make: Any) -> None:
  env, _ = lift(4, make, goal_time_range=(3.0, 3.0))
  for step in range(150):
    _, _, terminated, truncated, _ = env.step(torch.zeros(4, 7))
    assert not terminated.any()
    assert truncated.all() == (step == 149)


def test_inverse_kinematics_gets_from_any_pose_to_one_near_it() -> None:
  """From 1,000 poses within the limits, to a pose of the arm that is up to 0.2 rad away in every joint."""
  env, _ = lift(1000, lift_cube_ik_env)
  robot, term = env.scene["robot"], env.action_manager.get_term("hand")
  assert isinstance(term, mdp.DifferentialIKAction)
  rng = np.random.default_rng(3)
  low, high = robot.data.soft_joint_pos_limits[0, :6].T.numpy()
  start = rng.uniform(low, high, (1000, 6))
  near = (start + rng.uniform(-0.2, 0.2, (1000, 6))).clip(low, high)

  def put(position: np.ndarray) -> None:
    at_rest = torch.zeros(1000, 6, dtype=torch.float64)
    robot.write_joint_state(torch.from_numpy(position), at_rest, joint_ids=slice(0, 6))

  put(near)
  pos, quat = (value.clone() for value in term.frame_pose())
  put(start)
  term.goal_pos_w.copy_(pos)
  term.goal_quat_w.copy_(quat)
  can = np.array([JOINT_RANGE[joint] for joint in ARM]).T
  for _ in range(60):
    # Targets stay within the range of the joints.
    put((robot.data.joint_pos[:, :6].numpy() + term.solve().numpy()).clip(*can))
  reached_pos, reached_quat = term.frame_pose()
  error = torch.linalg.vector_norm(reached_pos - pos, dim=-1)
  angle = 2.0 * torch.acos((reached_quat * quat).sum(-1).abs().clamp(max=1.0))
  assert error.max() < 1e-3
  assert angle.max() < 1e-2
  assert term.target_names == list(ARM)


@pytest.mark.warp
@pytest.mark.slow
def test_both_engines_play_alike() -> None:
  seen: list[tuple[np.ndarray, np.ndarray]] = []
  for engine in ("native", "warp"):
    cfg = lift_objects_env()
    cfg.actions = lift_cube_ik_env().actions
    cfg.sim.engine = engine
    env, term = lift(4, lambda cfg=cfg: cfg)
    # Engines draw in their own precision, so not the same.
    term.command.copy_(torch.tensor([[0.4, 0.1, 0.3], [0.3, -0.1, 0.2], [0.5, 0.0, 0.4], [0.4, 0.2, 0.2]]))
    place(
      env, np.array([[0.3, 0.0, 0.03], [0.25, 0.1, 0.02], [0.4, -0.1, 0.05], [0.35, 0.05, 0.02]]), term.cfg.objects[0]
    )
    generator = torch.Generator().manual_seed(0)
    rewards = [env.step(0.3 * torch.randn(4, 7, generator=generator))[1].numpy() for _ in range(8)]
    critic: Any = env.get_observations()["critic"]
    seen.append((critic.numpy(), np.array(rewards)))
    env.close()
  for one, other in zip(*seen, strict=True):
    np.testing.assert_allclose(one, other, atol=2e-3)
