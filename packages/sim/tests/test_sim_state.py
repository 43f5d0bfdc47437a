"""Saved and loaded states of a simulation."""

import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sim import Simulation
from sim_world import MOTION, MakeSim, assert_same, scatter


def randomised(make_sim: MakeSim, engine: str) -> Simulation:
  sim = make_sim(engine)
  sim.expand_model_fields(["body_mass", "geom_friction"])
  sim.model.body_mass[:, 3] += torch.tensor([0.0, 0.1, 0.2, 0.3], dtype=sim.dtype)
  sim.recompute_constants()
  scatter(sim)
  return sim


def run(sim: Simulation, steps: int) -> None:
  for _ in range(steps):
    sim.data.ctrl.copy_(0.1 * torch.sin(sim.data.qpos[:, :3]))
    sim.step()


def test_a_saved_simulation_goes_on_bit_for_bit(make_sim: MakeSim, engine: str) -> None:
  sim, other = randomised(make_sim, engine), make_sim(engine)
  run(sim, 5)
  saved = sim.state_dict()
  assert type(saved["data"]["qpos"]) is torch.Tensor
  run(sim, 5)
  other.load_state_dict(saved)
  assert set(other.expanded_fields) == set(sim.expanded_fields)
  run(other, 5)
  assert_same(sim, other, (*MOTION, "act", "time", "qacc_warmstart"))
  sim.load_state_dict(saved)
  assert torch.equal(sim.data.qpos, saved["data"]["qpos"])
  assert not torch.equal(sim.data.qpos, other.data.qpos)


def heavier(sim: Simulation) -> None:
  sim.model.opt.gravity[:, 2] = -3.0
  sim.model.body_mass[:, 3] += 0.5
  sim.recompute_constants()


def test_shared_fields_are_saved_where_they_are_not_as_compiled(make_sim: MakeSim, engine: str) -> None:
  sim, other, plain = (make_sim(engine) for _ in range(3))
  heavier(sim)
  untouched = plain.state_dict()
  assert untouched["shared"] == {}
  for each in (sim, plain):
    scatter(each)
    run(each, 3)
  moving = {**plain.state_dict(), "shared": {}}
  for saved, of in ((sim.state_dict(), sim), (moving, plain)):
    # The second time, what the first one brought must go again.
    other.load_state_dict(saved)
    for name in ("opt.gravity", "body_mass", "body_subtreemass", "dof_invweight0"):
      assert torch.equal(other.model[name], of.model[name]), name
    run(of, 5)
    run(other, 5)
    assert torch.equal(other.data.qpos, of.data.qpos)
  assert other.expanded_fields == ()


BUNCH = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="bunch" pos="0 0 .3"><freejoint/>{}</body>
    <body name="block" pos=".02 .01 .4"><freejoint/><geom type="box" size=".1 .1 .02"/></body>
  </worldbody>
</mujoco>""".format("".join(f'<geom size=".02" pos="{0.1 * i} 0 0"/>' for i in range(-2, 3)))


def test_internal_constants_of_an_engine_follow_a_loaded_model(make_sim) -> None:
  """MuJoCo looks for contacts of bodies with many geoms in a tree of boxes, which follow from the sizes of geoms."""
  sim, other = (make_sim(spec=BUNCH) for _ in range(2))
  sim.expand_model_fields(["geom_size"])
  sim.model.geom_size[:, 1:6, 0] *= torch.tensor([1.0, 1.5, 2.0, 3.0], dtype=sim.dtype)[:, None]
  sim.recompute_constants()
  other.load_state_dict(sim.state_dict())
  for _ in range(250):
    sim.step()
    other.step()
  assert torch.equal(sim.data.qpos, other.data.qpos)


def test_a_state_that_does_not_fit_is_refused_and_changes_nothing(
  make_sim: MakeSim, sim: Simulation, engine: str
) -> None:
  saved, more = randomised(make_sim, engine).state_dict(), make_sim(engine, num_envs=5).state_dict()
  before = sim.data.qpos.clone()

  def refused(state: dict, message: str) -> None:
    with pytest.raises(MjlabError, match=message):
      sim.load_state_dict(state)
    assert torch.equal(sim.data.qpos, before)
    assert sim.expanded_fields == ()

  refused(more, r"saved data field 'qpos' has shape \(5, 27\), here it is \(4, 27\)")
  refused({**saved, "data": {**saved["data"], "qpoz": before}}, "saved data fields .* differ by qpoz")
  refused({**saved, "model": {"body_mess": before}}, "saved model fields .* differ by body_mess")
  refused({**saved, "model": {"body_mass": before}}, "saved model field 'body_mass' has shape")
  short = {name: value for name, value in saved["data"].items() if name != "qvel"}
  refused({**saved, "data": short}, "saved data fields .* differ by qvel")
  refused({**saved, "default": {"body_mass": before}}, "saved default fields .* differ by body_mass")
