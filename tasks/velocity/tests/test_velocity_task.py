"""The numbers of the flat Go1 task: of the model, the terms, the learner, and what watching changes."""

import math
from importlib.metadata import entry_points
from itertools import pairwise

import mujoco
import numpy as np
import pytest
import torch
from mjlab_envs import ManagerBasedRlEnv, mdp
from mjlab_velocity import go1_flat
from mjlab_velocity.mdp import UniformVelocityCommandCfg
from velocity_oracle import ACTION_SCALE, JOINTS
from velocity_rollout import make_env

WEIGHTS = {
  "track_linear_velocity": 2.0,
  "track_angular_velocity": 2.0,
  "upright": 1.0,
  "pose": 1.0,
  "body_ang_vel": 0.0,
  "angular_momentum": 0.0,
  "dof_pos_limits": -1.0,
  "action_rate_l2": -0.1,
  "air_time": 0.0,
  "foot_clearance": -2.0,
  "foot_swing_height": -0.25,
  "foot_slip": -0.1,
  "soft_landing": -1e-5,
}
ACTOR = {
  "base_lin_vel": 3,
  "base_ang_vel": 3,
  "projected_gravity": 3,
  "joint_pos": 12,
  "joint_vel": 12,
  "actions": 12,
  "command": 3,
}
CRITIC = ACTOR | {"foot_height": 4, "foot_air_time": 4, "foot_contact": 4, "foot_contact_forces": 12}


@pytest.fixture(scope="module")
def env() -> ManagerBasedRlEnv:
  return make_env(2)


def test_the_task_is_found_under_its_name() -> None:
  (entry,) = entry_points(group="mjlab.tasks", name="Mjlab-Velocity-Flat-Unitree-Go1")
  task = entry.load()()
  assert task.env == go1_flat().env


def test_a_task_that_somebody_changes_stays_as_it_is_for_others() -> None:
  task = go1_flat()
  task.env.rewards.clear()
  task.env.observations.clear()
  task.agent.max_iterations = 1
  assert list(go1_flat().env.rewards) == list(WEIGHTS)
  assert go1_flat().agent.max_iterations == 10_000


def test_observations_are_those_of_the_table_in_its_order(env: ManagerBasedRlEnv) -> None:
  observations, _ = env.reset()
  for group, terms, size in (("actor", ACTOR, 48), ("critic", CRITIC, 72)):
    layout = env.observation_manager.layout(group)
    assert {term.name: term.shape[0] for term in layout} == terms
    assert [term.name for term in layout] == list(terms)
    observation = observations[group]
    assert isinstance(observation, torch.Tensor)
    assert (observation.shape, observation.dtype) == ((2, size), torch.float32)


def test_rewards_have_the_weights_of_the_table(env: ManagerBasedRlEnv) -> None:
  terms = env.reward_manager.active_terms
  assert {name: env.reward_manager.get_term_cfg(name).weight for name in terms} == WEIGHTS


def test_time_and_solver_are_those_of_the_table(env: ManagerBasedRlEnv) -> None:
  assert (env.physics_dt, env.step_dt, env.max_episode_length) == (0.005, 0.02, 1000)
  option = env.sim.mj_model.opt
  assert (option.iterations, option.ls_iterations, option.ccd_iterations, option.impratio) == (10, 20, 50, 10.0)
  assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
  assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
  assert option.solver == mujoco.mjtSolver.mjSOL_NEWTON
  assert (option.tolerance, option.ls_tolerance) == (1e-8, 0.01)
  assert option.gravity.tolist() == [0.0, 0.0, -9.81]
  assert env.sim.mj_model.stat.extent == 2.0
  assert (env.cfg.sim.njmax, env.cfg.sim.nconmax) == (128, 16)


def test_actions_are_joint_set_points_leg_by_leg(env: ManagerBasedRlEnv) -> None:
  term = env.action_manager.get_term("joint_pos")
  assert isinstance(term, mdp.JointPositionAction)
  assert tuple(term.joint_names) == JOINTS
  np.testing.assert_allclose(term.scale[0].numpy(), ACTION_SCALE, rtol=1e-9)


def test_watching_changes_five_things_and_nothing_else() -> None:
  task = go1_flat()
  assert task.play is not None
  cfg, trained = task.play(task.env), go1_flat().env
  actor, twist = cfg.observations["actor"], cfg.commands["twist"]
  assert actor is not None
  assert isinstance(twist, UniformVelocityCommandCfg)
  assert cfg.episode_length_s == 1e9
  assert not actor.corrupt
  assert cfg.events["push_robot"] is None
  assert not cfg.curriculum
  ranges = twist.ranges
  assert (ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z) == ((-1.5, 2.0), (-1.0, 1.0), (-0.7, 0.7))
  assert ranges.heading == (-math.pi, math.pi)

  cfg.episode_length_s = 20.0
  actor.corrupt = True
  cfg.events["push_robot"] = trained.events["push_robot"]
  cfg.curriculum = trained.curriculum
  cfg.commands = trained.commands
  assert cfg == trained


def test_who_watches_sees_without_noise_and_is_never_pushed_nor_timed_out() -> None:
  task = go1_flat()
  assert task.play is not None
  task.env.scene.num_envs = 4
  cfg = task.play(task.env)
  env = ManagerBasedRlEnv(cfg, device="cpu")
  env.reset()
  env.episode_length_buf.fill_(10**9)
  pushed = 0
  for _ in range(160):
    observations, _, terminated, truncated, _ = env.step(torch.zeros(4, 12))
    actor, critic = observations["actor"], observations["critic"]
    assert isinstance(actor, torch.Tensor)
    assert isinstance(critic, torch.Tensor)
    bias = env.scene["robot"].data.encoder_bias.float()
    torch.testing.assert_close(actor[:, 9:21], critic[:, 9:21] + bias)
    assert torch.equal(actor[:, :9], critic[:, :9])
    assert torch.equal(actor[:, 21:], critic[:, 21:48])
    assert not (terminated | truncated).any()
    pushed += int(env.sim.data.qvel[:, :2].abs().max() > 0.3)
  assert not pushed


def test_the_learner_is_that_of_the_table() -> None:
  agent = go1_flat().agent
  for model in (agent.actor, agent.critic):
    assert model.hidden_dims == (512, 256, 128)
    assert model.activation == "elu"
    assert model.obs_normalization
  assert agent.actor.distribution_cfg == {
    "class_name": "GaussianDistribution",
    "init_std": 1.0,
    "std_type": "scalar",
  }
  assert agent.critic.distribution_cfg is None
  expected = {
    "num_learning_epochs": 5,
    "num_mini_batches": 4,
    "learning_rate": 1e-3,
    "schedule": "adaptive",
    "clip_param": 0.2,
    "use_clipped_value_loss": True,
    "value_loss_coef": 1.0,
    "entropy_coef": 0.01,
    "gamma": 0.99,
    "lam": 0.95,
    "desired_kl": 0.01,
    "max_grad_norm": 1.0,
    "normalize_advantage_per_mini_batch": False,
  }
  assert {name: getattr(agent.algorithm, name) for name in expected} == expected
  assert (agent.num_steps_per_env, agent.max_iterations, agent.save_interval) == (24, 10_000, 50)
  assert (agent.experiment_name, agent.seed, agent.clip_actions) == ("go1_velocity", 42, None)


@pytest.mark.parametrize(("sizes", "parameters"), [((48, 12), 190_860), ((72, 1), 201_729)])
def test_networks_have_as_many_parameters_as_the_published_ones(sizes: tuple[int, int], parameters: int) -> None:
  widths = [sizes[0], *go1_flat().agent.actor.hidden_dims, sizes[1]]
  assert sum((a + 1) * b for a, b in pairwise(widths)) == parameters
