"""What the tests of this package share."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from torch.utils._python_dispatch import TorchDispatchMode

# The tests share a module.
sys.path.insert(0, str(Path(__file__).parent))


class _Counter(TorchDispatchMode):
  def __init__(self) -> None:
    super().__init__()
    self.count = 0

  def __torch_dispatch__(self, func, types, args=(), kwargs=None):
    self.count += not func.is_view
    return func(*args, **(kwargs or {}))


@pytest.fixture
def count_operations() -> Callable[[Callable[[], object]], int]:
  """Number of torch operations that a call makes; views are not counted, for they are free on a device."""

  def count(work: Callable[[], object]) -> int:
    with _Counter() as counter:
      work()
    return counter.count

  return count
