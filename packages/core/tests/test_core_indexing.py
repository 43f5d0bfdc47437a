"""An index selects what its ids select, as a view where it can."""

from itertools import pairwise

import pytest
import torch
from mjlab_core.indexing import as_index, as_slice, rows_of_worlds, select


@pytest.mark.parametrize("ids", [[], [4], [0, 1, 2], [1, 3, 5], [0, 6], [2, 1], [1, 2, 4], [3, 3], [0, 4, 2]], ids=str)
def test_an_index_selects_its_ids_in_their_order(ids: list[int]) -> None:
  tensor = torch.arange(14.0).reshape(2, 7)
  index = as_index(ids, "cpu")
  assert torch.equal(select(tensor, index), tensor[:, torch.tensor(ids, dtype=torch.int64)])
  assert isinstance(index, slice) == (as_slice(ids) is not None)


def test_contiguous_ids_select_a_view() -> None:
  tensor = torch.zeros(2, 7)
  select(tensor, as_index([1, 2], "cpu")).fill_(1.0)
  assert tensor[0].tolist() == [0, 1, 1, 0, 0, 0, 0]


@pytest.mark.parametrize("ids", [[1, 4], [0, 2, 4], [3], [4, 1], [0, 1, 3]], ids=str)
def test_evenly_spaced_ids_are_a_slice_where_that_is_asked_for(ids: list[int]) -> None:
  found = as_slice(ids, spaced=True)
  steps = {b - a for a, b in pairwise(ids)}
  assert (found is not None) == (len(steps) < 2 and all(step > 0 for step in steps))
  assert found is None or list(range(7))[found] == ids


def test_rows_of_some_worlds_become_rows_of_all_with_their_mask():
  rows, mask = rows_of_worlds(torch.tensor([[1.0, 2.0], [3.0, 4.0]]), torch.tensor([3, 1]), 4)
  assert rows.tolist() == [[0, 0], [3, 4], [0, 0], [1, 2]]
  assert mask.tolist() == [False, True, False, True]
