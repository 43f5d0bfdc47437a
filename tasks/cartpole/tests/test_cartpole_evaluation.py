"""The evaluation of cartpole: returns of whole episodes, on the scale of 0 to 1000."""

import pytest
import torch
from mjlab_cartpole import balance
from mjlab_cartpole.evaluation import CartpoleEvaluation
from mjlab_envs import ManagerBasedRlEnv


def test_the_return_is_the_sum_of_rewards_that_are_one_at_best() -> None:
  def env() -> ManagerBasedRlEnv:
    cfg = evaluator.configure(balance().env)
    cfg.episode_length_s = 2.0
    return ManagerBasedRlEnv(cfg, device="cpu")

  evaluator = CartpoleEvaluation(episodes=3)
  with env() as played:
    played.reset(seed=0)
    total, upright = torch.zeros(3), torch.zeros(3)
    for _ in range(40):
      reward = played.step(torch.zeros(3, 1))[1]
      total += reward / played.step_dt
      upright += played.metrics_manager.get_value("upright")
  with env() as judged:
    result = evaluator.run(judged, lambda _: torch.zeros(3, 1))
  metrics = result.groups["all"]
  assert metrics["return"].mean == pytest.approx(total.mean().item(), rel=1e-5)
  assert metrics["upright"].mean == pytest.approx(upright.mean().item() / 40, rel=1e-5)
  assert 0.0 < metrics["upright"].mean < 1.0
  assert metrics["return"].count == 3
