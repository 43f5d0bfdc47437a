"""A randomiser on many worlds behind the protocol: masks, fixed memory, no sync, once-only recomputation."""

from collections.abc import Iterable
from types import SimpleNamespace

import mujoco
import pytest
import torch
from mjlab_core import make_generator
from mjlab_dr import (
  FieldRandomizer,
  ModelFields,
  RandomizeField,
  apply_all,
  body_com_offset,
  encoder_bias,
  geom_friction,
)
from torch.utils._python_dispatch import TorchDispatchMode

XML = """
<mujoco>
  <worldbody>
    <body name="a/trunk">
      <freejoint/><geom name="a/trunk" size=".1" condim="4"/>
      <body name="a/arm" pos=".3 0 0">
        <joint name="a/j"/><geom name="a/f1" size=".1"/><geom name="a/f2" size=".1"/>
      </body>
      <body name="a/leg" pos="0 .3 0">
        <joint name="a/k"/><geom name="a/g" size=".1"/><geom name="a/f3" size=".1"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""
N = 6


class FakeSim:
  """The protocol and nothing more, counting what it is asked."""

  def __init__(self) -> None:
    self.mj_model = mujoco.MjModel.from_xml_string(XML)
    self.num_envs, self.device = N, torch.device("cpu")
    self.model = SimpleNamespace(**{n: self.default_field(n) for n in ("geom_friction", "body_ipos")})
    self.recomputed: list[torch.Tensor | None] = []

  def expand_model_fields(self, names: Iterable[str], /) -> None:
    for name in names:
      if getattr(self.model, name).shape[0] == 1:
        setattr(self.model, name, self.default_field(name).repeat(N, 1, 1))

  def default_field(self, name: str, /) -> torch.Tensor:
    return torch.tensor(getattr(self.mj_model, name)).unsqueeze(0)

  def recompute_constants(self, mask: torch.Tensor | None = None, /) -> None:
    self.recomputed.append(mask)


class NoSync(TorchDispatchMode):
  """Refuses operations that wait for the device, or make tensors of host data."""

  def __torch_dispatch__(self, func, types, args=(), kwargs=None):
    name = func.overloadpacket.__name__
    assert name not in {"nonzero", "_local_scalar_dense", "masked_select", "lift_fresh", "is_nonzero"}, name
    return func(*args, **(kwargs or {}))


CFGS = [
  geom_friction("a/f.", (0.3, 1.2)),
  geom_friction("a/f1", {0: (0.3, 1.2), 1: (0.01, 0.02)}, shared=True),
  geom_friction("a/f1|a/f2", (0.5, 2.0), operation="scale"),
  body_com_offset("a/trunk", {"x": (-0.1, 0.1), "z": (-0.1, 0.1)}),
  body_com_offset("a/(trunk|leg)", (-0.1, 0.1), distribution="gaussian"),
]


@pytest.fixture
def sim() -> FakeSim:
  return FakeSim()


def bound(cfg: FieldRandomizer, sim: ModelFields, seed: int = 0) -> RandomizeField:
  return RandomizeField(cfg, sim, generator=make_generator("cpu", seed))


@pytest.mark.parametrize("cfg", CFGS, ids=lambda c: c.label)
def test_apply_writes_masked_worlds_only_in_place_and_without_a_sync(cfg: FieldRandomizer, sim: FakeSim) -> None:
  term = bound(cfg, sim)
  tensor = getattr(sim.model, cfg.field)
  assert tensor.shape[0] == N
  before, address, version = tensor.clone(), tensor.data_ptr(), tensor._version
  mask = torch.tensor([True, False, True, True, False, False])
  with NoSync():
    term.apply(mask)
  assert getattr(sim.model, cfg.field).data_ptr() == address
  assert tensor._version > version
  assert torch.equal(tensor[~mask], before[~mask])
  assert (term.values()[mask] != term.default).all()
  assert torch.equal(term.values()[~mask], term.default.expand(3, -1))


@pytest.mark.parametrize("cfg", CFGS, ids=lambda c: c.label)
def test_what_a_world_draws_does_not_depend_on_who_else_does(cfg: FieldRandomizer) -> None:
  alone, together = bound(cfg, FakeSim()), bound(cfg, FakeSim())
  for step in range(5):
    mask = torch.arange(N) == step
    alone.apply(mask)
    together.apply(mask | (torch.arange(N) > 3))
  assert torch.equal(alone.values()[:3], together.values()[:3])


def test_repeats_start_from_the_default(sim: FakeSim) -> None:
  term = bound(geom_friction("a/f1|a/f2", (0.5, 2.0), operation="scale"), sim)
  for _ in range(100):
    term.apply(torch.ones(N, dtype=torch.bool))
    assert ((term.values() >= 0.5) & (term.values() <= 2.0)).all()


def test_derived_fields_are_recomputed_once_for_all_and_only_where_needed(sim: FakeSim) -> None:
  mask = torch.ones(N, dtype=torch.bool)
  friction, com = bound(CFGS[0], sim), bound(CFGS[3], sim)
  friction.apply(mask)
  assert sim.recomputed == []
  com.apply(mask)
  assert len(sim.recomputed) == 1
  apply_all([friction, com, bound(body_com_offset("a/leg", (0.0, 0.1)), sim)], sim, mask)
  assert len(sim.recomputed) == 2
  assert sim.recomputed[-1] is mask


def test_an_entity_gives_its_own_names_and_ids(sim: FakeSim) -> None:
  term = RandomizeField(geom_friction("f2|f3", (0.3, 0.4)), sim, names=["f3", "f2"], ids=[4, 2], owner="event 'foot'")
  term.apply(torch.ones(N, dtype=torch.bool))
  touched = (sim.model.geom_friction != sim.default_field("geom_friction")).nonzero()[:, 1].unique()
  assert touched.tolist() == [2, 4]
  with pytest.raises(ValueError, match="event 'foot': geom_friction: pattern 'f9' matches no geom"):
    RandomizeField(geom_friction("f9", (0.3, 0.4)), sim, names=["f3"], ids=[4], owner="event 'foot'")


def test_a_field_outside_of_the_model_is_written_to_its_target(sim: FakeSim) -> None:
  bias = torch.zeros(N, 2)
  cfg = encoder_bias("k", (0.01, 0.02))
  RandomizeField(cfg, sim, names=["j", "k"], target=bias).apply(torch.arange(N) < 3)
  assert (bias[:3, 1] >= 0.01).all()
  assert bias[:, 0].abs().sum() == bias[3:].abs().sum() == 0.0
  with pytest.raises(ValueError, match="a target is for fields outside of MjModel"):
    RandomizeField(cfg, sim)
  with pytest.raises(ValueError, match="a target is for fields outside of MjModel"):
    RandomizeField(CFGS[0], sim, target=bias)


def test_a_field_replaced_after_construction_is_still_the_one_written(sim: FakeSim) -> None:
  term = bound(CFGS[0], sim)
  sim.model.geom_friction = sim.model.geom_friction.clone()
  term.apply(torch.ones(N, dtype=torch.bool))
  assert (sim.model.geom_friction[:, 1, 0] != 1.0).all()
