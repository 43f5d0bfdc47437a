"""Rewards: a weighted sum of terms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from itertools import compress
from typing import Any

import torch
from mjlab_core import Finite, check_value, fill_

from mjlab_managers.env import ManagerEnv
from mjlab_managers.terms.term import ManagerTermBaseCfg
from mjlab_managers.vector_manager import VectorManager


@dataclass
class RewardTermCfg(ManagerTermBaseCfg):
  """Config of a reward: `func(env, **params)` returns float (N,)."""

  _: KW_ONLY
  weight: Finite
  """Factor of the term, which may be changed at any time. A term with weight 0 is not evaluated."""


class RewardManager(VectorManager[RewardTermCfg]):
  """Weighted sum of reward terms. NaN and infinite values become 0 and are counted.

  Args:
    cfgs: reward terms by name.
    env: the environment.
    scale_by_dt: multiply rewards by the step time, so that weights are rates per second.
    problems: as for `ManagerBase`.
  """

  cfg_type = RewardTermCfg
  live_fields = frozenset({"weight"})

  def __init__(
    self,
    cfgs: Mapping[str, RewardTermCfg | None],
    env: ManagerEnv,
    *,
    scale_by_dt: bool = True,
    problems: list[str] | None = None,
  ) -> None:
    self.scale_by_dt = scale_by_dt
    super().__init__(cfgs, env, problems=problems)

  def _make(self) -> None:
    self._scale = self.env.step_dt if self.scale_by_dt else 1.0
    self._host_weights = self._read_weights()
    weights = torch.tensor([list(self._host_weights.values())], dtype=torch.float32, device=self.device)
    self._weights = self.state_of(weights, shared=True)
    # Terms with a weight that is set on the device. The host cannot know if it is 0.
    self._on_device: set[str] = set()
    self._active = self._read_active()

    self.reward = self.state()
    """Reward of the last step, (N,)."""
    self._idle = torch.zeros(self.num_envs, device=self.device)
    self._lay_out("reward")
    self._shown = self.step_reward = torch.zeros_like(self._values)
    """Value times weight of each term in the last step, (N, R), not scaled by the step time."""
    self.episode_sums = self.state((len(self._terms),))
    """Sum of the contribution of each term over the running episode, (N, R)."""

  def weight(self, name: str) -> torch.Tensor:
    """Return the weight of a term on the device, 0-d, that curricula may write inside the step.

    After this call the term is always evaluated. The config of the term does not show such writes.
    """
    index = self._column(name)
    self._on_device.add(name)
    self._update_activity()
    return self._weights[0, index]

  def compute(self) -> torch.Tensor:
    """Evaluate the step and return `reward`, (N,), always the same memory."""
    if not self._terms:
      return self.reward
    values = iter(self.evaluate(list(compress(self._terms.values(), self._active))))
    finite = self._put([next(values) if active else self._idle for active in self._active])
    torch.mul(finite, self._weights, out=self.step_reward)
    self.episode_sums.add_(self.step_reward, alpha=self._scale)
    torch.sum(self.step_reward, dim=1, out=self.reward)
    if self.scale_by_dt:
      self.reward.mul_(self._scale)
    return self.reward

  def reset(self, mask: torch.Tensor) -> None:
    """Log the episode sums of the worlds in `mask`, bool (N,), and set them to zero."""
    if not self._terms:
      return
    # An episode without a step has no statistics.
    self._log.add(self.episode_sums, mask & (self.env.episode_length_buf > 0))
    fill_(self.episode_sums, mask, 0.0)
    super().reset(mask)

  def sync(self) -> None:
    """Read changed weights from the configs, on the host before each step."""
    weights = self._read_weights()
    changed = [name for name, weight in weights.items() if weight != self._host_weights[name]]
    if not changed:
      return
    for name in changed:
      with self._noting(name):
        check_value("weight", weights[name], Finite)
    self._report()
    self._host_weights = weights
    self._write_weights(changed)
    self._update_activity()

  def restore(self, state: Mapping[str, Any], mask: torch.Tensor | None = None) -> None:
    super().restore(state, mask)
    # A weight from the config takes precedence; only weights that curricula set on the device are part of the state.
    self._write_weights(name for name in self._terms if name not in self._on_device)

  def _read_weights(self) -> dict[str, float]:
    return {name: cfg.weight for name, cfg in self._cfgs.items()}

  def _write_weights(self, names: Iterable[str]) -> None:
    for name in names:
      self._weights[0, self._column(name)].fill_(self._host_weights[name])

  def _read_active(self) -> list[bool]:
    return [weight != 0.0 or name in self._on_device for name, weight in self._host_weights.items()]

  def _update_activity(self) -> None:
    before, self._active = self._active, self._read_active()
    if changed := [name for name, new, old in zip(self._terms, self._active, before, strict=True) if new != old]:
      self.env.request_recapture(f"{self.label}: terms switched on or off: {', '.join(changed)}")

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return `Episode_Reward/<term>` and `Nonfinite/reward/<term>`.

    The first is the mean of the episode sums over ended episodes, divided by the greatest episode length [s]; it is not
    divided if episodes have no greatest length (0). The second is the number of values replaced by 0, or NaN if there
    were none.
    """
    names, values = super().log_tensors()
    values[: len(self._terms)] /= self.env.max_episode_length_s or 1.0
    return names, values
