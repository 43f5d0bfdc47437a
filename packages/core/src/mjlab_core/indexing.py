"""Selection of elements by ids and of worlds by masks.

Contiguous ids become a slice, which selects a view. Writes through a mask are in place and leave the other worlds
bit-identical.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

Index = slice | Tensor
"""A slice, or an int64 tensor on the device of the indexed tensor."""


def as_slice(ids: Iterable[int], *, spaced: bool = False) -> slice | None:
  """Return the slice that selects `ids` in their order, or None if no slice does.

  Args:
    ids: Ids, ascending by 1, or by any even step if `spaced`.
    spaced: Accept steps above 1, as for components of a vector field.
  """
  numbers = [int(i) for i in ids]
  if not numbers:
    return slice(0, 0)
  first, last = numbers[0], numbers[-1]
  if numbers == list(range(first, last + 1)):
    return slice(first, last + 1)
  step = numbers[1] - first if spaced else 0
  return slice(first, last + 1, step) if step > 0 and numbers == list(range(first, last + 1, step)) else None


def as_index(ids: Iterable[int], device: torch.device | str) -> Index:
  """Return the slice that selects `ids` along a dimension, else an int64 tensor on `device`."""
  numbers = [int(i) for i in ids]
  found = as_slice(numbers)
  return torch.tensor(numbers, dtype=torch.int64, device=device) if found is None else found


def select(tensor: Tensor, index: Index) -> Tensor:
  """Return `tensor[:, index]`: a view for a slice, a copy for a tensor."""
  return tensor[:, index] if isinstance(index, slice) else tensor.index_select(1, index)


def where_(dst: Tensor, mask: Tensor, src: Tensor | float) -> Tensor:
  """Write `src` into the rows of `dst` where `mask` is true, in place; return `dst`.

  Args:
    dst: (num_envs, ...), kept in its memory.
    mask: bool (num_envs,), broadcast over the trailing dimensions of `dst`; or any leading part of its shape.
    src: a number, or a tensor that broadcasts to `dst`.

  Raises:
    TypeError: `mask` is not a bool tensor.
  """
  mask = _trailing(mask, dst)
  if not isinstance(src, Tensor):
    return dst.masked_fill_(mask, src)
  if src.shape != dst.shape:
    src = src.expand(dst.shape)
  torch.where(mask, src if src.dtype == dst.dtype else src.to(dst.dtype), dst, out=dst)
  return dst


def rows_of_worlds(values: Tensor, env_ids: Tensor, num_envs: int) -> tuple[Tensor, Tensor]:
  """Return `values` of some worlds as (num_envs, ...), zero elsewhere, and the mask of these worlds, bool (num_envs,).

  Methods that write through a mask take both: `entity.write_root_state(*rows_of_worlds(state, env_ids, env.num_envs))`.

  Args:
    values: One row for each of `env_ids`, (len(env_ids), ...).
    env_ids: World numbers, int64 (len(env_ids),).
    num_envs: Number of worlds.
  """
  rows = values.new_zeros((num_envs, *values.shape[1:]))
  rows[env_ids] = values
  mask = torch.zeros(num_envs, dtype=torch.bool, device=values.device)
  mask[env_ids] = True
  return rows, mask


def fill_(dst: Tensor, mask: Tensor, value: float) -> Tensor:
  """Write one number into the rows of `dst`, (num_envs, ...), where `mask`, bool (num_envs,), is true.

  Raises:
    TypeError: `mask` is not a bool tensor.
  """
  return dst.masked_fill_(_trailing(mask, dst), value)


def _trailing(mask: Tensor, like: Tensor) -> Tensor:
  if not isinstance(mask, Tensor) or mask.dtype is not torch.bool:
    what = f"{mask.dtype} {tuple(mask.shape)}" if isinstance(mask, Tensor) else type(mask).__name__
    raise TypeError(f"`mask` must be a bool tensor of shape (num_envs,), got {what}; convert env ids first")
  return mask.reshape(mask.shape + (1,) * (like.dim() - mask.dim())) if like.dim() > mask.dim() else mask
