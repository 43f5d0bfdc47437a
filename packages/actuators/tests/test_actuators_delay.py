"""Targets arrive late by exactly the lag, from the pose given at reset on, and worlds do not see each other."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from actuator_models import build, chain
from mjlab_actuators import (
  ActuatorCfg,
  ActuatorSet,
  DcMotorActuatorCfg,
  EnvelopedPdActuatorCfg,
  IdealPdActuatorCfg,
  NativeDcMotorActuatorCfg,
  NativeGeneralActuatorCfg,
  NativeMotorActuatorCfg,
  NativeMuscleActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  TorqueSpeedEnvelope,
  XmlActuatorCfg,
)

MOTORS = '<motor name="m" joint="a"/><motor name="n" joint="b"/>'
WORLDS = 5
EVERY = torch.ones(WORLDS, dtype=torch.bool)


def make(cfg: ActuatorCfg) -> ActuatorSet:
  xml = chain("a", "b", actuators=MOTORS if isinstance(cfg, XmlActuatorCfg) else "")
  return build(xml, cfg, num_envs=WORLDS, generator=torch.Generator().manual_seed(0))[1]


def step(actuators: ActuatorSet, value: float) -> torch.Tensor:
  """All three targets at `value`, feedback zero."""
  target, zero = torch.full((WORLDS, 2), value, dtype=torch.float64), torch.zeros(WORLDS, 2, dtype=torch.float64)
  return actuators.compute(target, target, target, zero, zero).clone()


def reset(actuators: ActuatorSet, value: float, mask: torch.Tensor = EVERY) -> None:
  target = torch.full((WORLDS, 2), value, dtype=torch.float64)
  actuators.reset(mask, target, target, target)


def delayed(kind: type[ActuatorCfg], **delay: int) -> ActuatorCfg:
  gains = {
    NativePositionActuatorCfg: {"stiffness": 1.0, "damping": 0.0},
    NativeVelocityActuatorCfg: {"damping": 1.0},
    # Position, velocity and effort targets each count once: these models return their sum.
    IdealPdActuatorCfg: {"stiffness": 1.0, "damping": 1.0},
    DcMotorActuatorCfg: {"stiffness": 1.0, "damping": 1.0, "saturation_effort": 1e3, "velocity_limit": 1.0},
    EnvelopedPdActuatorCfg: {"stiffness": 1.0, "damping": 1.0, "envelope": TorqueSpeedEnvelope(1.0, 2.0, 1e3, 1e3)},
  }.get(kind, {})
  return kind(target_names_expr=(".*",), **gains, **delay)  # pyright: ignore[reportArgumentType]  # ty: ignore[invalid-argument-type]


KINDS = [
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  NativeMotorActuatorCfg,
  IdealPdActuatorCfg,
  DcMotorActuatorCfg,
  EnvelopedPdActuatorCfg,
  XmlActuatorCfg,
]
SUMMING = (IdealPdActuatorCfg, DcMotorActuatorCfg, EnvelopedPdActuatorCfg)


GENERAL: dict[str, Any] = {"target_names_expr": (".*",), "gain_prm": (2.0,)}
MOTOR: dict[str, Any] = {"target_names_expr": (".*",), "torque_constant": 1.0, "resistance": 1.0}
EVERY_INPUT = ("position_target", "velocity_target", "effort_target")


@pytest.mark.parametrize("lag", [1, 3])
@pytest.mark.parametrize(
  ("cfg", "fields"),
  [
    (delayed(NativePositionActuatorCfg), ("position_target",)),
    (delayed(NativeVelocityActuatorCfg), ("velocity_target",)),
    (delayed(NativeMotorActuatorCfg), ("effort_target",)),
    (delayed(XmlActuatorCfg), ("effort_target",)),
    *((delayed(kind), EVERY_INPUT) for kind in SUMMING),
    *((NativeGeneralActuatorCfg(command_field=field, **GENERAL), (field,)) for field in EVERY_INPUT),
    (NativeMuscleActuatorCfg(target_names_expr=(".*",), length_range=(0.0, 1.0), force=1.0), ("effort_target",)),
    (NativeDcMotorActuatorCfg(**MOTOR), ("effort_target",)),
    (NativeDcMotorActuatorCfg(inputs=EVERY_INPUT, stiffness=1.0, damping=1.0, **MOTOR), EVERY_INPUT),
    (NativeDcMotorActuatorCfg(inputs=("velocity_target",), damping=1.0, **MOTOR), ("velocity_target",)),
  ],
)
def test_a_constant_lag_shifts_the_targets_by_that_many_substeps(
  cfg: ActuatorCfg, fields: tuple[str, ...], lag: int
) -> None:
  # Different gains show which target is which in a sum.
  gains = {"stiffness": 0.5, "damping": 2.0} if isinstance(cfg, SUMMING) else {}
  actuators = make(replace(cfg, delay_min_lag=lag, delay_max_lag=lag, **gains))

  def rows(value: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    # The hundreds show which target is which.
    position, velocity, effort = (torch.full((WORLDS, 2), base + value).double() for base in (100.0, 200.0, 300.0))
    return position, velocity, effort

  actuators.reset(EVERY, *rows(-1.0))
  zero = torch.zeros(WORLDS, 2, dtype=torch.float64)
  for k in range(8):
    late = k - lag if k >= lag else -1
    served = [100.0 * (1 + EVERY_INPUT.index(field)) + late for field in fields]
    wanted = [0.5 * served[0] + 2.0 * served[1] + served[2]] if isinstance(cfg, SUMMING) else served
    assert actuators.compute(*rows(float(k)), zero, zero)[0].tolist() == 2 * wanted


@pytest.mark.parametrize("kind", KINDS)
def test_reset_starts_from_the_given_pose_and_leaves_other_worlds_bit_identical(kind: type[ActuatorCfg]) -> None:
  mask = torch.tensor([False, True, False, False, True])
  cfg = delayed(kind, delay_min_lag=1, delay_max_lag=3)
  runs = []
  for resets in (False, True):
    actuators = make(cfg)
    reset(actuators, 0.0)
    for k in range(5):
      step(actuators, float(k))
    if resets:
      reset(actuators, 100.0, mask)
    else:
      # Every reset draws for all worlds, so the twin draws too.
      reset(actuators, 100.0, torch.zeros(WORLDS, dtype=torch.bool))
    runs.append(torch.stack([step(actuators, 50.0 + k) for k in range(4)]))
  without, with_reset = runs
  assert torch.equal(without[:, ~mask], with_reset[:, ~mask])
  unit = 3.0 if kind in SUMMING else 1.0
  assert torch.all(with_reset[0, mask] == unit * 100.0)
  assert not (without == unit * 100.0).any()


def test_the_lag_stays_within_bounds_in_every_substep_of_every_episode() -> None:
  cfg = NativeMotorActuatorCfg(
    target_names_expr=(".*",), delay_min_lag=2, delay_max_lag=4, delay_hold_prob=0.5, delay_update_period=3
  )
  actuators = make(cfg)
  reset(actuators, 0.0)
  seen = set()
  for episode in range(6):
    age = torch.arange(12, dtype=torch.float64)
    reset(actuators, -1.0)
    for k in age.tolist():
      lag = k - step(actuators, k)[:, 0]
      # Younger than its lag, a world serves the pose given at reset, which was there "for ever".
      settled = lag[lag <= k]
      assert torch.all((settled >= 2) & (settled <= 4)), (episode, k)
      seen.update(settled.tolist())
      if k < 2:
        assert settled.numel() == 0
  assert seen == {2.0, 3.0, 4.0}


def test_measurements_are_never_delayed() -> None:
  actuators = make(delayed(IdealPdActuatorCfg, delay_min_lag=2, delay_max_lag=2))
  reset(actuators, 0.0)
  zero = torch.zeros(WORLDS, 2, dtype=torch.float64)
  position = torch.full((WORLDS, 2), 0.5, dtype=torch.float64)
  velocity = torch.full((WORLDS, 2), 0.25, dtype=torch.float64)
  assert torch.all(actuators.compute(zero, zero, zero, position, velocity) == -0.75)


def test_gains_changed_at_reset_act_on_delayed_targets() -> None:
  actuators = make(delayed(IdealPdActuatorCfg, delay_min_lag=2, delay_max_lag=2))
  reset(actuators, 1.0)
  actuators.groups[0].expand("stiffness").fill_(10.0)
  assert torch.all(step(actuators, 0.0) == 12.0)


def test_saved_and_loaded_delays_continue_alike() -> None:
  cfg = delayed(IdealPdActuatorCfg, delay_min_lag=1, delay_max_lag=1)
  first, second = make(cfg), make(cfg)
  reset(first, 3.0)
  reset(second, 0.0)
  for k in range(3):
    step(first, float(k))
  second.load_state_dict(first.state_dict())
  assert torch.equal(step(first, 9.0), step(second, 9.0))
