"""Every term of the tracking task against NumPy and MuJoCo C, under random actions and pushes."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import torch
from mjlab_core.names import match_values_full
from mjlab_envs import ManagerBasedRlEnv
from mjlab_managers import MetricsTermCfg
from mjlab_robots import G1_ACTION_SCALE
from mjlab_tracking.g1 import g1_flat_env
from tracking_env import command, make, still
from tracking_oracle import STEP, Reference, World, matrix

NOISE = {
  "motion_anchor_pos_b": 0.25,
  "motion_anchor_ori_b": 0.05,
  "base_lin_vel": 0.5,
  "base_ang_vel": 0.2,
  "joint_pos": 0.01,
  "joint_vel": 0.5,
}
OFFSET = np.array([0.05, 0.05, 0.01, 0.1, 0.1, 0.2])
"""Largest offsets of starts: x, y, z [m], roll, pitch, yaw [rad]."""
TWIST = np.array([0.5, 0.5, 0.2, 0.52, 0.52, 0.78])
"""Largest offsets of velocities, and largest pushes [m/s, rad/s]."""
_STATE: dict[str, np.ndarray] = {}


def note_state(env: ManagerBasedRlEnv) -> torch.Tensor:
  """Keep the state of the rewards, before resets and pushes."""
  term: Any = env.command_manager.get_term("motion")
  data = env.sim.data
  for name, value in {"qpos": data.qpos, "qvel": data.qvel, "clip": term.clip, "frame": term.frame}.items():
    _STATE[name] = value.double().numpy().copy()
  return torch.zeros(env.num_envs)


@dataclass(kw_only=True)
class Step:
  """One step of one world: values of the environment and of the oracle."""

  rewards: dict[str, tuple[float, float]]
  """By term, unweighted."""
  total: tuple[float, float]
  critic: dict[str, tuple[np.ndarray, np.ndarray]]
  actor: dict[str, tuple[np.ndarray, np.ndarray]]
  """Here the oracle's values have no noise."""
  failed: tuple[bool, bool]
  truncated: tuple[bool, bool]
  shadow: tuple[np.ndarray, np.ndarray]
  """Positions at the end of physics, ours and MuJoCo C's."""
  pushed: np.ndarray | None
  """Change of the root's velocity from the end of physics to the end of a step without reset, world frame, (6,)."""
  start: tuple[np.ndarray, np.ndarray] | None
  """After a reset: how far pose and velocity of the root and the joints are off the frame; and joint velocities."""


def roll(folder: Path, steps: int, num_envs: int = 8, engine: Literal["native", "warp"] = "native") -> list[Step]:
  cfg = g1_flat_env()
  cfg.scene.num_envs, cfg.seed, cfg.sim.engine = num_envs, 5, engine
  cfg.metrics["state"] = MetricsTermCfg(note_state)
  # Some episodes end by age, before the end of their clip.
  cfg.episode_length_s = 0.5
  command(cfg).motion = str(folder)
  # Pushes come before that.
  push: Any = cfg.events["push_robot"]
  push.interval_range_s = (0.1, 0.3)
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    observations, _ = env.reset()
    scale = np.array(match_values_full(G1_ACTION_SCALE, env.scene["robot"].joint_names, what="joint", owner="robot"))
    worlds = [World(env, world, scale) for world in range(num_envs)]
    clip_files = [Reference(folder / f"{name}.npz", env.sim.mj_model) for name in ("a_squat", "b_march")]
    actions = [[np.zeros(29), np.zeros(29)] for _ in worlds]
    ages = np.zeros(num_envs, dtype=int)
    generator = torch.Generator().manual_seed(1)
    loudness = torch.tensor([0.1, 0.5, 1.0, 2.5]).repeat(num_envs // 4)[:, None]
    action = torch.zeros(num_envs, 29)
    seen: list[Step] = []
    term: Any = env.command_manager.get_term("motion")
    names = list(env.reward_manager.active_terms)
    weights = np.array([env.reward_manager.get_term_cfg(name).weight for name in names])
    for k in range(steps):
      if k % 3 == 0:
        action = torch.randn(num_envs, 29, generator=generator) * loudness
      data = env.sim.data
      qpos, qvel, warmstart = (v.double().numpy().copy() for v in (data.qpos, data.qvel, data.qacc_warmstart))
      observations, reward, terminated, truncated, _ = env.step(action)
      ages += 1
      values = env.reward_manager.step_reward.double().numpy()
      after = [v.double().numpy().copy() for v in (data.qpos, data.qvel)]
      terms = {group: _by_term(env, group, observations) for group in ("actor", "critic")}
      for w, world in enumerate(worlds):
        actions[w].append(action[w].double().numpy())
        collisions = world.simulate(qpos[w], qvel[w], warmstart[w], actions[w][-1])
        shadow = world.data.qpos.copy()
        clip, frame = clip_files[int(_STATE["clip"][w])], int(_STATE["frame"][w])
        robot = world.look(_STATE["qpos"][w], _STATE["qvel"][w])
        expected = world.rewards(robot, clip.bodies[frame], actions[w], collisions)
        failed = any(world.failures(robot, clip.bodies[frame]).values())
        # Both may hold; the learner gets the failure.
        over = bool(ages[w] >= 25 or frame == len(clip.qpos) - 1)
        start = pushed = None
        if failed or over:
          actions[w], ages[w] = [np.zeros(29), np.zeros(29)], 0
        clip, frame = clip_files[int(term.clip[w])], int(term.frame[w])
        if failed or over:
          start = _start(after[0][w], after[1][w], clip, frame - 1, world.origin)
        else:
          change = after[1][w] - _STATE["qvel"][w]
          assert not change[6:].any()
          pushed = np.concatenate((change[:3], matrix(after[0][w][3:7]) @ change[3:6]))
        robot = world.look(after[0][w], after[1][w])
        wanted = np.concatenate((clip.qpos[frame, 7:], clip.qvel[frame, 6:]))
        looked = world.observe(robot, clip.bodies[frame], wanted, actions[w][-1])
        biased = looked["joint_pos"] + world.bias
        seen.append(
          Step(
            rewards={n: (v / c, expected[n]) for n, v, c in zip(names, values[w], weights, strict=True)},
            total=(reward[w].item(), STEP * sum(c * expected[n] for n, c in zip(names, weights, strict=True))),
            critic={name: (terms["critic"][w][name], value) for name, value in looked.items()},
            actor={n: (v, biased if n == "joint_pos" else looked[n]) for n, v in terms["actor"][w].items()},
            failed=(bool(terminated[w]), failed),
            truncated=(bool(truncated[w]), over),
            shadow=(_STATE["qpos"][w].copy(), shadow),
            pushed=pushed,
            start=start,
          )
        )
  return seen


def _by_term(env: ManagerBasedRlEnv, group: str, observations: dict[str, Any]) -> list[dict[str, np.ndarray]]:
  layout = env.observation_manager.layout(group)
  return [{term.name: row[term.columns] for term in layout} for row in observations[group].double().numpy()]


def _start(
  qpos: np.ndarray, qvel: np.ndarray, clip: Reference, frame: int, origin: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
  turn = matrix(qpos[3:7]) @ matrix(clip.qpos[frame, 3:7]).T
  # Roll, then pitch, then yaw, about the axes of the world.
  euler = math.atan2(turn[2, 1], turn[2, 2]), math.asin(-turn[2, 0]), math.atan2(turn[1, 0], turn[0, 0])
  spin = matrix(qpos[3:7]) @ qvel[3:6] - matrix(clip.qpos[frame, 3:7]) @ clip.qvel[frame, 3:6]
  off = (qpos[:3] - origin - clip.qpos[frame, :3], euler, qvel[:3] - clip.qvel[frame, :3], spin)
  return np.concatenate((*off, qpos[7:] - clip.qpos[frame, 7:])), qvel[6:] - clip.qvel[frame, 6:]


@pytest.fixture(scope="module")
def steps(folder: Path) -> list[Step]:
  return roll(folder, 110)


def test_the_reference_is_the_clip_by_mujoco_c_from_its_first_frame_to_its_last(folder: Path) -> None:
  env, term = make(still(folder))
  library = term.library
  for clip, name in enumerate(("a_squat", "b_march")):
    expected = Reference(folder / f"{name}.npz", env.sim.mj_model)
    first, count = int(library.offsets[clip]), int(library.lengths[clip])
    assert count == len(expected.qpos)
    rows = library.table[first : first + count].numpy()
    turned = np.array([[matrix(quat) for quat in row.reshape(-1, 4)] for row in rows[:, library.columns["body_quat"]]])
    bodies = expected.bodies
    for column, values in {
      "joint_pos": expected.qpos[:, 7:],
      "joint_vel": expected.qvel[:, 6:],
      "body_pos": np.array([body.pos.ravel() for body in bodies]),
      "lin_vel": np.array([body.speed.ravel() for body in bodies]),
      "ang_vel": np.array([body.spin.ravel() for body in bodies]),
    }.items():
      np.testing.assert_allclose(rows[:, library.columns[column]], values, atol=1e-6, err_msg=column)
    np.testing.assert_allclose(turned, [body.rotation for body in bodies], atol=1e-6)


def sides(steps: list[Step], kind: str, name: str) -> tuple[np.ndarray, np.ndarray]:
  """Values of the environment and of the oracle."""
  ours, oracle = (np.array([getattr(step, kind)[name][side] for step in steps]) for side in range(2))
  return ours, oracle


def check(steps: list[Step], kind: str, tol: float) -> None:
  for name in getattr(steps[0], kind):
    ours, oracle = sides(steps, kind, name)
    np.testing.assert_allclose(ours, oracle, rtol=tol, atol=tol, err_msg=name)


def test_every_reward_is_its_formula(steps: list[Step]) -> None:
  check(steps, "rewards", 1e-5)
  ours, oracle = np.array([step.total for step in steps]).T
  np.testing.assert_allclose(ours, oracle, rtol=1e-5, atol=1e-6)


def test_the_rollout_shows_every_reward_at_work(steps: list[Step]) -> None:
  for name in steps[0].rewards:
    values = np.array([step.rewards[name][1] for step in steps])
    assert (values > 1e-3).sum() > 5, name
    assert np.ptp(values) > 0.3 * values.max(), name


def test_the_critic_sees_every_quantity_without_noise(steps: list[Step]) -> None:
  check(steps, "critic", 1e-5)


def test_the_actor_sees_uniform_noise_of_the_right_size(steps: list[Step]) -> None:
  for name in steps[0].actor:
    ours, oracle = sides(steps, "actor", name)
    if name not in NOISE:
      np.testing.assert_allclose(ours, oracle, rtol=1e-5, atol=1e-5, err_msg=name)
      continue
    noise = (ours - oracle) / NOISE[name]
    assert 0.99 < np.abs(noise).max() < 1.0 + 1e-5 / NOISE[name], name
    spread = 1.0 / math.sqrt(3.0)
    assert abs(noise.mean()) < 5.0 * spread / math.sqrt(noise.size), name
    assert abs(noise.std() - spread) < 2.5 * spread / math.sqrt(noise.size), name


def test_episodes_end_where_the_table_says(steps: list[Step]) -> None:
  assert [step.failed[0] for step in steps] == [step.failed[1] for step in steps]
  assert [step.truncated[0] for step in steps] == [step.truncated[1] for step in steps]
  assert sum(step.failed[1] for step in steps) > 5
  assert sum(step.truncated[1] for step in steps) > 5


def test_physics_is_that_of_mujoco_c_under_targets_less_the_encoder_bias(steps: list[Step]) -> None:
  ours, oracle = (np.array([step.shadow[side] for step in steps]) for side in range(2))
  np.testing.assert_allclose(ours, oracle, rtol=0.0, atol=1e-8)


def test_offsets_of_starts_are_within_the_limits_of_the_table(steps: list[Step]) -> None:
  starts = np.array([step.start[0] for step in steps if step.start is not None])
  limits = np.concatenate((OFFSET, TWIST, np.full(29, 0.1)))
  assert len(starts) > 30
  # Clips have single precision, and their joints beyond soft limits stay there.
  assert (np.abs(starts) <= limits + 1e-5).all()
  assert (np.abs(starts).max(0) > 0.75 * limits).all()
  for step in steps:
    if step.start is not None:
      np.testing.assert_allclose(step.start[1], 0.0, atol=1e-5)


def test_nothing_but_a_push_moves_a_robot_whose_episode_goes_on(steps: list[Step]) -> None:
  pushes = np.array([step.pushed for step in steps if step.pushed is not None and step.pushed.any()])
  assert 30 < len(pushes) < 0.3 * len(steps)
  assert (np.abs(pushes) <= TWIST + 1e-9).all()
  assert (np.abs(pushes).max(0) > 0.8 * TWIST).all()


@pytest.mark.warp
def test_every_term_is_its_formula_on_mujoco_warp(folder: Path) -> None:
  steps = roll(folder, 30, num_envs=4, engine="warp")
  check(steps, "critic", 2e-4)
  for name in steps[0].rewards:
    ours, oracle = sides(steps, "rewards", name)
    # In single precision a contact may begin or end a substep apart, now and then.
    close = np.isclose(ours, oracle, rtol=2e-3, atol=2e-3)
    assert close.mean() > (0.95 if name == "self_collisions" else 0.999), name
  ours, shadow = (np.array([step.shadow[side] for step in steps]) for side in range(2))
  assert np.quantile(np.abs(ours - shadow).max(1), 0.98) < 2e-5
  assert [step.failed[0] for step in steps] == [step.failed[1] for step in steps]
  assert [step.truncated[0] for step in steps] == [step.truncated[1] for step in steps]
