"""Growing buffers: no contact is lost, and nothing else changes."""

import re

import mujoco
import pytest
import torch
from mjlab_sim import Simulation, SimulationCfg
from mjlab_sim.warp import buffers, engine
from sim_world import NUM_WORLDS, WORLD, MakeSim, assert_same, scatter

pytestmark = pytest.mark.warp
STATE = ("qpos", "qvel", "act", "qacc_warmstart", "qacc", "sensordata", "xpos", "nefc", "time")

# Bodies begin in the air and fall: demand comes in the middle of the episode.
FALLING = WORLD.replace(".0995", ".13").replace(".0495", ".1")


@pytest.fixture
def small_start(monkeypatch: pytest.MonkeyPatch) -> None:
  # Kernels are compiled for each size: these are the ones of other tests.
  monkeypatch.setattr(engine, "starting_sizes", lambda model: {"nconmax": 4, "njmax": 8})
  monkeypatch.setattr(buffers, "size_for", lambda count: 64)


def fall(sim: Simulation, num_steps: int) -> list[dict[str, torch.Tensor]]:
  frames = []
  for step in range(num_steps):
    sim.data.ctrl.fill_(0.1 * (step % 3))
    if step == num_steps // 2:
      sim.reset(torch.arange(NUM_WORLDS) == 1)
    sim.step()
    frames.append({name: getattr(sim.data, name).clone() for name in STATE})
  return frames


@pytest.mark.usefixtures("small_start")
def test_growth_in_an_episode_loses_nothing(make_sim: MakeSim) -> None:
  growing = make_sim("warp", spec=FALLING, nconmax="auto", njmax="auto")
  roomy = make_sim("warp", spec=FALLING)
  views = {name: getattr(growing.data, name) for name in ("qpos", "sensordata", "ctrl")}
  for sim in (growing, roomy):
    scatter(sim)
  for step, (one, other) in enumerate(zip(fall(growing, 90), fall(roomy, 90), strict=True)):
    for name in STATE:
      assert torch.equal(one[name], other[name]), (step, name)
  assert int(roomy.data.nefc.max()) > 8
  assert all(growing.buffer_sizes[name] > size for name, size in (("nconmax", 4), ("njmax", 8)))
  for name, view in views.items():
    assert getattr(growing.data, name).data_ptr() == view.data_ptr()
  lines = growing.overflow_report()
  assert lines
  assert all(line.startswith("buffers grew") and "lost" not in line for line in lines)
  settings = {name: int(size) for name, size in re.findall(r"--env\.sim\.(\w+) (\d+)", lines[-1])}
  assert settings == growing.buffer_sizes
  assert growing.overflow_report() == []


@pytest.mark.usefixtures("small_start")
def test_contacts_that_are_kept_for_viewers_outlive_growth(make_sim: MakeSim) -> None:
  growing = make_sim("warp", spec=FALLING, nconmax="auto", njmax="auto")
  roomy = make_sim("warp", spec=FALLING)
  for sim in (growing, roomy):
    sim.contacts(0)
    fall(sim, 60)
  assert growing.buffer_sizes["njmax"] > 8
  one, other = growing.contacts(0), roomy.contacts(0)
  count = int(other.found.sum())
  assert count > 0
  assert torch.equal(one.found[:count], other.found[:count])
  assert not one.found[count:].any()
  assert torch.equal(one.force[:count], other.force[:count])


@pytest.mark.usefixtures("small_start")
def test_a_saved_state_brings_its_sizes(make_sim: MakeSim) -> None:
  first = make_sim("warp", spec=FALLING, nconmax="auto", njmax="auto")
  fall(first, 60)
  second = make_sim("warp", spec=FALLING, nconmax="auto", njmax="auto")
  assert second.buffer_sizes != first.buffer_sizes
  second.load_state_dict(first.state_dict())
  assert second.buffer_sizes == first.buffer_sizes
  first.step()
  second.step()
  assert_same(first, second, STATE)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.usefixtures("small_start")
def test_a_recorded_step_is_recorded_again_with_more_room() -> None:
  sizes = SimulationCfg(integrator=None, nconmax="auto", njmax="auto")
  sim = Simulation(NUM_WORLDS, mujoco.MjSpec.from_string(FALLING), sizes, "cuda")
  graph = sim.capture(sim.step)
  for _ in range(300):
    graph()
    # Marks arrive without a wait; these steps are short.
    torch.cuda.synchronize()
  assert sim.buffer_sizes == {"nconmax": 64, "njmax": 64}
  assert graph.num_graphs == 1
  assert "buffers grew" in sim.overflow_report()[0]
  # All bodies lie on the floor again, even if a step went without some contacts.
  assert torch.allclose(sim.data.qpos[:, 2], torch.full((NUM_WORLDS,), 0.0995, device="cuda"), atol=2e-3)
  torch.cuda.set_sync_debug_mode("error")
  try:
    for _ in range(5):
      graph()
  finally:
    torch.cuda.set_sync_debug_mode("default")


def test_a_number_stays_as_it_is(make_sim: MakeSim) -> None:
  sim = make_sim("warp", spec=FALLING, nconmax=4)
  fall(sim, 60)
  assert sim.buffer_sizes == {"nconmax": 4, "njmax": 64}


def test_few_sizes_are_used() -> None:
  assert [buffers.size_for(count) for count in (0, 9, 13, 17, 33, 200, 257)] == [8, 12, 16, 24, 48, 256, 384]
  assert [buffers.grown(64, demand) for demand in (51, 52, 64, 100, 500)] == [64, 96, 96, 192, 768]


def test_the_start_has_room_for_the_initial_state_and_all_limits() -> None:
  sim = Simulation(1, _lying_spec(), SimulationCfg(engine="native"))
  sizes = buffers.starting_sizes(sim.mj_model)
  assert sizes["nconmax"] >= 8
  assert sizes["njmax"] >= 8 * 4 + 30
  assert sim.buffer_sizes == {}


def _lying_spec() -> mujoco.MjSpec:
  links = "".join(
    f'<body pos="{0.3 * i} 0 .05"><freejoint/><geom type="capsule" size=".05" fromto="0 0 0 .2 0 0" mass="1"/>'
    '<body pos=".2 0 .2"><joint name="j{0}" range="-1 1" limited="true" frictionloss=".1"/>'
    '<geom size=".02" mass="1" contype="0" conaffinity="0"/></body></body>'.format(i)
    for i in range(4)
  )
  return mujoco.MjSpec.from_string(f'<mujoco><worldbody><geom type="plane" size="0 0 1"/>{links}</worldbody></mujoco>')
