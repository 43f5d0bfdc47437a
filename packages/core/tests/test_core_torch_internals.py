"""Private names of torch: listed in one module with their reasons, and replaceable."""

import functools
import importlib

import pytest
import torch
from mjlab_core import torch_internals
from torch.utils import _python_dispatch


def test_every_private_name_has_a_reason_and_exists() -> None:
  for path, reason in torch_internals.PRIVATE.items():
    assert len(reason.split()) > 4, path
    assert functools.reduce(getattr, path.split(".")[1:], torch) is not None
  assert torch_internals.COUNTS_WRITES
  assert torch_internals.SEES_OPERATIONS


def test_writes_are_counted_for_tensors_that_own_their_memory() -> None:
  tensor = torch.zeros(3)
  before = torch_internals.writes_to(tensor), torch_internals.version_of(tensor)
  tensor[1:].add_(1.0)
  assert (torch_internals.writes_to(tensor), torch_internals.version_of(tensor)) == (before[0] + 1, before[1] + 1)
  assert torch_internals.writes_to(tensor[1:]) == 0


def test_without_counters_every_read_counts_as_after_a_write_and_no_write_is_reported(
  monkeypatch: pytest.MonkeyPatch,
) -> None:
  tensor = torch.zeros(1)
  assert torch_internals.always_new(tensor) != torch_internals.always_new(tensor)
  monkeypatch.setattr(torch_internals, "COUNTS_WRITES", False)
  assert torch_internals.writes_to(tensor.add_(1.0)) == 0


def test_without_other_names_modes_see_nothing_and_results_keep_their_class() -> None:
  with pytest.MonkeyPatch.context() as patch:
    patch.delattr(_python_dispatch, "TorchDispatchMode")
    patch.delattr(torch._C, "_disabled_torch_function_impl")
    module = importlib.reload(torch_internals)
    assert not module.SEES_OPERATIONS
    assert module.PLAIN_RESULTS is None
    with module.OperationMode():
      torch.zeros(1).add_(1.0)
  importlib.reload(torch_internals)
