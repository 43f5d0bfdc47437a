"""Mirror images of transitions, for robots whose left and right sides are alike."""

from collections.abc import Mapping, Sequence

import torch

Mirror = tuple[Sequence[int], Sequence[float]]
"""Columns and signs: column i of the mirror image is column `columns[i]` times `signs[i]`."""


class Reflection:
  """Mirror images of observations, all groups side by side, and of actions.

  Args:
    mirrors: Mirror by observation group, and "action".
    groups: Observation groups in the order of their columns.
    device: Device of the observations.
  """

  def __init__(self, mirrors: Mapping[str, Mirror], groups: Sequence[str], device: torch.device | str) -> None:
    columns: list[int] = []
    signs: list[float] = []
    for group in groups:
      start = len(columns)
      columns += [start + column for column in mirrors[group][0]]
      signs += mirrors[group][1]
    self._obs = (torch.tensor(columns, device=device), torch.tensor(signs, device=device))
    action = mirrors["action"]
    self._action = (torch.tensor(list(action[0]), device=device), torch.tensor(list(action[1]), device=device))

  def obs(self, obs: torch.Tensor) -> torch.Tensor:
    """Return observations and after them their mirror images, (2 batch, width)."""
    return torch.cat((obs, obs[:, self._obs[0]] * self._obs[1]))

  def action(self, action: torch.Tensor) -> torch.Tensor:
    """Return actions and after them their mirror images, (2 batch, num_actions)."""
    return torch.cat((action, action[:, self._action[0]] * self._action[1]))
