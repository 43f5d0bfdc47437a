"""Several teachers of one student, each responsible for some of the worlds."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from mjlab_core.errors import ConfigError
from rsl_rl.utils import resolve_class
from tensordict import TensorDict
from torch import nn

GROUP = "teacher_index"
"""Key of `agent.obs_groups` for the observation group with the number of each world's teacher."""


class Teachers(nn.ModuleList):
  """Networks of one kind; each world learns the actions of one of them.

  Without the key `teacher_index` in `obs_groups`, worlds take turns: of two teachers, the first has worlds 0, 2, 4 and
  so on. All networks see all worlds, so memory and work are fixed, and the choice is a mask.

  Args:
    obs: Observations by group.
    obs_groups: Groups of each network.
    obs_set: Name of these networks, "teacher".
    output_dim: Number of actions.
    network: Class and arguments of the networks, as rsl-rl takes them.
    count: Number of teachers.

  Raises:
    ConfigError: The group of `teacher_index` has more than one number for each world, or another one than 0 to
      count - 1.
  """

  def __init__(
    self,
    obs: TensorDict,
    obs_groups: Mapping[str, Sequence[str]],
    obs_set: str,
    output_dim: int,
    *,
    network: dict[str, Any],
    count: int,
  ) -> None:
    kind, options = resolve_class(network)
    super().__init__(kind(obs, obs_groups, obs_set, output_dim, **options) for _ in range(count))
    groups = obs_groups.get(GROUP, ())
    self._group = groups[0] if groups else None
    self._turns: torch.Tensor
    self.register_buffer("_turns", torch.arange(obs.batch_size[0])[:, None] % count, persistent=False)
    if self._group is None:
      return
    where, index = f"observation group '{self._group}' of agent.obs_groups['{GROUP}']", obs[self._group]
    if len(groups) > 1 or index.shape != self._turns.shape:
      raise ConfigError(f"{where} has shape {tuple(index.shape)}; it must be one number for each world")
    if wrong := sorted(set(index.flatten().tolist()) - set(range(count))):
      raise ConfigError(f"{where} has {wrong[0]:g}; the {count} teachers are 0 to {count - 1}")

  obs_normalization = False
  """Teachers no longer learn from observations."""

  def forward(self, obs: TensorDict) -> torch.Tensor:
    """Return the action of each world's teacher, (num_envs, num_actions); the first for an unknown number."""
    index = self._turns if self._group is None else obs[self._group]
    first, *others = [network(obs) for network in self]
    for number, actions in enumerate(others, 1):
      first = torch.where(index == number, actions, first)
    return first

  def reset(self, dones: torch.Tensor | None = None, hidden_state: Sequence[Any] | None = None) -> None:
    """Clear the hidden states of worlds that are done, (num_envs,), or of all (None), or set those of each network."""
    networks: list[Any] = list(self)
    for network, hidden in zip(networks, hidden_state or [None] * len(networks), strict=True):
      network.reset(dones, hidden)

  def get_hidden_state(self) -> list[Any]:
    """Return the hidden state of each network; None for a network without."""
    networks: list[Any] = list(self)
    return [network.get_hidden_state() for network in networks]
