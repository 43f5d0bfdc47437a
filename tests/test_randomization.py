"""The catalogue of mjlab-dr on both engines: every row against a recompiled model, and MuJoCo Warp's own list."""

import dataclasses
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
import pytest
import torch
from dr_everything import EVERYTHING, check_numbers, numbers, recompiled, trial, written_by
from mjlab_dr import FIELDS, FieldRandomizer, RandomizeField, apply_all, followers_of, randomize_field
from mjlab_scene import Scene, SceneCfg
from mjlab_sim import PER_WORLD, Simulation, SimulationCfg
from mjlab_sim.fields import closure

IN_MODEL = [name for name in FIELDS if FIELDS[name].in_model]
NUM_WORLDS = 4
MASK = torch.tensor([True, False, True, False])


def make_sim(engine: Literal["native", "warp"]) -> Simulation:
  cfg = SimulationCfg(engine=engine, integrator=None, num_threads=1, nconmax=16, njmax=128)
  return Simulation(NUM_WORLDS, mujoco.MjSpec.from_string(EVERYTHING), cfg, "cpu")


def bound(name: str, sim: Simulation, seed: int = 0) -> RandomizeField:
  return RandomizeField(trial(name), sim, generator=torch.Generator().manual_seed(seed))


def catalogue_tool() -> dict[str, Any]:
  """Names of `tools/write_catalogue.py`."""
  return runpy.run_path(str(Path(__file__).parents[1] / "tools" / "write_catalogue.py"))


def test_every_field_that_mujoco_warp_holds_per_world_is_in_the_catalogue_or_left_out_for_a_reason() -> None:
  types = pytest.importorskip("mujoco_warp._src.types")
  owners = {"": types.Model, "opt.": types.Option}
  kinds: dict[str, Any] = {
    prefix + field.name: field.type for prefix, owner in owners.items() for field in dataclasses.fields(owner)
  }
  # An array whose first dimension may be one or one per world.
  listed = {name for name, kind in kinds.items() if getattr(kind, "shape", None) and kind.shape[0] == "*"}
  assert len(listed) > 120
  written = {part for name in IN_MODEL for part in written_by(name)}
  left_out = catalogue_tool()["LEFT_OUT"]
  assert not written & set(left_out)
  assert listed == written | set(left_out)
  assert all(left_out.values())


def test_the_documented_table_is_the_one_in_the_code() -> None:
  document = Path(__file__).parents[1] / "packages" / "dr" / "CATALOGUE.md"
  assert document.read_text(encoding="utf-8") == catalogue_tool()["table"](), "run tools/write_catalogue.py"


def test_derived_fields_of_the_catalogue_are_expanded_with_their_source() -> None:
  model = mujoco.MjModel.from_xml_string(EVERYTHING)
  for name in IN_MODEL:
    assert set(followers_of(name)) & PER_WORLD <= set(closure(list(written_by(name)), model)), name


@pytest.mark.parametrize("name", IN_MODEL)
def test_masked_worlds_are_recompiled_models_and_the_others_keep_every_bit(name: str) -> None:
  sim = make_sim("native")
  term = bound(name, sim)
  before = {field: sim.model[field].clone() for field in sorted(PER_WORLD)}
  replay = sim.capture(lambda: term.apply(MASK))
  replay()
  first = term.values()
  assert (first[MASK] != term.default).any(-1).all() or FIELDS[name].integer
  for field, value in before.items():
    rows = ~MASK if sim.is_expanded(field) else slice(None)
    assert torch.equal(sim.model[field][rows], value[rows]), field
  for _ in range(20):
    replay()
  again = bound(name, sim)
  again.apply(MASK)
  assert torch.equal(again.values(), first)

  sim.reset()
  engine: Any = sim._engine
  batch = engine._batch
  for world in MASK.nonzero().flatten().tolist():
    oracle = recompiled({part: sim.model[part][world].numpy() for part in written_by(name)})
    check_numbers(numbers(batch.get_model(world)), numbers(oracle))
  sim.close()


@pytest.mark.parametrize("engine", ["native", pytest.param("warp", marks=pytest.mark.warp)])
def test_a_field_first_randomised_after_steps_counts_from_the_next_step(engine: Literal["native", "warp"]) -> None:
  sim = make_sim(engine)
  for _ in range(4):
    # On MuJoCo Warp the step is a recorded graph by now, over memory that the randomiser replaces.
    sim.step()
  assert (sim.data.qvel == sim.data.qvel[:1]).all()
  cfg = randomize_field("opt.gravity", ".*", {"x": (5.0, 10.0)})
  RandomizeField(cfg, sim, generator=torch.Generator().manual_seed(0)).apply(MASK)
  pull = sim.model.opt.gravity[:, 0].clone()
  speed = sim.data.qvel[:, 0].clone()
  sim.step()
  gained = sim.data.qvel[:, 0] - speed
  # A stronger pull makes faster, but for the air, and worlds outside of the mask stay alike.
  assert gained[1] == gained[3]
  assert torch.equal(gained.argsort(stable=True), pull.argsort(stable=True))
  torch.testing.assert_close((gained[[0, 2]] - gained[1]) / sim.timestep, pull[[0, 2]], rtol=0.2, atol=0.0)
  sim.close()


PUCK = """<mujoco><worldbody><body name="puck">
  <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/><joint name="turn"/>
  <inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .2"/>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize("engine", ["native", pytest.param("warp", marks=pytest.mark.warp)])
@pytest.mark.parametrize(
  "cfg",
  [
    randomize_field("jnt_pos", "turn", (0.1, 0.3)),
    randomize_field("jnt_axis", ".*", (-0.3, 0.3)),
    randomize_field("body_ipos", ".*", (-0.3, 0.3)),
    randomize_field("body_iquat", ".*", (-0.5, 0.5)),
  ],
  ids=lambda cfg: cfg.field,
)
def test_a_planar_puck_of_a_scene_moves_as_if_recompiled(
  engine: Literal["native", "warp"], cfg: FieldRandomizer
) -> None:
  """Covers each field that a body compiled as simple would ignore; scenes compile no body as simple."""
  scene = Scene(SceneCfg(num_envs=2, spec_fn=lambda spec: spec.worldbody.add_frame().attach_body(puck().body("puck"))))
  sim = Simulation(2, scene.spec, SimulationCfg(engine=engine, integrator=None, num_threads=1), "cpu")
  term = RandomizeField(cfg, sim, generator=torch.Generator().manual_seed(0))
  term.apply(torch.ones(2, dtype=torch.bool))
  qpos, qvel = torch.tensor([0.1, -0.2, 0.5]), torch.tensor([1.0, -2.0, 3.0])
  sim.data.qpos[:], sim.data.qvel[:] = qpos, qvel
  sim.data.qfrc_applied[:] = torch.tensor([1.0, 2.0, -0.5])
  sim.step()
  for world in range(2):
    spec = puck()
    model = spec.compile()
    getattr(model, cfg.field)[:] = sim.model[cfg.field][world]
    spec.body("puck").simple = False
    spec.copy_back(model)
    data = mujoco.MjData(spec.compile())
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = qpos, qvel, (1.0, 2.0, -0.5)
    mujoco.mj_forward(data.model, data)
    tolerance = 1e-9 if engine == "native" else 1e-4
    torch.testing.assert_close(
      sim.data.qacc[world].double(), torch.tensor(data.qacc), rtol=tolerance, atol=100 * tolerance
    )
  sim.close()


def puck() -> mujoco.MjSpec:
  return mujoco.MjSpec.from_string(PUCK)


@pytest.mark.parametrize("engine", ["native", pytest.param("warp", marks=pytest.mark.warp)])
def test_a_simple_body_of_a_foreign_model_is_refused_by_name_in_a_simulation(engine: Literal["native", "warp"]) -> None:
  sim = Simulation(2, puck(), SimulationCfg(engine=engine, integrator=None, num_threads=1), "cpu")
  for field in ("jnt_pos", "jnt_axis", "body_ipos"):
    with pytest.raises(ValueError, match=r"body 'puck'.* was compiled as simple"):
      RandomizeField(randomize_field(field, ".*", (0.1, 0.3)), sim)
  sim.close()


# Each number once: the pseudo-inertia writes all four fields, a joint's zero moves its spring, kp is a gain.
TOGETHER = [name for name in IN_MODEL if name not in {*FIELDS["pseudo_inertia"].fields, "qpos_spring", "actuator_kp"}]


def check_recompiled(sim: Simulation) -> None:
  """Every world of a simulation in which all of `TOGETHER` is randomised is the model recompiled with its values."""
  values = {part: sim.model[part].cpu().numpy() for name in TOGETHER for part in written_by(name)}
  for world in range(NUM_WORLDS):
    expected = numbers(recompiled({part: value[world] for part, value in values.items()}))
    for field in sorted(PER_WORLD & set(expected)):
      actual = sim.model[field][world if sim.is_expanded(field) else 0].cpu().numpy()
      value = expected[field].reshape(actual.shape)
      scale = 1e-5 * np.abs(value).max(initial=1.0)
      np.testing.assert_allclose(actual, value, rtol=2e-4, atol=scale, err_msg=field)


@pytest.mark.warp
def test_on_mujoco_warp_worlds_with_everything_randomised_are_recompiled_models() -> None:
  sim = make_sim("warp")
  terms = [bound(name, sim, seed) for seed, name in enumerate(TOGETHER)]
  for _ in range(3):
    # The first is recorded as a graph of the engine, the others replay it.
    apply_all(terms, sim, torch.ones(NUM_WORLDS, dtype=torch.bool))
  before = {field: sim.model[field].clone() for field in sorted(PER_WORLD)}
  apply_all(terms, sim, MASK)
  for field, value in before.items():
    rows = ~MASK if sim.is_expanded(field) else slice(None)
    assert torch.equal(sim.model[field][rows], value[rows]), field
  check_recompiled(sim)
  sim.close()


def crouch(sim: Simulation) -> None:
  """Beyond limits of joints, on the floor and against the post, with controls beyond theirs."""
  model = sim.mj_model
  data = mujoco.MjData(model)
  hip, slide, shoulder = (int(model.joint(name).qposadr[0]) for name in ("hip", "slide", "shoulder"))
  data.qpos[hip], data.qpos[slide], data.qpos[shoulder : shoulder + 4] = 1.3, 0.16, (0.8, 0.6, 0.0, 0.0)
  mujoco.mj_kinematics(model, data)
  data.qpos[:3] += np.array([2.0 - 0.148, 0.0, 0.048]) - data.geom("shin").xpos
  put_state(sim, data.qpos, 1000.0, 6.0)


def hover(sim: Simulation) -> None:
  """In the air and within limits."""
  put_state(sim, sim.mj_model.qpos0 + np.array([0.0, 0.0, 1.0, *[0.0] * (sim.mj_model.nq - 3)]), 1.5, 0.3)


def put_state(sim: Simulation, qpos: np.ndarray, ctrl: float, act: float) -> None:
  sim.reset()
  sim.data.qpos[:] = torch.tensor(qpos).to(sim.dtype)
  sim.data.qvel[:] = torch.linspace(-0.3, 0.4, sim.mj_model.nv)
  sim.data.ctrl[:] = ctrl
  sim.data.act[:] = act


ELSEWHERE = {
  *("opt.magnetic", "geom_rgba", "geom_matid", "jnt_springyield", "tendon_springyield", "geom_solmix", "geom_adhesion"),
  *("pair_gap", "pair_solreffriction", "eq_data", "eq_solref", "eq_solimp", "tendon_range", "tendon_margin"),
  *("tendon_solref_lim", "tendon_solimp_lim", "tendon_solref_fri", "tendon_solimp_fri", "tendon_actfrcrange"),
  *("actuator_forcerange", "actuator_actrange", "actuator_delay", "dof_solref", "dof_solimp"),
  *(name for name in TOGETHER if FIELDS[name].kind in ("camera", "light", "material")),
}
"""Fields without effect in the two poses: fields of the appearance, and fields of other circumstances."""


@pytest.mark.warp
def test_each_randomised_field_moves_both_engines_alike() -> None:
  sims = [make_sim("native"), make_sim("warp")]
  terms = [[bound(name, sim, seed) for seed, name in enumerate(TOGETHER)] for sim in sims]
  parts = {part for name in TOGETHER for part in written_by(name)}

  def put_fields(sim: Simulation, values: dict[str, torch.Tensor]) -> None:
    for part in parts:
      sim.model[part][:] = values.get(part, sim.default_field(part)).to(sim.model[part].dtype)
    sim.recompute_constants()

  def speeds(pose: Callable[[Simulation], None], values: dict[str, torch.Tensor]) -> list[torch.Tensor]:
    found = []
    for sim in sims:
      put_fields(sim, values)
      pose(sim)
      # Controls that arrive late count from the third step on.
      for _ in range(4 if pose is hover else 1):
        sim.step()
      assert not sim.overflow_report()
      found.append(sim.data.qvel.double().clone())
    return found

  still = {}
  for pose in (crouch, hover):
    native, warp = speeds(pose, {})
    torch.testing.assert_close(warp, native, rtol=1e-4, atol=1e-5)
    still[pose] = native
  idle = set()
  for name, term in zip(TOGETHER, terms[0], strict=True):
    put_fields(sims[0], {})
    term.apply(MASK)
    values = {part: sims[0].model[part].clone() for part in written_by(name)}
    effect = 0.0
    for pose, before in still.items():
      native, warp = speeds(pose, values)
      torch.testing.assert_close(warp, native, rtol=1e-4, atol=3e-5, msg=lambda text, name=name: f"{name}: {text}")
      effect = max(effect, (native - before)[MASK].abs().max().item())
    if effect < 1e-6:
      idle.add(name)
  assert idle == ELSEWHERE
  for sim in sims:
    sim.close()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu_everything_is_randomised_inside_a_recorded_step_without_a_wait() -> None:
  cfg = SimulationCfg(nconmax=16, njmax=64)
  sim = Simulation(NUM_WORLDS, mujoco.MjSpec.from_string(EVERYTHING), cfg, "cuda")
  rng = torch.Generator("cuda").manual_seed(0)
  terms = [RandomizeField(trial(name), sim, generator=rng) for name in TOGETHER]
  mask = MASK.cuda()
  graph = sim.capture(lambda: apply_all(terms, sim, mask), generators=(rng,))
  for _ in range(6):
    graph()
  assert graph.num_graphs == 1
  drawn = [term.values() for term in terms]
  before = {field: sim.model[field].clone() for field in sorted(PER_WORLD)}
  constant = set(TOGETHER)
  # Choices among few may fall on the same twice.
  for _ in range(12):
    torch.cuda.set_sync_debug_mode("error")
    try:
      graph()
    finally:
      torch.cuda.set_sync_debug_mode("default")
    now = [term.values() for term in terms]
    constant -= {n for n, a, b in zip(TOGETHER, drawn, now, strict=True) if not torch.equal(a[mask], b[mask])}
  # A replay draws again, in the masked worlds only.
  assert not constant
  for field, value in before.items():
    rows = ~mask if sim.is_expanded(field) else slice(None)
    assert torch.equal(sim.model[field][rows], value[rows]), field
  check_recompiled(sim)
  sim.close()
