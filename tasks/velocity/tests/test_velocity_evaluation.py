"""The evaluation of velocity tracking: fixed commands, pushes of known size, errors as they are."""

import itertools
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_dr import pseudo_inertia
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg, mdp
from mjlab_managers import EventTermCfg, TerminationTermCfg
from mjlab_velocity import VelocityEvaluation, go1_flat_env
from mjlab_velocity.evaluation import (
  landings,
  mechanical_power,
  push_by_level,
  torque_squared,
)
from mjlab_velocity.mdp.rewards import landing_force, linear_error_squared, turning_error_squared

GRID = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.5))
PUSHES = (0.0, 0.75, 1.5)


def evaluator() -> VelocityEvaluation:
  return VelocityEvaluation(grid=GRID, pushes=PUSHES, repeats=2, seconds=0.4, push_interval=0.1)


@pytest.fixture
def env() -> Iterator[ManagerBasedRlEnv]:
  with ManagerBasedRlEnv(evaluator().configure(go1_flat_env()), device="cpu") as env:
    env.reset(seed=0)
    yield env


def test_each_world_keeps_its_command(env: ManagerBasedRlEnv) -> None:
  wanted = torch.tensor(GRID).repeat(6, 1)
  for _ in range(10):
    env.step(torch.zeros(12, 12))
    assert torch.equal(env.command_manager.get_command("twist"), wanted)
  env.reset(env_ids=[1, 2])
  assert torch.equal(env.command_manager.get_command("twist"), wanted)


def test_pushes_have_their_level_and_any_direction(env: ManagerBasedRlEnv) -> None:
  push = env.event_manager.get_term_cfg("push_robot")
  assert isinstance(push.func, push_by_level)
  before = env.scene["robot"].data.root_link_lin_vel_w.clone()
  push.func(torch.ones(12, dtype=torch.bool))
  change = env.scene["robot"].data.root_link_lin_vel_w - before
  sizes = change.norm(dim=-1)
  expected = torch.tensor([0.0, 0.0, 0.75, 0.75, 1.5, 1.5] * 2, dtype=sizes.dtype)
  torch.testing.assert_close(sizes, expected, atol=1e-6, rtol=0)
  assert change[:, 2].abs().max() < 1e-9
  directions = torch.atan2(change[:, 1], change[:, 0])[expected > 0]
  assert directions.unique().numel() == 8


def test_errors_and_power_are_their_closed_forms(env: ManagerBasedRlEnv) -> None:
  env.step(torch.ones(12, 12))
  data = env.scene["robot"].data
  for world in range(12):
    velocity, turn = data.root_link_lin_vel_b[world], data.root_link_ang_vel_b[world, 2]
    vx, vy, wz = GRID[world % 2]
    linear = (velocity[0] - vx) ** 2 + (velocity[1] - vy) ** 2
    assert linear_error_squared(env, command="twist")[world] == pytest.approx(linear.item(), rel=1e-5)
    found = turning_error_squared(env, command="twist")[world]
    assert found == pytest.approx((turn - wz).item() ** 2, rel=1e-5)
    # What the actuators did, by MuJoCo's own account.
    force = env.sim.data.qfrc_actuator[world, 6:]
    power = (force * env.sim.data.qvel[world, 6:]).abs().sum()
    assert mechanical_power(env)[world] == pytest.approx(power.item(), rel=1e-6)
    torque = force.square().mean().item()
    assert torque_squared(env)[world] == pytest.approx(torque, rel=1e-6)


def test_impacts_are_the_forces_of_feet_that_land_again() -> None:
  sensor, cfg = "feet_ground_contact", evaluator().configure(go1_flat_env())
  cfg.terminations, cfg.episode_length_s = {}, 10.0
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    env.reset(seed=0)
    contact, landed, has_flown = env.scene[sensor], torch.zeros(12), torch.zeros(12, dtype=torch.bool)
    felt = torch.zeros(12)
    for step in range(50):
      if step == 15:
        # All robots jump.
        landed.zero_()
        felt.zero_()
        velocity = torch.zeros(12, 6, dtype=env.sim.dtype)
        velocity[:, 2] = 1.0
        env.scene["robot"].write_root_velocity(velocity, torch.ones(12, dtype=torch.bool))
      env.step(torch.zeros(12, 12))
      count, force = landings(env, sensor=sensor), landing_force(env, sensor=sensor)
      total = contact.data.force.norm(dim=-1).sum(-1)
      torch.testing.assert_close(force[count == 4], total[count == 4])
      # A foot may touch the ground without a force.
      assert (count[force > 0] > 0).all()
      assert (force <= total + 1e-3).all()
      has_flown |= (contact.data.found == 0).all(-1)
      landed += count
      felt += force > 0
    assert has_flown.all()
    assert (landed >= 1).all()
    assert (felt >= 1).all()


def test_the_summary_is_by_command_and_by_push() -> None:
  with ManagerBasedRlEnv(evaluator().configure(go1_flat_env()), device="cpu") as env:
    result = evaluator().run(env, lambda _: torch.zeros(12, 12))
  assert list(result.groups) == ["all", "stand", "vx +1 wz +0.5", "push 0 m/s", "push 0.75 m/s", "push 1.5 m/s"]
  assert [metrics["fall_rate"].count for metrics in result.groups.values()] == [12, 6, 6, 4, 4, 4]
  error = {group: metrics["lin_vel_rmse"].mean for group, metrics in result.groups.items()}
  # A robot that stands still is wrong where it is to walk, and by its speed after a push.
  assert error["stand"] + 0.3 < error["vx +1 wz +0.5"]
  assert error["push 0 m/s"] + 0.1 < error["push 0.75 m/s"] < error["push 1.5 m/s"] - 0.1
  assert result.groups["stand"]["cost_of_transport"].count == 0
  assert result.groups["vx +1 wz +0.5"]["cost_of_transport"].count == 6
  assert 0.3 < result.groups["all"]["survived"].mean < 0.4 + 1e-6
  assert 0.0 < result.groups["all"]["torque_rms"].mean < 23.7
  assert result.groups["all"]["action_change"].mean == 0.0


def test_every_metric_is_that_of_the_same_episodes_computed_step_by_step() -> None:
  """Step by step from the state that each step ended in, with falls, one of them on the first step."""

  # No push within an episode: one comes after a step is judged, and would be seen here.
  judge = VelocityEvaluation(grid=GRID, pushes=PUSHES, repeats=2, seconds=0.4, push_interval=1.0)

  def configured() -> ManagerBasedRlEnvCfg:
    cfg = judge.configure(go1_flat_env())
    cfg.terminations = {"time_out": cfg.terminations["time_out"], "fallen": TerminationTermCfg(falls_on_schedule)}
    drawn = {"randomizer": pseudo_inertia(".*_thigh", alpha=(0.2, 0.5))}
    cfg.events["mass"] = EventTermCfg(mdp.randomize, mode="startup", params=drawn)
    return cfg

  def act(step: int) -> torch.Tensor:
    return torch.randn(12, 12, generator=torch.Generator().manual_seed(step))

  names = ("linear", "yaw", "power", "speed", "torque", "change", "landings", "impact")
  moves: dict[str, list[list[float]]] = {name: [[] for _ in range(12)] for name in names}
  playing, failed = [True] * 12, [False] * 12
  cfg = configured()
  cfg.auto_reset = False
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    env.reset(seed=0)
    model = env.sim.mj_model
    mass = env.sim.model.body_mass[:, model.body_rootid == model.body("robot/trunk").id].sum(1).numpy()
    assert np.unique(mass).size == 12
    for step in range(1, 21):
      _, _, terminated, truncated, _ = env.step(act(step))
      landed, impact = (measure(env, sensor="feet_ground_contact") for measure in (landings, landing_force))
      change = act(step) - act(step - 1) if step > 1 else act(step)
      for world in [world for world in range(12) if playing[world]]:
        qpos, qvel = env.sim.data.qpos[world].numpy(), env.sim.data.qvel[world].numpy()
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, qpos[3:7])
        own = turn.reshape(3, 3).T @ qvel[:3]
        vx, vy, wz = GRID[world % 2]
        moves["linear"][world].append((own[0] - vx) ** 2 + (own[1] - vy) ** 2)
        moves["yaw"][world].append((qvel[5] - wz) ** 2)
        moves["power"][world].append(np.abs(env.sim.data.qfrc_actuator[world, 6:].numpy() * qvel[6:]).sum())
        moves["speed"][world].append(np.hypot(*qvel[:2]))
        moves["torque"][world].append(np.square(env.sim.data.qfrc_actuator[world, 6:].numpy()).mean())
        moves["change"][world].append(float(change[world].square().mean()))
        moves["landings"][world].append(float(landed[world]))
        moves["impact"][world].append(float(impact[world]))
        if terminated[world] or truncated[world]:
          playing[world], failed[world] = False, bool(terminated[world])
      if done := (terminated | truncated).nonzero().flatten().tolist():
        env.reset(env_ids=done)
  assert not any(playing)
  lengths = [len(values) for values in moves["speed"]]
  assert lengths == [20, 1, *[20] * 5, 9, *[20] * 4]
  with ManagerBasedRlEnv(configured(), device="cpu") as env:
    steps = itertools.count(1)
    result = judge.run(env, lambda _: act(next(steps)))
  worlds = {"all": range(12), "vx +1 wz +0.5": range(1, 12, 2), "push 1.5 m/s": (4, 5, 10, 11)}
  for group, members in worlds.items():
    metrics = {name: interval.mean for name, interval in result.groups[group].items()}
    mean = {name: [float(np.mean(values[world])) for world in members] for name, values in moves.items()}
    walking = [i for i, world in enumerate(members) if world % 2]
    stepping = [i for i, count in enumerate(mean["landings"]) if count]
    assert metrics == {
      "fall_rate": pytest.approx(np.mean([failed[world] for world in members])),
      "lin_vel_rmse": pytest.approx(np.mean(np.sqrt(mean["linear"])), rel=1e-4),
      "yaw_rate_rmse": pytest.approx(np.mean(np.sqrt(mean["yaw"])), rel=1e-4),
      "cost_of_transport": pytest.approx(
        np.mean([mean["power"][i] / (mass[members[i]] * 9.81 * mean["speed"][i]) for i in walking]), rel=1e-4
      ),
      "torque_rms": pytest.approx(np.mean(np.sqrt(mean["torque"])), rel=1e-4),
      "action_change": pytest.approx(np.mean(np.sqrt(mean["change"])), rel=1e-4),
      "foot_impact": pytest.approx(
        np.mean([mean["impact"][i] / mean["landings"][i] / (9.81 * mass[members[i]]) for i in stepping]), rel=1e-3
      ),
      "survived": pytest.approx(0.02 * np.mean([lengths[world] for world in members])),
    }, group


def falls_on_schedule(env: ManagerBasedRlEnv) -> torch.Tensor:
  """World 1 on its first step, world 7 on its ninth."""
  step = torch.zeros(env.num_envs, dtype=torch.int64)
  step[1], step[7] = 1, 9
  return env.episode_length_buf == step


def test_a_task_without_a_velocity_command_is_refused() -> None:
  cfg = go1_flat_env()
  del cfg.commands["twist"]
  with pytest.raises(ConfigError, match="'twist' is not a velocity command"):
    evaluator().configure(cfg)
  with pytest.raises(ConfigError, match="eval: grid must have at least 1 element"):
    VelocityEvaluation(grid=()).configure(go1_flat_env())
