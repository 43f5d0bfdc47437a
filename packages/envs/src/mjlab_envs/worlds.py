"""Which worlds a caller means."""

from collections.abc import Sequence

import torch


def select_worlds(env_ids: torch.Tensor | Sequence[int] | None, num_envs: int, device: torch.device) -> torch.Tensor:
  """The bool mask (num_envs,) of a mask, of world numbers, or of all worlds (None).

  Raises:
    ValueError: a mask of another length, numbers out of range, or something that is neither.
  """
  if env_ids is None:
    return torch.ones(num_envs, dtype=torch.bool, device=device)
  chosen = torch.as_tensor(env_ids, device=device)
  if chosen.dtype == torch.bool:
    if chosen.shape != (num_envs,):
      raise ValueError(f"a mask of worlds must have shape ({num_envs},), got {tuple(chosen.shape)}")
    return chosen.clone()
  mask = torch.zeros(num_envs, dtype=torch.bool, device=device)
  if chosen.numel() == 0:
    return mask
  if chosen.is_floating_point() or chosen.dim() != 1:
    raise ValueError(f"world numbers must be whole and in one row, got {chosen.dtype} of shape {tuple(chosen.shape)}")
  outside = chosen[(chosen < 0) | (chosen >= num_envs)]
  if outside.numel():
    raise ValueError(f"world {int(outside[0])} does not exist; there are worlds 0 to {num_envs - 1}")
  mask[chosen.long()] = True
  return mask
