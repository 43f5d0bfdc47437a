"""What differs between worlds: friction, encoders, centre of mass."""

from typing import Any

import numpy as np
import pytest
import torch
from mjlab_envs import ManagerBasedRlEnv
from scipy import stats
from velocity_facts import TASKS, Robot
from velocity_rollout import started_env


@pytest.fixture(scope="module", params=[name for name in TASKS if "Flat" in name])
def task(request: pytest.FixtureRequest) -> str:
  return request.param


@pytest.fixture(scope="module")
def robot(task: str) -> Robot:
  return TASKS[task].robot


@pytest.fixture(scope="module")
def env(task: str) -> ManagerBasedRlEnv:
  return started_env(128, task=task)


def feet_friction(env: ManagerBasedRlEnv, robot: Robot) -> np.ndarray:
  """Friction of the feet, (worlds, geoms of feet, 3)."""
  geoms = [env.sim.mj_model.geom(f"robot/{name}").id for foot in robot.foot_geoms for name in foot]
  return env.sim.model.geom_friction.double().numpy()[:, geoms]


def com_offset(env: ManagerBasedRlEnv, robot: Robot) -> np.ndarray:
  """Shift of the torso's centre of mass, (worlds, 3) [m]."""
  trunk = env.sim.mj_model.body(f"robot/{robot.torso}").id
  return env.sim.model.body_ipos.double().numpy()[:, trunk] - env.sim.mj_model.body_ipos[trunk]


def is_uniform(values: np.ndarray, lo: float, hi: float) -> bool:
  return (
    lo <= values.min() and values.max() <= hi and stats.kstest(values, stats.uniform(lo, hi - lo).cdf).pvalue > 1e-3
  )


def test_all_feet_of_a_world_share_their_friction_and_worlds_differ(env: ManagerBasedRlEnv, robot: Robot) -> None:
  friction = feet_friction(env, robot)
  assert (friction == friction[:, :1]).all()
  for axis in range(1 if robot.root == "pelvis" else 3):
    assert len(np.unique(friction[:, 0, axis])) == env.num_envs


def test_sliding_friction_is_uniform_torsional_and_rolling_log_uniform(env: ManagerBasedRlEnv, robot: Robot) -> None:
  slide, spin, roll = feet_friction(env, robot)[:, 0].T
  assert is_uniform(slide, *robot.friction)
  if robot.root == "pelvis":
    # Its feet have no friction but sliding friction.
    assert (spin == spin[0]).all()
    assert (roll == roll[0]).all()
    return
  assert is_uniform(np.log(spin), np.log(1e-4), np.log(2e-2))
  assert is_uniform(np.log(roll), np.log(1e-5), np.log(5e-3))
  assert abs(np.corrcoef([slide, spin, roll]) - np.eye(3)).max() < 0.3


def test_only_the_feet_change_their_friction(env: ManagerBasedRlEnv, robot: Robot) -> None:
  feet = {f"robot/{name}" for foot in robot.foot_geoms for name in foot}
  geoms = [g for g in range(env.sim.mj_model.ngeom) if env.sim.mj_model.geom(g).name not in feet]
  friction = env.sim.model.geom_friction.double().numpy()[:, geoms]
  assert (friction == env.sim.mj_model.geom_friction[geoms]).all()


def test_every_joint_of_every_world_has_its_own_encoder_bias(env: ManagerBasedRlEnv, robot: Robot) -> None:
  bias = env.scene["robot"].data.encoder_bias.double().numpy()
  assert bias.shape == (env.num_envs, len(robot.joints))
  assert len(np.unique(bias)) == bias.size
  assert is_uniform(bias.ravel(), -0.015, 0.015)


def test_only_the_actor_sees_the_encoder_bias_and_its_targets_are_corrected_by_it(task: str, robot: Robot) -> None:
  observed = TASKS[task].make().env.observations
  actor: Any = observed["actor"]
  actor.corrupt = False
  quiet = started_env(8, task=task, observations=observed)
  action = torch.randn(8, len(robot.joints), generator=torch.Generator().manual_seed(0))
  observations = quiet.step(action)[0]
  bias = quiet.scene["robot"].data.encoder_bias.double().numpy()
  seen: dict[str, np.ndarray] = {}
  for group in ("actor", "critic"):
    columns = {term.name: term.columns for term in quiet.observation_manager.layout(group)}
    observation: Any = observations[group]
    seen[group] = observation.double().numpy()[:, columns["joint_pos"]]
  np.testing.assert_allclose(seen["actor"] - seen["critic"], bias, atol=1e-6)
  model = quiet.sim.mj_model
  driven = [model.joint(int(joint)).name.removeprefix("robot/") for joint in model.actuator_trnid[:, 0]]
  target = robot.default + robot.action_scale * action.double().numpy() - bias
  np.testing.assert_allclose(
    quiet.sim.data.ctrl.double().numpy(), target[:, [robot.joints.index(name) for name in driven]], atol=1e-6
  )


def test_the_centre_of_mass_of_the_torso_alone_moves_within_its_box(env: ManagerBasedRlEnv, robot: Robot) -> None:
  offset = com_offset(env, robot)
  for axis, limit in enumerate((0.025, 0.025, 0.03)):
    assert is_uniform(offset[:, axis], -limit - 1e-12, limit + 1e-12)
  trunk = env.sim.mj_model.body(f"robot/{robot.torso}").id
  others = [body for body in range(env.sim.mj_model.nbody) if body != trunk]
  assert (env.sim.model.body_ipos.double().numpy()[:, others] == env.sim.mj_model.body_ipos[others]).all()
  for field in ("body_mass", "body_inertia", "body_iquat"):
    assert (getattr(env.sim.model, field).double().numpy() == getattr(env.sim.mj_model, field)).all()


def test_a_world_keeps_its_body_through_all_episodes(env: ManagerBasedRlEnv, robot: Robot) -> None:
  def body() -> list[np.ndarray]:
    bias = env.scene["robot"].data.encoder_bias.double().numpy().copy()
    return [feet_friction(env, robot), com_offset(env, robot), bias]

  before = body()
  env.reset()
  env.episode_length_buf.fill_(999)
  env.step(torch.zeros(env.num_envs, len(robot.joints)))
  assert all(np.array_equal(a, b) for a, b in zip(before, body(), strict=True))
