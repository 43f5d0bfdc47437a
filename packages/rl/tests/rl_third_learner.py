"""A third learner in one file: a policy that repeats the actions after which rewards were high."""

from typing import Any

import torch
from mjlab_rl.offpolicy.algorithm import OffPolicyAlgorithm


class Weighted(OffPolicyAlgorithm):
  """Regression of actions, weighted by exp(reward)."""

  def __init__(self, *args: Any) -> None:
    super().__init__(*args)
    self.loss = torch.zeros((), device=self.device)

  def parameter_groups(self) -> list[dict[str, Any]]:
    return [{"params": list(self.actor.parameters())}]

  def figures(self) -> dict[str, torch.Tensor]:
    return {"loss": self.loss}

  def round(self) -> None:
    batch = self.sample()
    action = self.actor.squash.deterministic_output(self.actor.output(self.of_actor(batch.obs)))
    error = (action - batch.action).square().sum(-1)
    loss = (batch.reward.exp() * error).mean()
    self.step(loss, list(self.actor.parameters()))
    self.loss.copy_(loss.detach())
