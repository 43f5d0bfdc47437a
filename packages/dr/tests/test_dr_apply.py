"""A randomiser on many worlds behind the protocol: masks, fixed memory, no sync, once-only recomputation."""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import pytest
import torch
from mjlab_core import (
  ModelFields,
  euler_xyz_from_quat,
  make_generator,
  matrix_from_quat,
  quat_conjugate,
  quat_error_magnitude,
  quat_mul,
)
from mjlab_dr import (
  FIELDS,
  Categorical,
  Custom,
  FieldRandomizer,
  RandomizeField,
  Uniform,
  agreement,
  apply_all,
  body_com_offset,
  drawn_values,
  encoder_bias,
  geom_friction,
  pseudo_inertia,
  randomize_field,
)
from torch.utils._python_dispatch import TorchDispatchMode

# The tests share a module.
sys.path.insert(0, str(Path(__file__).parent))

from dr_everything import EVERYTHING, trial

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
ALL = torch.ones(N, dtype=torch.bool)


class FakeSim:
  """The protocol and nothing more, counting what it is asked."""

  def __init__(self, xml: str = XML) -> None:
    self.own: dict[str, torch.Tensor] = {}
    self.mj_model = mujoco.MjModel.from_xml_string(xml)
    self.num_envs, self.device = N, torch.device("cpu")
    self.model = SimpleNamespace()
    self.recomputed: list[torch.Tensor | None] = []

  def expand_model_fields(self, names: Iterable[str], /) -> None:
    for name in names:
      if not hasattr(self.model, name):
        default = self.default_field(name)
        setattr(self.model, name, default.expand(N, *default.shape[1:]).clone())

  def default_field(self, name: str, /) -> torch.Tensor:
    if name in self.own:
      return self.own[name]
    owner = self.mj_model.opt if name.startswith("opt.") else self.mj_model
    return torch.tensor(getattr(owner, name.removeprefix("opt."))).unsqueeze(0)

  def recompute_constants(self, mask: torch.Tensor | None = None, /) -> None:
    self.recomputed.append(mask)


class NoSync(TorchDispatchMode):
  """Refuses operations that wait for the device, or make tensors of host data."""

  def __torch_dispatch__(self, func, types, args=(), kwargs=None):
    name = func.overloadpacket.__name__
    assert name not in {"nonzero", "_local_scalar_dense", "masked_select", "lift_fresh", "is_nonzero"}, name
    return func(*args, **(kwargs or {}))


class Beyond:
  """Distribution with draws outside of its support."""

  def __repr__(self) -> str:
    return "Beyond()"

  def check(self, name: str) -> None: ...

  def support(self) -> tuple[float, float]:
    return 0.5, 1.0

  def sample(self, shape: Sequence[int], **more: Any) -> torch.Tensor:
    return torch.full(tuple(shape), 3.0)


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


@pytest.mark.parametrize("pattern", ["a/f1", "a/f."], ids=["evenly_spaced", "scattered"])
def test_repeats_start_from_the_present_default_of_each_world(sim: FakeSim, pattern: str) -> None:
  """As where the state of a run is loaded whose worlds have other objects."""
  sim.own = {"geom_friction": sim.default_field("geom_friction").repeat(N, 1, 1)}
  term = bound(geom_friction(pattern, (2.0, 2.5), operation="scale"), sim)
  sim.own["geom_friction"] *= torch.arange(1.0, N + 1)[:, None, None]
  term.apply(ALL)
  factor = term.values() / torch.arange(1.0, N + 1)[:, None]
  assert ((factor >= 2.0) & (factor <= 2.5)).all()
  torch.testing.assert_close(term.default[:, 0], torch.arange(1.0, N + 1, dtype=torch.float64))


def test_derived_fields_are_recomputed_once_for_all_and_only_where_needed(sim: FakeSim) -> None:
  friction, com = bound(CFGS[0], sim), bound(CFGS[3], sim)
  friction.apply(ALL)
  assert sim.recomputed == []
  com.apply(ALL)
  assert len(sim.recomputed) == 1
  apply_all([friction, com, bound(body_com_offset("a/leg", (0.0, 0.1)), sim)], sim, ALL)
  assert len(sim.recomputed) == 2
  assert sim.recomputed[-1] is ALL


def test_an_entity_gives_its_own_names_and_ids(sim: FakeSim) -> None:
  term = RandomizeField(geom_friction("f2|f3", (0.3, 0.4)), sim, elements={"f3": 4, "f2": 2}, owner="event 'foot'")
  term.apply(ALL)
  touched = (sim.model.geom_friction != sim.default_field("geom_friction")).nonzero()[:, 1].unique()
  assert touched.tolist() == [2, 4]
  with pytest.raises(ValueError, match="event 'foot': geom_friction: pattern 'f9' matches no geom"):
    RandomizeField(geom_friction("f9", (0.3, 0.4)), sim, elements={"f3": 4}, owner="event 'foot'")


def test_a_field_outside_of_the_model_is_written_to_its_target(sim: FakeSim) -> None:
  bias = torch.zeros(N, 2)
  cfg = encoder_bias("k", (0.01, 0.02))
  RandomizeField(cfg, sim, elements={"j": 0, "k": 1}, target=bias).apply(torch.arange(N) < 3)
  assert (bias[:3, 1] >= 0.01).all()
  assert bias[:, 0].abs().sum() == bias[3:].abs().sum() == 0.0


def test_a_field_replaced_after_construction_is_still_the_one_written(sim: FakeSim) -> None:
  term = bound(CFGS[0], sim)
  sim.model.geom_friction = sim.model.geom_friction.clone()
  term.apply(ALL)
  assert (sim.model.geom_friction[:, 1, 0] != 1.0).all()


@pytest.mark.parametrize(
  ("cfg", "xml"),
  [*((cfg, XML) for cfg in CFGS), *((trial(name), EVERYTHING) for name in FIELDS if FIELDS[name].in_model)],
  ids=lambda value: value.label if isinstance(value, FieldRandomizer) else "",
)
def test_apply_writes_masked_worlds_in_place_without_a_sync_and_draws_alike_whatever_the_mask(
  cfg: FieldRandomizer, xml: str
) -> None:
  sims = [FakeSim(xml), FakeSim(xml)]
  terms = [bound(cfg, sim) for sim in sims]
  names = list(vars(sims[0].model))
  addresses = [getattr(sims[0].model, field).data_ptr() for field in names]
  mask = torch.tensor([True, False, True, True, False, False])
  with NoSync():
    terms[0].apply(mask)
  terms[1].apply(ALL)
  assert [getattr(sims[0].model, field).data_ptr() for field in names] == addresses
  values, default = terms[0].values(), terms[0].default
  assert torch.equal(values[mask], terms[1].values()[mask])
  assert torch.equal(values[~mask], default.expand(N, -1)[~mask].to(values.dtype))
  # A second draw starts from the default, and is another one, in all worlds that it writes.
  terms[0].apply(mask)
  terms[1].apply(mask)
  assert torch.equal(terms[0].values()[mask], terms[1].values()[mask])
  assert not torch.equal(terms[0].values()[mask], values[mask]) or cfg.row.integer


def test_worlds_with_different_defaults_start_from_theirs() -> None:
  sim = FakeSim(EVERYTHING)
  compiled = sim.default_field
  factors = torch.arange(1, N + 1, dtype=torch.float64)
  own = sim.own = {
    name: compiled(name) * factors.reshape(-1, *[1] * (compiled(name).dim() - 1))
    for name in ("body_mass", "body_inertia", "body_ipos", "geom_friction")
  }
  terms = [bound(pseudo_inertia("thigh", alpha=(0.1, 0.1)), sim), bound(geom_friction("shin", (0.1, 0.2)), sim)]
  terms.append(bound(randomize_field("geom_friction", "thigh", (2.0, 2.0), axes=(0,), operation="scale"), sim))
  for term in terms:
    term.apply(ALL)
  thigh = sim.mj_model.body("thigh").id
  gain = torch.tensor(0.2, dtype=torch.float64).exp()
  for name in ("body_mass", "body_inertia"):
    torch.testing.assert_close(getattr(sim.model, name)[:, thigh], own[name][:, thigh] * gain)
  geom = sim.mj_model.geom("thigh").id
  torch.testing.assert_close(sim.model.geom_friction[:, geom, 0], 2.0 * own["geom_friction"][:, geom, 0])
  heaviest = own["body_mass"][-1, thigh].item()
  with pytest.raises(ValueError, match=r"body 'thigh' may get body_mass -0\.\d+, below"):
    bound(randomize_field("body_mass", "thigh", (-1.1 * heaviest / N, 0.0), operation="add"), sim)


def test_strength_takes_every_kind_of_field_from_its_default_to_the_draw() -> None:
  for name in ("geom_friction", "qpos0", "jnt_axis", "cam_intrinsic", "body_pos", "pseudo_inertia", "opt.gravity"):
    results = []
    for strength in (0.0, 0.5, 1.0, None):
      term = bound(trial(name), FakeSim(EVERYTHING))
      if strength is not None:
        term.strength.fill_(strength)
      term.apply(ALL)
      results.append(term.values() - term.default)
    nothing, half, full, plain = results
    # The compiler took the field of view from intrinsics before it rounded them to single precision.
    assert nothing.abs().max() <= (1e-5 if name == "cam_intrinsic" else 0.0), name
    assert torch.equal(full, plain), name
    if name in ("geom_friction", "qpos0", "body_pos", "opt.gravity"):
      torch.testing.assert_close(half, 0.5 * full)
    else:
      # Unit vectors, and what follows by a formula, are nearer to the default all the same.
      assert half.abs().max() < full.abs().max(), name


def test_strength_of_a_rotation_is_the_share_of_its_angles() -> None:
  sims = [FakeSim(EVERYTHING) for _ in range(2)]
  angles = []
  for sim, strength in zip(sims, (1.0, 0.25), strict=True):
    term = bound(randomize_field("cam_quat", "eye", {"yaw": (0.5, 1.0)}), sim)
    term.strength.fill_(strength)
    term.apply(ALL)
    angles.append(quat_error_magnitude(sim.model.cam_quat[:, 0], sim.default_field("cam_quat")[:, 0]))
  torch.testing.assert_close(angles[1], 0.25 * angles[0])


def test_a_choice_has_no_strength() -> None:
  with pytest.raises(ValueError, match="a choice, which cannot be widened"):
    _ = bound(trial("light_active"), FakeSim(EVERYTHING)).strength


def test_a_rotation_turns_about_the_axes_of_the_parent() -> None:
  sim = FakeSim(EVERYTHING)
  bound(randomize_field("body_quat", "shin", {"yaw": (0.3, 0.3)}), sim).apply(ALL)
  shin = sim.mj_model.body("shin").id
  before, after = (matrix_from_quat(x[:, shin]) for x in (sim.default_field("body_quat"), sim.model.body_quat))
  cos, sin = torch.tensor(0.3).cos(), torch.tensor(0.3).sin()
  about_z = torch.tensor([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
  torch.testing.assert_close(after, (about_z @ before).expand(N, 3, 3))


def test_some_axes_in_any_order_leave_the_others_as_they_are() -> None:
  sim = FakeSim(EVERYTHING)
  bound(randomize_field("cam_quat", "eye", {"yaw": (0.3, 0.3), "roll": (0.1, 0.1)}), sim).apply(ALL)
  eye = sim.mj_model.camera("eye").id
  turn = quat_mul(sim.model.cam_quat[:, eye], quat_conjugate(sim.default_field("cam_quat")[:, eye]).expand(N, -1))
  for found, angle in zip(euler_xyz_from_quat(turn), (0.1, 0.0, 0.3), strict=True):
    torch.testing.assert_close(found, torch.full_like(found, angle))
  default, lens = sim.default_field("cam_intrinsic"), sim.mj_model.camera("lens").id
  focal = float(default[0, lens, 1])
  absolute = randomize_field("cam_intrinsic", "lens", {"fy": (0.004, 0.004)}, operation="absolute")
  scale = randomize_field("cam_intrinsic", "lens", {"fy": (1.5, 1.5)}, operation="scale")
  for cfg, expected in ((absolute, 0.004), (scale, 1.5 * focal)):
    bound(cfg, sim).apply(ALL)
    torch.testing.assert_close(sim.model.cam_intrinsic[:, lens, 1], torch.full((N,), expected))
    others = [0, 2, 3]
    assert torch.equal(sim.model.cam_intrinsic[:, lens, others], default[:, lens, others].expand(N, -1))


def test_degrees_of_freedom_of_a_joint_share_a_draw_and_other_joints_keep_their_addresses() -> None:
  sim = FakeSim(EVERYTHING)
  bound(randomize_field("dof_damping", ("shoulder", "crank"), (1.0, 2.0)), sim).apply(ALL)
  damping, model = sim.model.dof_damping, sim.mj_model
  ball = [int(model.joint("shoulder").dofadr[0]) + i for i in range(3)]
  crank = int(model.joint("crank").dofadr[0])
  assert (damping[:, ball] == damping[:, ball[:1]]).all()
  assert (damping[:, crank] >= 1.0).all()
  assert (damping[:, crank] != damping[:, ball[0]]).all()
  untouched = [i for i in range(model.nv) if i not in (*ball, crank)]
  assert torch.equal(damping[:, untouched], sim.default_field("dof_damping")[:, untouched].expand(N, -1))


def test_the_zero_of_a_joint_takes_its_spring_along() -> None:
  sim = FakeSim(EVERYTHING)
  bound(randomize_field("qpos0", "hip|slide", (-0.1, 0.1)), sim).apply(ALL)
  shift = sim.model.qpos0 - sim.default_field("qpos0")
  assert (shift != 0.0).any(0).sum() == 2
  torch.testing.assert_close(sim.model.qpos_spring - sim.default_field("qpos_spring"), shift)


def test_one_actuator_is_changed_when_one_is_asked_for() -> None:
  sim = FakeSim(EVERYTHING)
  values = {"0": (20.0, 40.0)}
  bound(randomize_field("actuator_gainprm", "hip", values), sim).apply(ALL)
  changed = (sim.model.actuator_gainprm != sim.default_field("actuator_gainprm")).any(0).nonzero()
  assert changed.tolist() == [[sim.mj_model.actuator("hip").id, 0]]


def test_isotropic_means_one_draw_for_all_axes_of_an_element() -> None:
  sim = FakeSim(EVERYTHING)
  cfg = randomize_field("geom_size", "trunk|arm", (0.5, 1.5), isotropic=True)
  bound(cfg, sim).apply(ALL)
  for name in ("trunk", "arm"):
    geom = sim.mj_model.geom(name).id
    factor = sim.model.geom_size[:, geom] / sim.default_field("geom_size")[:, geom]
    torch.testing.assert_close(factor, factor[:, :1].expand(-1, 3))
  assert sim.model.geom_size[:, sim.mj_model.geom("trunk").id].unique().numel() == 3 * N


def test_one_element_takes_the_first_of_the_axes_where_the_others_would_do_nothing(sim: FakeSim) -> None:
  field = RandomizeField(randomize_field("geom_friction", "a/f1", (0.5, 0.6)), sim, generator=make_generator("cpu", 0))
  assert [component.axis for component in field.components] == ["sliding", "torsional"]
  before = sim.model.geom_friction.clone()
  field.apply(ALL)
  drawn = sim.model.geom_friction[:, sim.mj_model.geom("a/f1").id]
  assert ((drawn[:, :2] > 0.5) & (drawn[:, :2] < 0.6)).all()
  assert int((sim.model.geom_friction != before).sum()) == 2 * N


def test_gaussian_draws_differ_between_worlds_for_rotations_and_inertia_too() -> None:
  sim = FakeSim(EVERYTHING)
  turn = randomize_field("cam_quat", "eye", (0.0, 0.1), distribution="gaussian")
  mass = pseudo_inertia("thigh|shin", alpha=(0.0, 0.1), distribution="gaussian")
  for cfg in (turn, mass):
    bound(cfg, sim).apply(ALL)
  assert sim.model.cam_quat[:, 0].unique(dim=0).shape[0] == N
  moving = [sim.mj_model.body(name).id for name in ("thigh", "shin")]
  assert sim.model.body_mass[:, moving].unique().numel() == 2 * N


def test_draws_of_a_custom_function_are_clamped_to_its_bounds() -> None:
  def waves(shape, *, generator, device, dtype) -> torch.Tensor:
    return 2.0 * torch.rand(tuple(shape), generator=generator, device=device, dtype=dtype).sin()

  sim = FakeSim(EVERYTHING)
  bound(randomize_field("geom_friction", "shin", Custom(waves, 0.2, 1.1), axes=(0,)), sim).apply(ALL)
  friction = sim.model.geom_friction[:, sim.mj_model.geom("shin").id, 0]
  assert friction.unique().numel() > 1
  assert ((friction >= 0.2) & (friction <= 1.1)).all()


def test_choices_are_given_by_name_and_an_entity_may_leave_its_prefix_out() -> None:
  xml = EVERYTHING.replace('"dull"', '"a/dull"').replace('"shiny"', '"a/shiny"')
  sim = FakeSim(xml)
  cfg = randomize_field("geom_matid", "post", Categorical(("dull",)))
  RandomizeField(cfg, sim, prefix="a/").apply(ALL)
  assert (sim.model.geom_matid[:, sim.mj_model.geom("post").id] == sim.mj_model.material("a/dull").id).all()


@pytest.mark.parametrize("name", [name for name in FIELDS if FIELDS[name].in_model])
def test_draws_are_computed_from_written_values(name: str) -> None:
  term = bound(trial(name), FakeSim(EVERYTHING))
  seen: list[torch.Tensor] = []
  sample = term._sample
  term._sample = lambda shape, generator: seen.append(sample(shape, generator)) or seen[0]
  term.apply(ALL)
  found = torch.stack(list(drawn_values(term).values()), -1)
  seen[0] = seen[0].expand_as(found)
  known = found.isfinite()
  assert known.any() or FIELDS[name].form == "direction"
  # Fields in single precision limit the precision of the draws.
  torch.testing.assert_close(found[known], seen[0].double()[known], rtol=1e-4, atol=1e-6)


def test_choices_by_name_are_compared_as_ids() -> None:
  cfg = randomize_field("mat_texid", "dull", {"rgb": Categorical(("steel", "wood"), (3.0, 1.0))})
  sim = FakeSim(EVERYTHING)
  term = bound(cfg, sim)
  term.apply(ALL)
  (drawn,), (asked,) = drawn_values(term).values(), term.distributions.values()
  assert asked == Categorical((sim.mj_model.texture("steel").id, sim.mj_model.texture("wood").id), (3.0, 1.0))
  assert agreement(drawn, asked) > 0.01


def test_agreement_rejects_other_distributions_and_one_draw_for_all() -> None:
  generator = make_generator("cpu", 0)
  drawn = 0.3 + 0.9 * torch.rand(500, generator=generator)
  assert agreement(drawn, Uniform(0.3, 1.2)) > 0.01
  assert agreement(drawn, Uniform(0.3, 1.0)) < 1e-6
  assert agreement(drawn[:1].expand(500), Uniform(0.3, 1.2)) < 1e-6
  coins = torch.rand(500, generator=generator).lt(0.25).double()
  assert agreement(coins, Categorical((0.0, 1.0), (3.0, 1.0))) > 0.01
  assert agreement(coins, Categorical((0.0, 1.0))) < 1e-6
  assert agreement(torch.full((3,), torch.nan), Uniform(0.0, 1.0)) == 1.0
