"""The class of changes that cost a recording: a number changed by `set_params` is a write that the next step reads."""

import math
from typing import Any

import pytest
import torch
from envs_hopper import Make, actions, hopper_cfg
from mjlab_core.errors import ConfigError
from mjlab_dr import geom_friction
from mjlab_envs import ManagerBasedRlEnv, mdp
from mjlab_managers import CurriculumTermCfg, EventTermCfg, ManagerTermBase, RewardTermCfg


def lean(env: Any, *, std: float) -> torch.Tensor:
  return torch.exp(-env.scene["robot"].data.projected_gravity_b[:, :2].square().sum(1) / std**2)


class heights(ManagerTermBase):
  """Height above a level, as a class."""

  def __init__(self, env: Any, *, level: float) -> None:
    super().__init__(env)
    self._level = level

  def __call__(self) -> torch.Tensor:
    return (self.env.scene["robot"].data.root_link_pos_w[:, 2] - self._level).float()


def lift(env: Any, mask: torch.Tensor, *, speed: float) -> None:
  velocity = torch.zeros(env.num_envs, 6, dtype=env.sim.dtype, device=env.device)
  velocity[:, 2] += speed
  env.scene["robot"].write_root_velocity(velocity, mask)


def live_cfg(engine: str) -> Any:
  cfg = hopper_cfg(engine=engine)
  cfg.rewards = {
    "lean": RewardTermCfg(lean, weight=1.0, params={"std": 0.5}),
    "height": RewardTermCfg(heights, weight=1.0, params={"level": 0.0}),
  }
  cfg.events["lift"] = EventTermCfg(lift, mode="step", params={"speed": 0.0})
  return cfg


@pytest.mark.parametrize(
  ("engine_", "device"),
  [
    ("native", "cpu"),
    pytest.param("warp", "cpu", marks=pytest.mark.warp),
    pytest.param("warp", "cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")),
  ],
)
def test_a_number_acts_in_the_next_step_without_a_new_recording(
  make: Make, engine_: str, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
  env = make(live_cfg(engine_), device)
  for step in range(8):
    env.step(actions(env, step))
  assert env.is_captured == (device == "cuda")
  recorded: list[str] = []
  monkeypatch.setattr(env._step_graph, "invalidate", lambda: recorded.append("again"))
  env.reward_manager.set_params("lean", std=0.1)
  env.reward_manager.set_params("height", level=2.0)
  env.termination_manager.set_params("fell", limit_angle=0.0)
  env.event_manager.set_params("lift", speed=3.0)
  _, _, terminated, _, _ = env.step(actions(env, 8))
  rewards = env.reward_manager.step_reward
  assert (rewards[:, 1] < -1.0).all()
  assert terminated.all()
  data = env.scene["robot"].data
  torch.testing.assert_close(data.root_link_lin_vel_w[:, 2], torch.full_like(data.root_link_lin_vel_w[:, 2], 3.0))
  assert recorded == []


def test_a_parameter_that_nothing_reads_is_refused(make: Make) -> None:
  friction = {"randomizer": geom_friction("foot", (0.3, 1.2)), "transmission_type": "tendon"}
  cfg = hopper_cfg()
  cfg.events["friction"] = EventTermCfg(mdp.randomize, mode="startup", params=friction)
  with pytest.raises(ConfigError, match="transmission_type is for quantities of actuator models"):
    make(cfg)


def test_a_curriculum_with_a_wrong_name_is_refused_when_it_is_changed(make: Make) -> None:
  def follow(env: ManagerBasedRlEnv, mask: torch.Tensor, *, command: str) -> torch.Tensor:
    return env.command_manager.get_command(command).mean()

  env = make(curriculum={"c": CurriculumTermCfg(follow, params={"command": "speed"})})
  with pytest.raises(ConfigError, match=r"term 'c'.*term 'sped' does not exist\. Nearest: speed"):
    env.curriculum_manager.set_params("c", command="sped")
  env.reset()
  env.step(actions(env, 0))
  assert not math.isnan(env.drain_log()["Curriculum/c"])
