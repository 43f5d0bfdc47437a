"""PPO whose mini-batch step is recorded once as CUDA graphs."""

import contextlib
from collections.abc import Generator
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from torch import Tensor, nn

from mjlab_rl.processes.ranks import Ranks
from mjlab_rl.recording import Recorded


class CapturedPPO(PPO):
  """rsl-rl's PPO, without a host sync inside an update; on a GPU, a mini-batch step is two CUDA graphs.

  The first graph computes the gradients and the KL divergence, the second applies them. Several processes have both in
  one message, which is summed between the graphs.

  It takes the arguments of rsl-rl's PPO and gives the same results within float rounding. Recurrent and compiled
  networks, curiosity, symmetry, and optimisers other than Adam use rsl-rl's own update.
  """

  def __init__(self, *args: Any, **kwargs: Any) -> None:
    super().__init__(*args, **kwargs)
    device = torch.device(self.device)
    self._is_on_gpu = device.type == "cuda"
    self._ranks = Ranks.current()
    # Fused Adam reads a single-precision learning rate.
    self._rate = torch.zeros((), dtype=torch.float32 if self._is_on_gpu else torch.float64, device=device)
    self._sums = torch.zeros(3, dtype=self._rate.dtype, device=device)
    self._advantages = torch.empty_like(self.storage.advantages)
    size = self.storage.num_envs * self.storage.num_transitions_per_env // self.num_mini_batches
    self._rows = torch.zeros(size, dtype=torch.int64, device=device)
    # Gradients of several processes, and the KL divergence.
    parameters = (
      [part for group in self.optimizer.param_groups for part in group["params"]] if self.is_multi_gpu else []
    )
    sizes = [parameter.numel() for parameter in parameters]
    self._message = torch.zeros(sum(sizes) + 1, device=device)
    for parameter, place in zip(parameters, self._message[:-1].split(sizes), strict=True):
      parameter.grad = place.view_as(parameter)
    self._differentiate = Recorded(self._compute_gradients, device)
    self._apply = Recorded(self._apply_gradients, device)

  @property
  def is_covered(self) -> bool:
    """True if this class, not rsl-rl, performs the updates."""
    return (
      isinstance(self.optimizer, torch.optim.Adam)
      and not (self.rnd or self.symmetry or self.actor.is_recurrent or self.critic.is_recurrent)
      and self.actor is self.get_policy()
    )

  def load(self, loaded_dict: dict[str, Any], load_cfg: dict[str, bool] | None, strict: bool) -> bool:
    """Restore a `save`. The state of the optimiser gets new memory, so steps are recorded again."""
    self._differentiate.clear()
    self._apply.clear()
    return super().load(loaded_dict, load_cfg, strict)

  def update(self) -> dict[str, float]:
    """Run the epochs over the stored rollout; return mean losses, which is the only wait for the device."""
    if not self.is_covered:
      return super().update()
    storage = self.storage
    # compute_returns makes a new tensor; a graph needs fixed memory.
    storage.advantages = self._advantages.copy_(storage.advantages)
    size = len(self._rows)
    rows = torch.randperm(self.num_mini_batches * size, device=self.device).view(self.num_mini_batches, size)
    self._sums.zero_()
    with self._rate_on_device():
      for _ in range(self.num_learning_epochs):
        for mini_batch in rows:
          self._rows.copy_(mini_batch)
          self._differentiate()
          # Not recorded, because processes may wait for each other here.
          if self.is_multi_gpu:
            self._ranks.sum(self._message)
          self._apply()
      value, surrogate, entropy, self.learning_rate = torch.cat(
        (self._sums.double(), self._rate.double()[None])
      ).tolist()
    observations = storage.observations.flatten(0, 1)
    modules = [*self.actor.modules(), *self.critic.modules()]
    buffers = [(module, name, buffer) for module in modules for name, buffer in module.named_buffers(recurse=False)]
    self.actor.update_normalization(observations)
    self.critic.update_normalization(observations)
    # rsl-rl assigns new tensors; a graph reads the memory of the first ones.
    for module, name, buffer in buffers:
      setattr(module, name, buffer.copy_(getattr(module, name)))
    storage.clear()
    steps = self.num_learning_epochs * self.num_mini_batches
    return {"value": value / steps, "surrogate": surrogate / steps, "entropy": entropy / steps}

  @contextlib.contextmanager
  def _rate_on_device(self) -> Generator[None]:
    """Let the optimiser read its learning rate from a tensor; outside, and in checkpoints, it is a plain number."""
    self._rate.fill_(self.learning_rate)
    for group in self.optimizer.param_groups:
      group |= {"lr": self._rate, "capturable": self._is_on_gpu, "fused": self._is_on_gpu or None}
    if self._is_on_gpu:
      for state in self.optimizer.state.values():
        state["step"] = state["step"].to(self.device)
    try:
      yield
    finally:
      for group in self.optimizer.param_groups:
        group |= {"lr": self.learning_rate, "capturable": False, "fused": None}

  def _compute_gradients(self) -> None:
    """Compute the gradients of the loss on the rows in `_rows`, and the KL divergence."""
    storage, rows = self.storage, self._rows
    if self.is_multi_gpu:
      self._message.zero_()
    else:
      self.optimizer.zero_grad()

    def batch(values: Any) -> Any:
      return values.flatten(0, 1)[rows]

    advantages = batch(storage.advantages)
    if self.normalize_advantage_per_mini_batch:
      advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    advantages = advantages.squeeze()
    device_type = torch.device(self.device).type
    with torch.autocast(device_type, torch.bfloat16, enabled=self.use_mixed_precision, cache_enabled=False):
      observations = batch(storage.observations)
      self.actor(observations, stochastic_output=True)
      log_prob = self.actor.get_output_log_prob(batch(storage.actions))
      values = self.critic(observations)
      entropy = self.actor.output_entropy.mean()
      if self.schedule == "adaptive":
        with torch.no_grad():
          old = tuple(batch(parameter) for parameter in storage.distribution_params or ())
          self._message[-1] = self.actor.get_kl_divergence(old, self.actor.output_distribution_params).mean()

      ratio = torch.exp(log_prob - batch(storage.actions_log_prob).squeeze())
      clipped_ratio = ratio.clamp(1.0 - self.clip_param, 1.0 + self.clip_param)
      surrogate_loss = torch.max(-advantages * ratio, -advantages * clipped_ratio).mean()
      old_values, returns = batch(storage.values), batch(storage.returns)
      value_loss = (values - returns).square()
      if self.use_clipped_value_loss:
        clipped = old_values + (values - old_values).clamp(-self.clip_param, self.clip_param)
        value_loss = torch.max(value_loss, (clipped - returns).square())
      value_loss = value_loss.mean()
      loss = surrogate_loss + self.value_loss_coef * value_loss - self.entropy_coef * entropy

    loss.backward()
    self._sums += torch.stack((value_loss.detach(), surrogate_loss.detach(), entropy.detach()))

  def _apply_gradients(self) -> None:
    """Adapt the learning rate and do one step of the optimiser, with the means over all processes."""
    if self.is_multi_gpu:
      self._message /= self.gpu_world_size
    if self.schedule == "adaptive":
      self._adapt_rate(self._message[-1])
    nn.utils.clip_grad_norm_(self.actor.parameters(), self.max_grad_norm)
    nn.utils.clip_grad_norm_(self.critic.parameters(), self.max_grad_norm)
    self.optimizer.step()

  def _adapt_rate(self, kl: Tensor) -> None:
    """Divide the learning rate by 1.5 above twice the desired KL divergence, multiply it below half."""
    rate, desired = self._rate, self.desired_kl
    slower, faster = (rate / 1.5).clamp(min=1e-5), (rate * 1.5).clamp(max=1e-2)
    rate.copy_(torch.where(kl > 2.0 * desired, slower, torch.where((kl < 0.5 * desired) & (kl > 0.0), faster, rate)))
