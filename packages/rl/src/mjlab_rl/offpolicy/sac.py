"""Soft actor-critic with distributional critics, with the parts of FastSAC and FlashSAC as options."""

import copy
import math
from typing import Any

import torch
from torch.nn import functional
from torch.optim.swa_utils import get_ema_multi_avg_fn

from mjlab_rl.offpolicy.algorithm import OffPolicyAlgorithm
from mjlab_rl.offpolicy.networks import renormalize
from mjlab_rl.offpolicy.replay import Transitions
from mjlab_rl.offpolicy.returns import project

_FIGURES = ("critic_loss", "policy_loss", "temperature", "entropy", "value")


class Sac(OffPolicyAlgorithm):
  """Soft actor-critic (Haarnoja et al. 2018, arXiv:1812.05905); `SacCfg` names the options and their sources."""

  def __init__(self, *args: Any) -> None:
    super().__init__(*args)
    self.log_temperature = torch.nn.Parameter(torch.tensor(math.log(self.cfg.temperature), device=self.device))
    self.target = copy.deepcopy(self.critic).requires_grad_(False)
    # One normaliser, because only the critic's learns.
    self.target.obs_normalizer = self.critic.obs_normalizer
    self.modules |= {"target": self.target, "temperature": torch.nn.ParameterDict({"log": self.log_temperature})}
    self._figures = {name: torch.zeros((), device=self.device) for name in _FIGURES}
    self._actor_parameters = list(self.actor.parameters())
    self._critic_parameters: list[torch.Tensor] = list(self.critic.parameters())
    self._target_parameters: list[torch.Tensor] = list(self.target.parameters())
    self._follow = get_ema_multi_avg_fn(1.0 - self.cfg.tau)

  def parameter_groups(self) -> list[dict[str, Any]]:
    return [
      {"params": list(self.critic.parameters())},
      {"params": list(self.actor.parameters())},
      {"params": [self.log_temperature], "weight_decay": 0.0},
    ]

  def figures(self) -> dict[str, torch.Tensor]:
    return self._figures

  def round(self) -> None:
    for number in range(self.cfg.policy_every):
      batch = self.sample()
      if number == 0:
        self._update_policy(batch)
      self._update_critic(batch)

  def _autocast(self) -> Any:
    is_on = self.cfg.bf16 and self.device.type == "cuda"
    # Weights change between contexts, and a recording must not keep copies of them.
    return torch.autocast(self.device.type, torch.bfloat16, enabled=is_on, cache_enabled=False)

  def _update_critic(self, batch: Transitions) -> None:
    obs, next_obs = self.of_critic(batch.obs), self.of_critic(batch.next_obs)
    is_unit = self.critic.is_unit
    with self._autocast():
      with torch.no_grad():
        self.actor.eval()
        self.target.train(is_unit)
        output = self.actor.output(self.of_actor(batch.next_obs))
        next_action, log_prob = self.actor.squash.sample_with_log_prob(output)
        present, later = (obs, batch.action), (next_obs, next_action)
        if is_unit:
          # Batches of the same kind for all normalisations (CrossQ, arXiv:1902.05605).
          present = later = (torch.cat((obs, next_obs)), torch.cat((batch.action, next_action)))
        distribution = self.target.logits(*later)[:, -len(obs) :].softmax(-1)
        if self.cfg.combine == "min":
          least = (distribution @ self.target.support).argmin(0)
          distribution = distribution.take_along_dim(least[None, :, None], 0).expand_as(distribution)
        entropy = -self.log_temperature.exp() * log_prob
        values = batch.reward[:, None] + batch.discount[:, None] * (self.target.support + entropy[:, None])
        goal = project(distribution, values.expand_as(distribution), self.target.support)
      self.critic.train(is_unit)
      predicted = self.critic.logits(*present)[:, : len(obs)]
      loss = -(goal * functional.log_softmax(predicted, -1)).sum(-1).mean(-1).sum()
    self.step(loss, self._critic_parameters)
    if is_unit:
      renormalize(self.critic)
    self._follow(self._target_parameters, self._critic_parameters, 0)
    if self.cfg.temperature_with == "critic":
      self._update_temperature(log_prob)
    self._figures["critic_loss"].copy_(loss.detach())

  def _update_policy(self, batch: Transitions) -> None:
    is_unit = self.actor.is_unit
    seen = inputs = self.of_actor(batch.obs)
    if is_unit:
      inputs = torch.cat((seen, self.of_actor(batch.next_obs)))
    with self._autocast():
      self.actor.train(is_unit)
      self.critic.eval()
      output = self.actor.output(inputs)
      action, log_prob = self.actor.squash.sample_with_log_prob(output[: len(seen)])
      values = self.critic.values(self.critic.logits(self.of_critic(batch.obs), action))
      value = values.amin(0) if self.cfg.combine == "min" else values.mean(0)
      loss = (self.log_temperature.detach().exp() * log_prob - value).mean()
    self.step(loss, self._actor_parameters)
    if is_unit:
      renormalize(self.actor.mlp)
    if self.cfg.temperature_with == "policy":
      self._update_temperature(log_prob)
    self._figures["policy_loss"].copy_(loss.detach())
    self._figures["entropy"].copy_(-log_prob.detach().mean() / action.shape[-1])
    self._figures["value"].copy_(value.detach().mean())

  def _update_temperature(self, log_prob: torch.Tensor) -> None:
    surplus = -log_prob.detach().mean() - self.cfg.target_entropy * self.actor.squash.output_dim
    self.step(self.log_temperature.exp() * surplus, [self.log_temperature])
    self._figures["temperature"].copy_(self.log_temperature.detach().exp())
