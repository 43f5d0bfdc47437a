"""Levels of randomised quantities in evaluations, and the sim-to-real preset."""

import math
from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError, MjlabError, UnknownNameError
from mjlab_envs import ManagerBasedRlEnv
from mjlab_velocity import VelocityEvaluation, g1_rough_blind, go1_flat, go1_flat_env, sim_to_real

LEVELS: dict[str, tuple[float, ...]] = {
  "actuator_delay": (0.0, 8.0),
  "foot_friction_slide": (0.3, 1.2),
  "payload": (0.0, 2.0, 5.0),
}


def evaluator() -> VelocityEvaluation:
  return VelocityEvaluation(grid=((0.5, 0.0, 0.0),), pushes=(0.0, 1.0), levels=LEVELS, repeats=1, seconds=0.1)


def test_every_world_has_its_own_combination_of_levels() -> None:
  with ManagerBasedRlEnv(evaluator().configure(go1_flat_env()), device="cpu") as env:
    env.reset(seed=0)
    model = env.sim.mj_model
    foot, trunk = model.geom("robot/FR_foot_collision").id, model.body("robot/trunk").id
    friction = env.sim.model.geom_friction[:, foot, 0]
    mass = env.sim.model.body_mass[:, trunk] - 5.204
    delays: Any = env.scene["robot"].actuators.groups[0].delay
    env.step(torch.zeros(env.num_envs, 12))
    lag = delays.lag
    found = torch.stack((lag.float(), friction.float(), mass.float()), 1)
  wanted = torch.tensor([[d, f, p] for p in (0, 2, 5) for f in (0.3, 1.2) for d in (0, 8) for _push in range(2)])
  torch.testing.assert_close(found, wanted.float())


def test_results_are_grouped_by_level_and_by_pair() -> None:
  with ManagerBasedRlEnv(evaluator().configure(go1_flat_env()), device="cpu") as env:
    result = evaluator().run(env, lambda _: torch.zeros(24, 12))
  counts = {name: metrics["fall_rate"].count for name, metrics in result.groups.items()}
  assert counts["actuator_delay 8"] == 12
  assert counts["payload 5"] == 8
  assert counts["push 1 m/s, foot_friction_slide 0.3"] == 6
  assert counts["foot_friction_slide 1.2, payload 2"] == 4
  assert not any(name.startswith("vx +0.5,") for name in counts)


@pytest.mark.parametrize(
  ("levels", "message"),
  [
    ({"gravity": (1.0,)}, "event 'gravity' does not exist.*foot_friction_slide.*payload"),
    ({"reset_base": (1.0,)}, "event 'reset_base' draws nothing by a randomizer"),
    ({"payload": ()}, "eval: levels.*must have at least 1 element"),
  ],
)
def test_impossible_levels_are_refused(levels: dict[str, tuple[float, ...]], message: str) -> None:
  with pytest.raises(MjlabError, match=message):
    VelocityEvaluation(levels=levels).configure(go1_flat_env())


def test_the_preset_draws_all_that_a_robot_differs_in() -> None:
  task = sim_to_real(go1_flat())
  task.env.scene.num_envs = 32
  with ManagerBasedRlEnv(task.env, device="cpu") as env:
    env.reset(seed=0)
    env.step(torch.zeros(32, 12))
    default, robot = env.sim.mj_model, env.scene["robot"]
    trunk = default.body("robot/trunk").id
    ratio = env.sim.model.body_mass[:, trunk:] / torch.tensor(default.body_mass[trunk:])
    torso, links = ratio[:, 0], ratio[:, 1:]
    assert math.exp(-0.1) < float(torso.min()) < 0.97
    assert 1.3 < float(torso.max()) < math.exp(0.4)
    assert math.exp(-0.1) < float(links.min()) < float(links.max()) < math.exp(0.1)
    groups = robot.actuators.groups
    assert {type(group).__name__ for group in groups} == {"DcMotor"}
    for group in groups:
      gains = group.stiffness / group.nominal("stiffness")
      assert 0.899 < float(gains.min()) < 0.95
      assert 1.05 < float(gains.max()) < 1.101
      assert group.delay is not None
      assert group.delay.lag.unique().tolist() == [0, 1, 2, 3, 4]
    assert env.observation_manager.describe().count("0 to 1") == 4
  push: Any = task.env.events["push_robot"]
  assert push.params["velocity_range"]["x"] == (-1.0, 1.0)


def test_the_preset_can_be_evaluated_at_levels_of_its_own_events() -> None:
  task = sim_to_real(g1_rough_blind())
  assert task.agent.experiment_name == "g1_velocity_blind_sim_to_real"
  cfg = VelocityEvaluation(
    levels={"stiffness": (0.8, 1.2), "payload": (0.0, 3.0)}, grid=((0.0, 0.0, 0.0),), pushes=(0.0,), repeats=1
  ).configure(task.env)
  cfg.scene.terrain = go1_flat_env().scene.terrain
  cfg.terminations["out_of_terrain_bounds"] = None
  cfg.scene.max_init_terrain_level = None
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    env.reset(seed=0)
    group = env.scene["robot"].actuators.groups[0]
    ratio = group.stiffness / group.nominal("stiffness")
    torch.testing.assert_close(ratio[:, 0].float(), torch.tensor([0.8, 1.2, 0.8, 1.2]))


def test_parts_of_the_preset_are_taken_by_name() -> None:
  plain, pushed = go1_flat().env, sim_to_real(go1_flat(), ["pushes"]).env
  assert pushed.events.keys() == plain.events.keys()
  assert [name for name in plain.events if plain.events[name] != pushed.events[name]] == ["push_robot"]
  with pytest.raises(UnknownNameError, match=r"part of sim_to_real .*Nearest: gains"):
    sim_to_real(go1_flat(), ["gain"])


def test_the_preset_refuses_a_task_without_the_parts_that_it_changes() -> None:
  task = go1_flat()
  task.env.events["base_com"] = None
  with pytest.raises(ConfigError, match="has no event 'base_com'"):
    sim_to_real(task)
