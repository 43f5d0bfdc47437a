"""Curricula of manipulation tasks."""

from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from mjlab_managers import CurriculumTermCfg, ManagerTermBase

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


class reward_weight(ManagerTermBase):
  """Set the weight of a reward by stages (environment step, weight) of the step counter. Logs the weight."""

  # The stage follows from the step counter at every step.
  _constants = frozenset({"_starts", "_weights"})

  def __init__(self, cfg: CurriculumTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    starts, weights = zip(*cfg.params["stages"], strict=True)
    if starts[0] != 0 or any(later <= sooner for sooner, later in pairwise(starts)):
      raise ValueError(f"stages must begin at step 0 and follow in order, got steps {list(starts)}")
    self._starts = torch.tensor(starts, device=env.device)
    self._weights = torch.tensor(weights, device=env.device)
    self._weight = env.reward_manager.weight(cfg.params["reward"])

  def __call__(
    self, env: "ManagerBasedRlEnv", mask: torch.Tensor, *, reward: str, stages: list[tuple[int, float]]
  ) -> torch.Tensor:
    del mask, reward, stages  # All worlds share the stage; the rest was resolved at build.
    stage = (env.common_step_counter >= self._starts).sum().sub_(1)
    return self._weight.copy_(self._weights[stage.view(1)][0]).clone()
