"""Weights and parameters in stages, and what a saved environment knows of them."""

from typing import Any

import pytest
import torch
from envs_hopper import Make, actions, hopper_cfg
from mjlab_core import Positive
from mjlab_core.errors import ConfigError
from mjlab_envs import mdp
from mjlab_managers import CurriculumTermCfg, RewardTermCfg, TerminationTermCfg


def lean(env: Any, *, scale: Positive, power: float = 1.0) -> torch.Tensor:
  return torch.full((env.num_envs,), 2.0) * scale * power


def too_low(env: Any, *, minimum: float) -> torch.Tensor:
  return torch.ones(env.num_envs) < minimum


def staged_cfg(**curriculum: CurriculumTermCfg) -> Any:
  cfg = hopper_cfg(rewards={"lean": RewardTermCfg(lean, weight=0.5, params={"scale": 3.0})}, curriculum=curriculum)
  cfg.episode_length_s = 10.0
  cfg.scale_rewards_by_dt = False
  cfg.terminations["low"] = TerminationTermCfg(too_low, params={"minimum": 0.0})
  return cfg


REWARD = CurriculumTermCfg(
  mdp.reward_curriculum,
  params={
    "reward": "lean",
    "stages": [
      mdp.Stage(step=2, weight=1.0),
      {"step": 4, "params": {"scale": 5.0}},
      mdp.Stage(step=5, weight=-1.0, params={"power": 2.0}),
    ],
  },
)


def test_a_reward_follows_its_stages_and_values_that_a_stage_leaves_out_stay(make: Make) -> None:
  env = make(staged_cfg(lean=REWARD))
  seen = [env.step(actions(env, step))[1][0].item() for step in range(7)]
  # Curricula follow rewards in a step: what begins at step n first counts in step n + 1.
  assert seen == pytest.approx([3.0, 3.0, 6.0, 6.0, 10.0, -20.0, -20.0])
  log = env.drain_log()
  assert {key: log[f"Curriculum/lean/{key}"] for key in ("weight", "scale", "power")} == {
    "weight": -1.0,
    "scale": 5.0,
    "power": 2.0,
  }


def test_a_saved_environment_goes_on_in_its_stage(make: Make) -> None:
  first, second = make(staged_cfg(lean=REWARD)), make(staged_cfg(lean=REWARD))
  first.reset()
  second.reset()
  for step in range(6):
    first.step(actions(first, step))
  second.load_state_dict(first.state_dict())
  assert first.step(actions(first, 6))[1][0] == second.step(actions(second, 6))[1][0] == -20.0


def test_stages_may_count_iterations_and_change_terminations(make: Make) -> None:
  low = CurriculumTermCfg(
    mdp.termination_curriculum,
    params={"termination": "low", "stages": [mdp.Stage(step=1, params={"minimum": 2.0})], "steps_per_iteration": 3},
  )
  env = make(staged_cfg(low=low))
  seen = [bool(env.step(actions(env, step))[2].all()) for step in range(5)]
  assert seen == [False, False, False, True, True]


@pytest.mark.parametrize(
  ("stages", "message"),
  [
    ([{"step": 3, "weight": 1.0}, {"step": 3, "weight": 2.0}], r"must follow in order, got steps \[3, 3\]"),
    ([{"step": 3, "params": {"scales": 1.0}}], "parameter 'scales' does not exist. Nearest: scale"),
    ([{"step": 3, "params": {"scale": -1.0}}], "stage of step 3: parameter 'scale' must be positive, got -1.0"),
    ([{"step": 3, "weight": float("nan")}], "Stage: weight must be a number, got nan"),
    ([{"step": 2.5, "weight": 1.0}], "Stage: step must be a whole number, got 2.5"),
  ],
)
def test_stages_are_checked(make: Make, stages: list[Any], message: str) -> None:
  term = CurriculumTermCfg(mdp.reward_curriculum, params={"reward": "lean", "stages": stages})
  with pytest.raises(ConfigError, match=message):
    make(staged_cfg(lean=term))


def test_a_parameter_that_is_read_once_and_a_weight_of_a_termination_are_refused(make: Make) -> None:
  cfg = staged_cfg()
  cfg.rewards["pose"] = RewardTermCfg(mdp.posture, weight=1.0, params={"std": 0.3})
  stages = [mdp.Stage(step=1, params={"std": 1.0})]
  cfg.curriculum["pose"] = CurriculumTermCfg(mdp.reward_curriculum, params={"reward": "pose", "stages": stages})
  heavy = {"termination": "low", "stages": [mdp.Stage(step=1, weight=1.0)]}
  cfg.curriculum["low"] = CurriculumTermCfg(mdp.termination_curriculum, params=heavy)
  with pytest.raises(ConfigError) as caught:
    make(cfg)
  assert "'std' is not read again in every step" in str(caught.value)
  assert "a termination has no weight" in str(caught.value)
