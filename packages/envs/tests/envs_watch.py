"""What a step asks of torch."""

import torch
from torch.utils._python_dispatch import TorchDispatchMode


class Watch(TorchDispatchMode):
  """Counts operations and notes those that wait for a device."""

  def __init__(self) -> None:
    super().__init__()
    self.count = 0
    self.waits: list[str] = []

  def __torch_dispatch__(self, func, types, args=(), kwargs=None):
    name = func.overloadpacket.__name__
    if name in ("_local_scalar_dense", "nonzero", "item", "is_nonzero", "masked_select", "equal", "unique"):
      self.waits.append(name)
    if any(
      isinstance(x, list | tuple) and any(isinstance(i, torch.Tensor) and i.dtype == torch.bool for i in x)
      for x in args
    ) and name.startswith("index"):
      self.waits.append(name)
    self.count += not func.is_view
    return func(*args, **(kwargs or {}))
