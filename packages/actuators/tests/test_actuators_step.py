"""What the captured step asks for: fixed memory, no host reads, and few operations."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import pytest
import torch
from actuator_models import build, chain
from mjlab_actuators import (
  ActuatorCfg,
  ActuatorCmd,
  ActuatorSet,
  DcMotorActuatorCfg,
  EnvelopedPdActuatorCfg,
  IdealPdActuatorCfg,
  LearnedMlpActuatorCfg,
  NativeMotorActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  TorqueSpeedEnvelope,
)
from torch.utils._python_dispatch import TorchDispatchMode

CHAIN = chain("a", "b", "c")
# What stops the host until the device is done, or has a size that only the device knows.
SYNCS = ("_local_scalar_dense", "nonzero", "masked_select", "is_nonzero", "unique", "equal.default")


class Operations(TorchDispatchMode):
  def __init__(self) -> None:
    super().__init__()
    self.names: list[str] = []

  def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
    self.names.append(str(func))
    return func(*args, **(kwargs or {}))


def make(*cfgs: ActuatorCfg) -> ActuatorSet:
  return build(CHAIN, *cfgs, num_envs=4, generator=torch.Generator().manual_seed(0))[1]


def pd(*joints: str, **delay: Any) -> ActuatorCfg:
  return IdealPdActuatorCfg(target_names_expr=joints, stiffness=1.0, damping=0.1, effort_limit=1.0, **delay)


def servo(*joints: str, **delay: Any) -> ActuatorCfg:
  return NativePositionActuatorCfg(target_names_expr=joints, stiffness=1.0, damping=0.1, **delay)


def dc_motor(*joints: str) -> ActuatorCfg:
  return DcMotorActuatorCfg(
    target_names_expr=joints, stiffness=1.0, damping=0.1, saturation_effort=1.0, velocity_limit=2.0
  )


def enveloped(*joints: str) -> ActuatorCfg:
  envelope = TorqueSpeedEnvelope(1.0, 2.0, 0.5, 0.6)
  return EnvelopedPdActuatorCfg(target_names_expr=joints, stiffness=1.0, damping=0.1, envelope=envelope)


_FOLDER = tempfile.TemporaryDirectory()
NETWORK = Path(_FOLDER.name) / "network.pt"
torch.save({"0.weight": torch.ones(4, 6), "0.bias": torch.ones(4), "2.weight": torch.ones(1, 4)}, NETWORK)


def learned(*joints: str, **delay: Any) -> ActuatorCfg:
  return LearnedMlpActuatorCfg(target_names_expr=joints, network_file=NETWORK, effort_limit=1.0, **delay)


CASES: dict[str, tuple[tuple[ActuatorCfg, ...], int]] = {
  "servo": ((servo(".*"),), 1),
  "two servo configs out of order": ((servo("c", "b"), servo("a")), 1),
  "three native models": (
    (
      servo("a"),
      NativeVelocityActuatorCfg(target_names_expr=("b",), damping=1.0),
      NativeMotorActuatorCfg(target_names_expr=("c",)),
    ),
    3,
  ),
  "servo with delay": ((servo(".*", delay_min_lag=1, delay_max_lag=1),), 10),
  "servo with random delay": ((servo(".*", delay_max_lag=3),), 12),
  "pd": ((pd(".*"),), 7),
  "two pd configs out of order": ((pd("c"), pd("a", "b")), 7),
  "pd with delay": ((pd(".*", delay_min_lag=1, delay_max_lag=1),), 17),
  "two dc motors": ((dc_motor("c"), dc_motor("a", "b")), 15),
  "two enveloped motors": ((enveloped("c"), enveloped("a", "b")), 16),
  "two learned motors": ((learned("c"), learned("a", "b")), 32),
  "learned motor with delay": ((learned(".*", delay_min_lag=1, delay_max_lag=1),), 40),
  "pd and servo interleaved": ((pd("a"), servo("b"), pd("c")), 11),
}


@pytest.mark.parametrize(("cfgs", "budget"), CASES.values(), ids=CASES.keys())
def test_a_substep_costs_few_operations_and_none_that_syncs(cfgs: tuple[ActuatorCfg, ...], budget: int) -> None:
  actuators = make(*cfgs)
  args = [torch.randn(4, 3, dtype=torch.float64) for _ in range(5)]
  mask = torch.tensor([True, False, True, False])
  with Operations() as resetting:
    actuators.reset(mask, *args[:3])
  with Operations() as stepping:
    actuators.compute(*args)
  assert len(stepping.names) <= budget, stepping.names
  assert not [name for name in stepping.names + resetting.names if any(sync in name for sync in SYNCS)]


LATE: dict[str, Any] = {"delay_min_lag": 1, "delay_max_lag": 3}
SPLITS = [((".*",),), (("c",), ("a", "b")), (("b",), ("c",), ("a",))]


@pytest.mark.parametrize("delay", [{}, LATE], ids=["at once", "late"])
@pytest.mark.parametrize("make_cfg", [servo, pd, dc_motor, enveloped, learned])
def test_a_substep_costs_the_same_for_any_number_of_configs_of_a_model(make_cfg: Any, delay: dict[str, Any]) -> None:
  counts = []
  for split in SPLITS:
    # Groups of a actuator differ in their numbers, which is why there are several.
    cfgs = [replace(make_cfg(*joints), armature=0.01 * k, **delay) for k, joints in enumerate(split)]
    if make_cfg is not learned:
      for k, cfg in enumerate(cfgs):
        cfg.stiffness = 1.0 + k
    actuators = make(*cfgs)
    args = [torch.randn(4, 3, dtype=torch.float64) for _ in range(5)]
    with Operations() as stepping:
      actuators.compute(*args)
    with Operations() as resetting:
      actuators.reset(torch.ones(4, dtype=torch.bool), *args[:3])
    counts.append((len(actuators.groups), len(stepping.names), len(resetting.names)))
  assert counts[0][0] == 1
  # A whole robot in its own order needs no selection of columns.
  assert counts[1] == counts[2]
  assert all(few <= many <= few + 1 for few, many in zip(counts[0], counts[1], strict=True))


@pytest.mark.parametrize("cfgs", [cfgs for cfgs, _ in CASES.values()], ids=CASES.keys())
def test_memory_that_lives_across_substeps_is_written_in_place(cfgs: tuple[ActuatorCfg, ...]) -> None:
  ctrl = torch.zeros(4, 3, dtype=torch.float64)
  _, actuators = build(CHAIN, *cfgs, num_envs=4, generator=torch.Generator().manual_seed(0), ctrl=ctrl)
  args = [torch.randn(4, 3, dtype=torch.float64) for _ in range(5)]

  def addresses() -> dict[str, int]:
    found = {"ctrl": actuators.ctrl.data_ptr()}
    for i, actuator in enumerate(actuators.groups):
      owners = {"actuator": actuator, "delay": actuator.delay, "history": getattr(actuator, "history", None)}
      for where, owner in owners.items():
        for name, value in vars(owner).items() if owner is not None else ():
          if isinstance(value, torch.Tensor):
            found[f"{i}.{where}.{name}"] = value.data_ptr()
    return found

  before = addresses()
  for k in range(4):
    actuators.compute(*args)
    actuators.reset(torch.tensor([k % 2 == 0] * 4), *args[:3])
  assert addresses() == before
  assert actuators.ctrl.data_ptr() == ctrl.data_ptr()
  assert torch.equal(actuators.ctrl, ctrl)
  assert ctrl.abs().sum() > 0


def test_only_models_in_torch_need_measurements() -> None:
  assert not make(servo(".*")).needs_feedback
  assert make(servo("a"), pd("b", "c")).needs_feedback


def test_single_precision_follows_the_engine() -> None:
  for cfgs in ([pd("a", delay_max_lag=2), servo("b", "c")], [dc_motor("a"), enveloped("b"), learned("c")]):
    _, actuators = build(CHAIN, *cfgs, num_envs=2, dtype=torch.float32)
    assert actuators.compute(*(torch.zeros(2, 3) for _ in range(5))).dtype == torch.float32
    for actuator in actuators.groups:
      columns = len(actuator.target_names)
      assert actuator.compute(ActuatorCmd(*(torch.zeros(2, columns) for _ in range(5)))).dtype == torch.float32


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_recorded_substeps_equal_eager_ones_on_a_gpu() -> None:
  spec = mujoco.MjSpec.from_string(CHAIN)
  cfgs = [pd("a", delay_min_lag=2, delay_max_lag=2), servo("b"), pd("c", delay_min_lag=2, delay_max_lag=2)]
  recorded, eager = ActuatorSet(cfgs), ActuatorSet(cfgs)
  recorded.edit_spec(spec)
  model = spec.compile()
  for actuators in (recorded, eager):
    actuators.build(model, num_envs=4, device="cuda", dtype=torch.float32)
  args = [torch.zeros(4, 3, device="cuda") for _ in range(5)]
  mask = torch.zeros(4, dtype=torch.bool, device="cuda")

  def substep(actuators: ActuatorSet) -> None:
    actuators.reset(mask, *args[:3])
    actuators.compute(*args)

  stream = torch.cuda.Stream()
  with torch.cuda.stream(stream):
    substep(recorded)
  torch.cuda.synchronize()
  graph = torch.cuda.CUDAGraph()
  with torch.cuda.graph(graph, stream=stream):
    substep(recorded)
  recorded.load_state_dict(eager.state_dict())
  for k in range(12):
    for tensor in args:
      tensor.normal_()
    mask.copy_(torch.arange(4, device="cuda") == k)
    graph.replay()
    substep(eager)
    assert torch.equal(recorded.ctrl, eager.ctrl), k
