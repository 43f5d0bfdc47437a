"""Stateful: what is declared is saved, restored, reset, and cannot be replaced."""

import copy
from typing import Any

import pytest
import torch
from mjlab_core import HistoryBuffer, MjlabError, Stateful, StatefulDict, where_

SECOND = torch.tensor([False, True, False])


class Leaf(Stateful):
  window: HistoryBuffer
  other: Any
  rows: torch.Tensor
  friend: Any
  lost: Any

  def __init__(self, value: float = 0.0, num_envs: int = 3) -> None:
    self.num_envs, self.device = num_envs, torch.device("cpu")
    self.memory = self.state((2,), fill=value)
    # Neither is declared: constants of any shape are no state, with one world or with many.
    self.scale = torch.full((num_envs,), value)
    self.row = torch.zeros(1, 2)


class Tree(Leaf):
  def __init__(self, value: float = 0.0) -> None:
    super().__init__(value)
    self.clock = self.state(fill=value, shared=True)
    self.leaf: Any = Leaf(value)
    self.nothing = None
    self.table = StatefulDict({"a": Leaf(value), "b": Leaf(value + 1)})


def test_state_consists_of_declared_tensors_here_and_in_children() -> None:
  state = Tree(2.0).state_dict()
  assert list(state) == ["memory", "clock", "leaf", "table"]
  assert list(state["leaf"]) == ["memory"]
  assert list(state["table"]) == ["a", "b"]
  assert list(Leaf(num_envs=1).state_dict()) == ["memory"]


def test_loading_writes_in_place_and_gives_back_clones() -> None:
  source, target = Tree(2.0), Tree()
  addresses = target.memory.data_ptr(), target.table["b"].memory.data_ptr()
  state = source.state_dict()
  source.memory.zero_()
  target.load_state_dict(state)
  assert (target.memory.data_ptr(), target.table["b"].memory.data_ptr()) == addresses
  assert (target.memory == 2.0).all()
  assert target.clock == 2.0
  assert (target.table["b"].memory == 3.0).all()
  assert (target.scale == 0.0).all()


def test_state_that_does_not_fit_is_named_and_nothing_is_written() -> None:
  target = Tree()
  state = Tree(2.0).state_dict()
  state["table"]["b"]["memory"] = torch.zeros(4, 2)
  with pytest.raises(MjlabError, match=r"Tree\.table\.b\.memory: saved shape \(4, 2\), here \(3, 2\)"):
    target.load_state_dict(state)
  assert list(target.state_problems(Tree(2.0).state_dict())) == []
  assert (target.memory == 0.0).all()

  good = Tree(2.0).state_dict()
  without_clock = {name: value for name, value in good.items() if name != "clock"}
  for wrong, message in (
    (without_clock, r"Tree\.clock: missing from the saved state"),
    (good | {"memry": torch.zeros(3, 2)}, r"Tree: saved entry 'memry' does not exist\. Nearest: memory"),
    (good | {"clock": torch.zeros((), dtype=torch.int64)}, r"Tree\.clock: saved dtype torch\.int64, here"),
    (good | {"leaf": 3}, r"Tree\.leaf: expected a mapping, got int"),
    (good | {"memory": [1.0]}, r"Tree\.memory: expected a tensor, got list"),
  ):
    with pytest.raises(MjlabError, match=message):
      target.load_state_dict(wrong)


def test_restoring_some_worlds_leaves_the_others_and_restores_shared_state() -> None:
  tree = Tree(1.0)
  before = tree.state_dict()
  for tensor in (tree.memory, tree.clock, tree.leaf.memory, tree.table["b"].memory, tree.leaf.scale):
    tensor.fill_(7.0)
  tree.restore(before, ~SECOND)
  for tensor, old in ((tree.memory, 1.0), (tree.leaf.memory, 1.0), (tree.table["b"].memory, 2.0)):
    assert tensor[:, 0].tolist() == [old, 7.0, old]
  assert tree.clock == 1.0
  assert (tree.leaf.scale == 7.0).all()


def test_refill_writes_initial_values_into_masked_worlds_only() -> None:
  tree = Tree(1.0)
  existing = torch.full((3,), 1.0)
  tree.other = tree.state_of(existing)
  tree.window = HistoryBuffer(2, 3, (), "cpu")
  tree.window.append(torch.full((3,), 5.0))
  for tensor in (tree.memory, tree.clock, tree.table["b"].memory, existing):
    tensor.fill_(7.0)
  tree.refill(SECOND)
  assert tree.memory[:, 0].tolist() == [7.0, 1.0, 7.0]
  assert tree.table["b"].memory[:, 0].tolist() == [7.0, 2.0, 7.0]
  assert tree.window.read()[:, 1].tolist() == [5.0, 0.0, 5.0]
  assert tree.clock == 7.0
  assert existing.tolist() == [7.0] * 3
  tree.rows = tree.state(fill=torch.tensor([1.0, 2.0, 3.0]))
  tree.rows.zero_()
  tree.refill(SECOND)
  assert tree.rows.tolist() == [0.0, 2.0, 0.0]


def test_declared_state_cannot_be_replaced_and_in_place_writes_stay_allowed() -> None:
  """Class: rebinding state, which on a GPU would write to an address that the recorded step does not know."""
  leaf = Leaf(1.0)
  address = leaf.memory.data_ptr()
  for wrong in (torch.where(SECOND[:, None], leaf.memory, 0.0), None, 3.0, Leaf()):
    with pytest.raises(MjlabError, match=r"Leaf: the state 'memory' cannot be replaced.*copy_\(x\).*where_\("):
      setattr(leaf, "memory", wrong)  # noqa: B010
  leaf.memory += 1.0
  leaf.memory = where_(leaf.memory, SECOND, 0.0)
  assert leaf.memory.data_ptr() == address
  assert leaf.memory[:, 0].tolist() == [2.0, 0.0, 2.0]


def test_state_that_is_not_assigned_to_an_attribute_is_refused() -> None:
  leaf = Leaf()
  leaf.lost = {"x": leaf.state((4,))}
  with pytest.raises(MjlabError, match=r"Leaf: state of shape \(3, 4\) is not an attribute"):
    leaf.state_dict()


def test_state_before_the_base_class_is_initialised_is_refused_by_name() -> None:
  class Early(Stateful):
    def __init__(self) -> None:
      self.peak = self.state()

  with pytest.raises(MjlabError, match=r"Early: call super\(\).__init__\(env\) before declaring state"):
    Early()


def test_an_object_has_one_owner_and_other_holders_only_refer_to_it() -> None:
  owner, other = Tree(), Leaf()
  other.friend, other.table = owner.leaf, owner.table
  assert list(other.state_dict()) == ["memory"]
  owner.leaf = None
  assert "leaf" not in owner.state_dict()
  other.friend = other.friend
  assert "friend" in other.state_dict()


def test_copies_have_separate_state() -> None:
  tree = Tree(1.0)
  twin = copy.deepcopy(tree)
  twin.memory.fill_(5.0)
  assert (tree.memory == 1.0).all()
  assert (twin.state_dict()["memory"] == 5.0).all()


def test_precision_may_differ_between_save_and_load() -> None:
  target = Leaf()
  target.load_state_dict({"memory": torch.ones(3, 2, dtype=torch.float64)})
  assert target.memory.dtype == torch.float32
  assert (target.memory == 1.0).all()
