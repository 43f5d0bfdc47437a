"""Stateful finds what is remembered, and loads it back in place or not at all."""

import pytest
import torch
from mjlab_core import StateError, Stateful


class Leaf(Stateful):
  _constants = frozenset({"scale"})

  def __init__(self, value: float = 0.0, num_envs: int = 3) -> None:
    self.num_envs = num_envs
    self.memory = torch.full((num_envs, 2), value)
    self.scale = torch.full((num_envs,), value)
    self.row = torch.zeros(1, 2)


class Tree(Leaf):
  _constants = frozenset({"fixed"})
  _extra_state = ("clock",)
  _children = ("leaf", "table", "chain", "nothing")

  def __init__(self, value: float = 0.0) -> None:
    super().__init__(value)
    self.fixed = torch.full((3,), value)
    self.clock = torch.full((), value)
    self.leaf, self.nothing = Leaf(value), None
    self.table, self.chain = {"a": Leaf(value)}, [Leaf(value), Leaf(value + 1)]


def test_state_is_every_world_sized_tensor_except_constants_through_the_bases() -> None:
  state = Tree(2.0).state_dict()
  assert list(state) == ["memory", "clock", "leaf", "table", "chain"]
  assert list(state["leaf"]) == ["memory"]
  assert list(state["chain"]) == ["0", "1"]


def test_loading_writes_in_place_and_gives_back_clones() -> None:
  source, target = Tree(2.0), Tree()
  addresses = target.memory.data_ptr(), target.chain[1].memory.data_ptr()
  state = source.state_dict()
  source.memory.zero_()
  target.load_state_dict(state)
  assert (target.memory.data_ptr(), target.chain[1].memory.data_ptr()) == addresses
  assert (target.memory == 2.0).all()
  assert target.clock == 2.0
  assert (target.chain[1].memory == 3.0).all()
  assert (target.scale == 0.0).all()


def test_what_does_not_fit_is_named_and_nothing_is_written() -> None:
  target = Tree()
  state = Tree(2.0).state_dict()
  state["chain"]["1"]["memory"] = torch.zeros(4, 2)
  for call in (target.check_state_dict, target.load_state_dict):
    with pytest.raises(StateError, match=r"Tree\.chain\.1\.memory: saved shape \(4, 2\), here \(3, 2\)"):
      call(state)
  target.check_state_dict(Tree(2.0).state_dict())
  assert (target.memory == 0.0).all()

  missing = Tree(2.0).state_dict()
  del missing["clock"]
  with pytest.raises(StateError, match=r"Tree\.clock: missing from the saved state"):
    target.load_state_dict(missing)

  extra = Tree(2.0).state_dict() | {"memry": torch.zeros(3, 2)}
  with pytest.raises(StateError, match=r"Tree: saved entry 'memry' does not exist\. Nearest: memory"):
    target.load_state_dict(extra)

  kind = Tree(2.0).state_dict() | {"clock": torch.zeros((), dtype=torch.int64)}
  with pytest.raises(StateError, match=r"Tree\.clock: saved dtype torch\.int64, here torch\.float32"):
    target.load_state_dict(kind)


def test_taking_back_leaves_the_masked_worlds_as_they_are_now() -> None:
  tree = Tree(1.0)
  before = tree.state_dict()
  for tensor in (tree.memory, tree.clock, tree.leaf.memory, tree.chain[1].memory, tree.leaf.scale):
    tensor.fill_(7.0)
  tree.take_back(before, torch.tensor([False, True, False]))
  for tensor, old in ((tree.memory, 1.0), (tree.leaf.memory, 1.0), (tree.chain[1].memory, 2.0)):
    assert tensor[:, 0].tolist() == [old, 7.0, old]
  assert tree.clock == 1.0
  assert (tree.leaf.scale == 7.0).all()


def test_precision_may_differ_between_save_and_load() -> None:
  target = Leaf()
  target.load_state_dict({"memory": torch.ones(3, 2, dtype=torch.float64)})
  assert target.memory.dtype == torch.float32
  assert (target.memory == 1.0).all()
