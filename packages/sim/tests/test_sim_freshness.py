"""Derived quantities are never stale and never computed twice."""

from collections.abc import Callable, Mapping

import mujoco
import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sim import Simulation
from sim_world import MOTION, MakeSim, assert_same, reference, scatter


@pytest.fixture
def count_forwards(monkeypatch: pytest.MonkeyPatch) -> Callable[[Simulation], list[bool]]:
  """A list that grows with every forward pass of a simulation's engine."""

  def watch(sim: Simulation) -> list[bool]:
    calls: list[bool] = []
    forward = sim._engine.forward

    def counted(model_changed: bool) -> None:
      calls.append(model_changed)
      forward(model_changed)

    monkeypatch.setattr(sim._engine, "forward", counted)
    return calls

  return watch


def kept_view(sim: Simulation) -> None:
  view = sim.data.qpos[:, :3]
  _ = sim.data.xpos
  view[1:3].copy_(view[1:3] + 0.1)


def masked(sim: Simulation) -> None:
  hinges = sim.data.qpos[:, 21:23]
  where = torch.tensor([[True], [False], [True], [False]])
  torch.where(where, hinges + 0.2, hinges, out=hinges)


def assigned(sim: Simulation) -> None:
  sim.data.qpos = sim.data.qpos + 0.05


def augmented(sim: Simulation) -> None:
  sim.data.qpos += 0.05


def in_inference_mode(sim: Simulation) -> None:
  with torch.inference_mode():
    sim.data.qpos[:, 21:23] += 0.05


WRITES: Mapping[str, Callable[[Simulation], object]] = {
  "whole": lambda sim: sim.data.qpos.add_(0.05),
  "sliced": lambda sim: sim.data.qpos[:, 21:23].add_(0.05),
  "velocity": lambda sim: sim.data.qvel.mul_(2.0),
  "mocap": lambda sim: sim.data.mocap_pos[:, 0, 2].add_(0.1),
} | {write.__name__: write for write in (kept_view, masked, assigned, augmented, in_inference_mode)}


@pytest.mark.parametrize("write", WRITES.values(), ids=WRITES)
def test_a_write_is_seen_by_the_next_reader_and_by_the_next_step(
  sim: Simulation, engine: str, write: Callable[[Simulation], object], count_forwards
) -> None:
  scatter(sim)
  sim.step()
  forwards, epoch = count_forwards(sim), sim.version
  write(sim)
  expected = []
  tolerance = 1e-9 if engine == "native" else 2e-5
  for world in range(sim.num_envs):
    model, data = reference(sim, world)
    mujoco.mj_forward(model, data)
    expected.append((model, data))
    for name in ("xpos", "geom_xpos", "cvel", "ten_length"):
      torch.testing.assert_close(
        getattr(sim.data, name)[world].double(), torch.tensor(getattr(data, name)), rtol=tolerance, atol=tolerance
      )
  assert sim.version > epoch
  assert len(forwards) == 1
  sim.step()
  assert len(forwards) == 1
  for world, (model, data) in enumerate(expected):
    mujoco.mj_step(model, data)
    torch.testing.assert_close(
      sim.data.qvel[world].double(), torch.tensor(data.qvel), rtol=5 * tolerance, atol=5 * tolerance
    )


def test_reading_costs_a_forward_once(sim: Simulation, count_forwards) -> None:
  scatter(sim)
  forwards = count_forwards(sim)
  first = sim.version
  assert len(forwards) == 1
  assert sim.version == first
  _ = sim.data.xpos, sim.data.sensordata, sim.data.qpos
  sim.forward()
  assert len(forwards) == 1
  sim.step()
  assert sim.version > first
  _ = sim.data.cvel
  assert len(forwards) == 1


def test_controls_and_forces_move_nothing_until_the_step(sim: Simulation, count_forwards) -> None:
  sim.step()
  forwards, epoch = count_forwards(sim), sim.version
  for name in ("ctrl", "act", "xfrc_applied", "qfrc_applied"):
    getattr(sim.data, name).add_(0.1)
  _ = sim.data.xpos
  assert (sim.version, forwards) == (epoch, [])


def test_a_reset_then_writes_then_reads_cost_one_forward(sim: Simulation, count_forwards) -> None:
  sim.step()
  forwards = count_forwards(sim)
  sim.reset(torch.tensor([True, False, False, True]))
  sim.data.qpos[:, 21] += 0.1
  sim.data.qvel[:, 18] += 0.1
  _ = sim.data.xpos
  sim.step()
  assert len(forwards) == 1


def test_shared_constants_are_those_of_the_recomputed_worlds(make_sim: MakeSim) -> None:
  sim = make_sim("native")
  before = sim.model.body_invweight0.clone()
  sim.model.body_mass.mul_(2.0)
  sim.recompute_constants(torch.tensor([False, True, False, False]))
  of_one = sim.model.body_invweight0.clone()
  sim.recompute_constants()
  assert torch.equal(of_one, sim.model.body_invweight0)
  assert not torch.equal(of_one, before)


def test_a_reset_of_worlds_in_their_initial_state_keeps_their_positions(sim: Simulation) -> None:
  before = sim.data.xpos.clone()
  sim.reset(torch.tensor([True, False, False, True]))
  assert torch.equal(sim.data.xpos, before)


def test_accelerations_are_those_of_the_substep_through_writes_and_resets(sim: Simulation) -> None:
  scatter(sim)
  for _ in range(3):
    sim.step()
  model = sim.mj_model
  columns = [
    column
    for name in ("accelerometer", "force", "motor", "touch", "contact", "acceleration")
    for column in range(model.sensor(name).adr[0], model.sensor(name).adr[0] + model.sensor(name).dim[0])
  ]
  of_the_substep = sim.data.sensordata[:, columns].clone()
  assert (of_the_substep != 0).any(0).sum() > 20
  sim.data.qpos[1, 21] += 0.3
  sim.data.qvel[2] += 0.1
  assert torch.equal(sim.data.sensordata[:, columns], of_the_substep)
  sim.reset(torch.tensor([True, False, False, False]))
  after = sim.data.sensordata[:, columns]
  assert not after[0].any()
  assert torch.equal(after[1:], of_the_substep[1:])


def test_a_world_does_not_depend_on_its_neighbours(make_sim: MakeSim, engine: str) -> None:
  together, alone = make_sim(engine), make_sim(engine)
  for sim in (together, alone):
    scatter(sim)
  for step in range(6):
    if step in (2, 4):
      alone.reset(torch.tensor([step == 2, False, True, False]))
      alone.data.qpos[0, 21] += 0.1
      names = "xpos xmat geom_xpos cvel subtree_com ten_length qfrc_bias qacc actuator_force sensordata qvel".split()
      assert_same(together, alone, names, worlds=[1, 3])
      assert not torch.equal(together.data.xpos[0], alone.data.xpos[0])
    for sim in (together, alone):
      sim.step()
  assert_same(together, alone, worlds=[1, 3])


def test_a_world_of_many_is_a_world_alone(make_sim: MakeSim, engine: str) -> None:
  many, one = make_sim(engine), make_sim(engine, num_envs=1)
  scatter(many)
  for name in ("qpos", "qvel", "ctrl", "act", "xfrc_applied", "qfrc_applied", "mocap_pos"):
    getattr(one.data, name).copy_(getattr(many.data, name)[2:3])
  for _ in range(10):
    many.step()
    one.step()
  for name in MOTION:
    assert torch.equal(getattr(one.data, name)[0], getattr(many.data, name)[2]), name


def test_the_number_of_threads_makes_no_difference(make_sim: MakeSim) -> None:
  sims = [make_sim(num_envs=8, num_threads=threads) for threads in (1, 2, 0)]
  for sim in sims:
    scatter(sim)
    for _ in range(10):
      sim.step()
  for sim in sims[1:]:
    assert_same(sim, sims[0])


def test_switching_an_equality_on_acts_in_the_next_step(sim: Simulation) -> None:
  sim.step()
  sim.data.eq_active[1, 0] = 1
  datas = [reference(sim, world)[1] for world in (0, 1)]
  datas[1].eq_active[0] = 1
  sim.step()
  for world, data in enumerate(datas):
    mujoco.mj_step(sim.mj_model, data)
    torch.testing.assert_close(sim.data.qvel[world].double(), torch.tensor(data.qvel), rtol=1e-4, atol=1e-4)
  assert not torch.allclose(sim.data.qvel[0], sim.data.qvel[1])


def test_a_model_write_acts_in_the_next_step_and_is_seen_before(sim: Simulation, count_forwards) -> None:
  _ = sim.version
  forwards = count_forwards(sim)
  sim.model.jnt_pos[0, 3, 2] += 0.1
  sim.model.dof_damping[0, 18] = 1.0
  model = sim.mj_model.__copy__()
  model.jnt_pos[3, 2] += 0.1
  model.dof_damping[18] = 1.0
  data = reference(sim, 0)[1]
  mujoco.mj_forward(model, data)
  torch.testing.assert_close(sim.data.xanchor[0].double(), torch.tensor(data.xanchor), rtol=1e-6, atol=1e-6)
  assert forwards == [True]
  data.qvel[18] = 1.0
  sim.data.qvel[:, 18] = 1.0
  mujoco.mj_step(model, data)
  sim.step()
  torch.testing.assert_close(sim.data.qvel[0].double(), torch.tensor(data.qvel), rtol=1e-4, atol=1e-5)


def test_a_shared_write_is_seen_through_the_expansion_that_follows(sim: Simulation) -> None:
  height = sim.data.site_xpos[:, 2, 2].clone()
  sim.model.site_pos[0, 2, 2] += 0.1
  sim.expand_model_fields(["site_pos"])
  torch.testing.assert_close(sim.data.site_xpos[:, 2, 2], height + 0.1)
  sim.model.site_pos[1, 2, 2] += 0.1
  torch.testing.assert_close(sim.data.site_xpos[:, 2, 2] - height, torch.tensor([0.1, 0.2, 0.1, 0.1], dtype=sim.dtype))


def test_a_write_to_a_field_from_before_its_expansion_is_an_error(sim: Simulation) -> None:
  mass, gravity = sim.model.body_mass, sim.model.opt.gravity
  part = mass[:, 1:3]
  sim.expand_model_fields(["body_mass"])
  sim.step()
  for act in (sim.step, lambda: sim.data.xpos):
    part.mul_(2.0)
    with pytest.raises(MjlabError, match="model field body_mass was written through a tensor from before it was"):
      act()
    # It is said once; what is the simulation's may be written to as ever.
    act()
    sim.model.body_mass[1] += 0.1
    gravity[:, 2] += 0.1
    act()


def test_rays_see_geoms_where_the_written_state_puts_them(make_sim: MakeSim, engine: str) -> None:
  sim = make_sim(engine, num_envs=1)
  caster = sim.make_ray_caster(1)
  origin = torch.tensor([[[0.0, 0.0, 2.0]]], dtype=sim.dtype)
  down = torch.tensor([[[0.0, 0.0, -1.0]]], dtype=sim.dtype)
  assert caster.cast(origin, down).distance.item() == pytest.approx(1.8005, abs=1e-5)
  sim.data.qpos[:, 2] += 0.5
  assert caster.cast(origin, down).distance.item() == pytest.approx(1.3005, abs=1e-5)


def test_the_native_engine_computes_only_worlds_whose_model_was_written(make_sim: MakeSim) -> None:
  def kept() -> list[bool]:
    """Worlds in which an output is still what the test wrote there."""
    marks = (sim.data.xpos[:, 1] == 7.0).all(1).tolist()
    sim.data.xpos[:, 1] = 7.0
    return marks

  sim = make_sim("native")
  sim.expand_model_fields(["body_mass", "site_pos"])
  kept()
  assert kept() == [True, True, True, True]
  sim.model.body_mass[2, 3] += 1.0
  assert kept() == [True, True, False, True]
  mask = torch.tensor([True, False, False, True])
  sim.model.body_mass[:, 3] += 0.5 * mask
  sim.recompute_constants(mask)
  assert kept() == [False, True, True, False]
  # The same values again are nothing new.
  sim.model.body_mass[1, 3] = sim.model.body_mass[1, 3].clone()
  assert kept() == [True, True, True, True]
  sim.model.site_pos.copy_(sim.model.site_pos + torch.tensor([[[0.1]], [[0.0]], [[0.0]], [[0.0]]]))
  assert kept() == [False, True, True, True]
  sim.model.opt.gravity[0, 0] += 1.0
  assert kept() == [False, False, False, False]
  assert kept() == [True, True, True, True]
