"""Recorded steps do what eager steps do."""

import sys
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import mujoco
import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sim import Simulation, SimulationCfg, StepGraph
from mjlab_sim.tensors import versions
from mjlab_sim.warp import launching
from sim_world import SIZES, WORLD, MakeSim, scatter

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")


def drive(sim: Simulation, steps: int) -> list[torch.Tensor]:
  """Steps with writes, resets, model writes and rays in between; what was read in each."""
  scatter(sim)
  caster = sim.make_ray_caster(3)
  down = torch.tensor([0.0, 0.0, -1.0], dtype=sim.dtype, device=sim.device).expand(sim.num_envs, 3, 3)
  read = []
  for step in range(steps):
    sim.data.ctrl.copy_(torch.cos(sim.data.qpos[:, :3]))
    sim.step()
    if step % 7 == 3:
      sim.reset(torch.arange(sim.num_envs, device=sim.device) % 2 == step % 2)
    if step % 5 == 2:
      sim.data.qvel[1:, 18] += 0.1
    if step == 20:
      sim.expand_model_fields(["body_mass"])
      sim.model.body_mass[1] *= 1.5
      sim.recompute_constants()
    hits = caster.cast(sim.data.site_xpos + 0.5, down)
    read += [sim.data.qpos.clone(), sim.data.xpos.clone(), sim.data.sensordata.clone(), hits.distance.clone()]
  return read


@pytest.mark.warp
def test_captured_steps_are_bit_equal_to_eager_ones_on_a_cpu(make_sim: MakeSim) -> None:
  captured, eager = make_sim("warp"), make_sim("warp", capture=False)
  for a, b in zip(drive(captured, 50), drive(eager, 50), strict=True):
    assert torch.equal(a, b)


def test_where_nothing_is_recorded_a_step_graph_is_a_plain_call(sim: Simulation) -> None:
  order: list[str] = []

  def body() -> None:
    order.append("before")
    sim.step()
    sim.graph_break(lambda: order.append("between"))
    assert not sim.is_capturing
    order.append("after")

  graph = sim.capture(body)
  assert not graph.recorded
  assert graph.num_graphs == 0
  graph()
  graph()
  graph.invalidate()
  graph()
  assert order == ["before", "between", "after"] * 3
  sim.graph_break(lambda: order.append("outside"))
  assert order[-1] == "outside"


def test_a_step_graph_leaves_nothing_stale(sim: Simulation) -> None:
  graph = sim.capture(lambda: sim.data.qpos.add_(0.01))
  epoch = sim.version
  graph()
  assert sim._fresh._state_version == versions(sim._fresh._kinematic)
  assert sim.version > epoch


# Effects of a recording, with a recorder that only notes calls


class FakeRecorder:
  num_graphs = 1

  def __init__(self, device: torch.device, generators: object) -> None:
    self.segments: list[Callable[[], object]] = []

  def record(self, fn: Callable[[], object]) -> None:
    fn()

  def interrupt(self, fn: Callable[[], object]) -> None:
    self.segments.append(fn)

  def replay(self) -> None:
    for segment in self.segments:
      segment()


@pytest.fixture
def recording(
  make_sim: MakeSim, monkeypatch: pytest.MonkeyPatch
) -> Callable[[Callable[[Simulation], object]], StepGraph]:
  """A step graph of a function of its simulation, that is recorded after three calls."""
  monkeypatch.setitem(sys.modules, "mjlab_sim.warp.recorder", SimpleNamespace(Recorder=FakeRecorder))

  def make(fn: Callable[[Simulation], object]) -> StepGraph:
    sim = make_sim("native")
    graph = sim.capture(lambda: fn(sim))
    graph.recorded = True
    return graph

  return make


@pytest.mark.parametrize(
  ("pool", "conditional", "message"),
  [
    (False, True, r"H100 cannot capture a step: Warp's memory pool is disabled on it\. Run .* --env\.sim\.no-capture"),
    (True, False, r"H100 cannot capture a step: the driver has no conditional graph nodes .* --env\.sim\.no-capture"),
    (False, False, r"memory pool is disabled on it and the driver has no conditional graph nodes"),
  ],
)
def test_a_gpu_that_cannot_capture_is_refused_with_the_reason_and_the_way_out(
  monkeypatch: pytest.MonkeyPatch, pool: bool, conditional: bool, message: str
) -> None:
  gpu = SimpleNamespace(is_cuda=True, name="H100")
  monkeypatch.setattr("warp.is_mempool_enabled", lambda device: pool)
  monkeypatch.setattr("warp.is_conditional_graph_supported", lambda: conditional)
  with pytest.raises(MjlabError, match=message):
    launching.check_capture(gpu)


def test_a_gpu_that_can_capture_and_a_cpu_are_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setattr("warp.is_mempool_enabled", lambda device: device.name == "H100")
  monkeypatch.setattr("warp.is_conditional_graph_supported", lambda: True)
  launching.check_capture(SimpleNamespace(is_cuda=True, name="H100"))
  launching.check_capture(SimpleNamespace(is_cuda=False, name="cpu"))


def test_a_recording_that_is_outdated_before_it_ends_is_never_replayed(recording: Any) -> None:
  was_recorded: list[bool] = []

  def body(sim: Simulation) -> None:
    was_recorded.append(sim.is_capturing)
    if len(was_recorded) == 4:
      graph.invalidate()

  graph = recording(body)
  for _ in range(5):
    graph()
  # The step of the lost recording is taken eagerly; the next one is recorded.
  assert was_recorded == [False, False, False, True, False, True]
  assert graph.num_graphs == 1


def test_an_error_while_recording_leaves_nothing_half_recorded(recording: Any) -> None:
  calls: list[bool] = []

  def body(sim: Simulation) -> None:
    calls.append(sim.is_capturing)
    if len(calls) == 4:
      raise ZeroDivisionError

  graph = recording(body)
  for _ in range(3):
    graph()
  with pytest.raises(ZeroDivisionError):
    graph()
  assert (graph.num_graphs, calls[-1]) == (0, True)
  graph()
  assert (graph.num_graphs, calls[-1]) == (1, True)


def test_contacts_are_in_a_new_recording_after_the_first_request(recording: Any) -> None:
  sims: list[Simulation] = []
  graph = recording(lambda sim: (sims.append(sim), sim.step()))
  for _ in range(4):
    graph()
  sim = sims[0]
  assert graph.num_graphs == 1
  sim.contacts(0)
  assert graph.num_graphs == 0
  graph()
  graph()
  sim.contacts(1)
  assert graph.num_graphs == 1


@pytest.mark.parametrize("eager", [False, True])
@pytest.mark.parametrize(
  ("change", "name"),
  [(lambda sim: sim.contacts(0), "contacts"), (lambda sim: sim.expand_model_fields(["body_mass"]), "body_mass")],
  ids=["contacts", "model field"],
)
def test_memory_is_not_replaced_under_a_recorded_step(
  recording: Any, change: Callable[[Simulation], object], name: str, eager: bool
) -> None:
  calls: list[Simulation] = []

  def late(sim: Simulation) -> None:
    calls.append(sim)
    if len(calls) > 3:
      change(sim)

  graph = recording((lambda sim: sim.graph_break(lambda: late(sim))) if eager else late)
  for _ in range(3):
    graph()
  with pytest.raises(MjlabError, match=f"{name}.* inside a recorded step; do it before the first step"):
    graph()
  sim = calls[0]
  assert not sim.is_capturing
  change(sim)
  graph()


# On a GPU


@pytest.fixture
def gpu_sim() -> Iterator[Simulation]:
  sim = Simulation(8, mujoco.MjSpec.from_string(WORLD), SimulationCfg(**SIZES), "cuda")
  yield sim
  sim.close()


@needs_gpu
def test_a_replay_is_an_eager_step_on_a_gpu() -> None:
  def make(capture: bool) -> tuple[Simulation, StepGraph, torch.Tensor]:
    sim = Simulation(8, mujoco.MjSpec.from_string(WORLD), SimulationCfg(capture=capture, **SIZES), "cuda")
    scatter(sim)
    mask = torch.zeros(8, dtype=torch.bool, device="cuda")
    count = torch.zeros((), dtype=torch.int64, device="cuda")
    heights = torch.zeros(8, device="cuda")

    def body() -> None:
      sim.data.ctrl.copy_(torch.cos(sim.data.qpos[:, :3]))
      sim.step()
      sim.step()
      count.add_(1)
      mask.copy_((torch.arange(8, device="cuda") + count) % 4 == 0)
      sim.reset(mask)
      sim.data.qvel[:, 18] += 0.1
      heights.copy_(sim.data.xpos[:, 5, 2])

    return sim, sim.capture(body), heights

  (a, graph, a_heights), (b, eager, b_heights) = make(True), make(False)
  for step in range(20):
    graph()
    eager()
    assert graph.num_graphs == (1 if step >= 3 else 0)
    # The order of contacts on a GPU is not fixed, so that sums of floats are not either.
    torch.testing.assert_close(a.data.qpos, b.data.qpos, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(a_heights, b_heights, rtol=1e-3, atol=1e-3)
  torch.testing.assert_close(a.data.xpos[:, 5, 2], a_heights)
  a.close()
  b.close()


@needs_gpu
def test_a_recording_is_split_around_an_eager_call_on_a_gpu(gpu_sim: Simulation) -> None:
  seen: list[float] = []
  value = torch.zeros((), device="cuda")

  def body() -> None:
    value.add_(1.0)
    gpu_sim.graph_break(lambda: seen.append(value.item()))
    value.mul_(2.0)
    gpu_sim.graph_break(lambda: value.sub_(1.0))
    gpu_sim.step()

  graph = gpu_sim.capture(body)
  expected = 0.0
  for _ in range(8):
    graph()
    assert seen[-1] == expected + 1.0
    expected = 2.0 * (expected + 1.0) - 1.0
    assert value.item() == expected
  assert graph.num_graphs == 3
  assert len(seen) == 8


@needs_gpu
def test_registered_generators_draw_new_numbers_in_each_replay_on_a_gpu(gpu_sim: Simulation) -> None:
  generator = torch.Generator("cuda").manual_seed(3)
  drawn = torch.zeros(16, device="cuda")
  graph = gpu_sim.capture(
    lambda: drawn.copy_(torch.randn(16, generator=generator, device="cuda")), generators=(generator,)
  )
  replayed = []
  for _ in range(8):
    graph()
    replayed.append(drawn.clone())
  again = torch.Generator("cuda").manual_seed(3)
  for values in replayed:
    assert torch.equal(values, torch.empty(16, device="cuda").normal_(generator=again))


@needs_gpu
def test_expanding_a_field_records_again_on_a_gpu(gpu_sim: Simulation) -> None:
  graph = gpu_sim.capture(gpu_sim.step)
  for _ in range(5):
    graph()
  assert graph.num_graphs == 1
  gpu_sim.expand_model_fields(["opt.gravity"])
  assert graph.num_graphs == 0
  gpu_sim.model.opt.gravity[:, 2] = torch.linspace(-9.0, 9.0, 8, device="cuda")
  for _ in range(5):
    graph()
  assert graph.num_graphs == 1
  assert gpu_sim.data.qvel[-1, 2] > gpu_sim.data.qvel[0, 2]


@needs_gpu
def test_a_replay_does_not_wait_for_the_gpu(gpu_sim: Simulation) -> None:
  graph = gpu_sim.capture(gpu_sim.step)
  for _ in range(5):
    graph()
  try:
    torch.cuda.set_sync_debug_mode("error")
    graph()
  finally:
    torch.cuda.set_sync_debug_mode("default")
