"""In-place writes to the worlds of a mask; the others stay bit-identical."""

from __future__ import annotations

import torch
from torch import Tensor


def where_(dst: Tensor, mask: Tensor, src: Tensor | float) -> Tensor:
  """Writes `src` into the rows of `dst` where `mask` is true, in place, and returns `dst`.

  Args:
    dst: (num_envs, ...), kept in its memory.
    mask: bool (num_envs,), broadcast over the trailing dimensions of `dst`; or any leading part of its shape.
    src: a number, or a tensor that broadcasts to `dst`.

  Raises:
    TypeError: `mask` is not of bools: of world numbers, say.
  """
  mask = _trailing(mask, dst)
  if not isinstance(src, Tensor):
    return dst.masked_fill_(mask, src)
  if src.shape != dst.shape:
    src = src.expand(dst.shape)
  torch.where(mask, src if src.dtype == dst.dtype else src.to(dst.dtype), dst, out=dst)
  return dst


def fill_(dst: Tensor, mask: Tensor, value: float) -> Tensor:
  """Writes one number into the rows of `dst`, (num_envs, ...), where `mask`, bool (num_envs,), is true.

  Raises:
    TypeError: `mask` is not of bools: of world numbers, say.
  """
  return dst.masked_fill_(_trailing(mask, dst), value)


def _trailing(mask: Tensor, like: Tensor) -> Tensor:
  if not isinstance(mask, Tensor) or mask.dtype is not torch.bool:
    what = f"{mask.dtype} {tuple(mask.shape)}" if isinstance(mask, Tensor) else type(mask).__name__
    raise TypeError(f"a mask is a tensor with one bool for each world, not {what}; of world numbers make one")
  return mask.reshape(mask.shape + (1,) * (like.dim() - mask.dim())) if like.dim() > mask.dim() else mask
