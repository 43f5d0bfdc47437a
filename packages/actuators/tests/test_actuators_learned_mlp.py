"""The learned motor: what the network is fed with, what is loaded, and what a reset leaves alone."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from actuator_models import build, chain
from mjlab_actuators import ActuatorSet, LearnedMlp, LearnedMlpActuatorCfg
from torch import nn

WORLDS, HISTORY = 3, 3


def network(width: int = 2 * HISTORY, outputs: int = 1, seed: int = 0) -> nn.Sequential:
  torch.manual_seed(seed)
  return nn.Sequential(nn.Linear(width, 16), nn.Softsign(), nn.Linear(16, 8), nn.Softsign(), nn.Linear(8, outputs))


def picker(column: int) -> nn.Sequential:
  """A network that returns one of its inputs."""
  layer = nn.Linear(2 * HISTORY, 1, bias=False)
  layer.load_state_dict({"weight": torch.eye(2 * HISTORY)[[column]]})
  return nn.Sequential(layer)


def scripted(net: nn.Module, path: Path) -> Path:
  with warnings.catch_warnings():
    warnings.simplefilter("ignore", FutureWarning)
    torch.jit.script(net).save(str(path))
  return path


def stored(net: nn.Module, path: Path) -> Path:
  torch.save(net.state_dict(), path)
  return path


def make(*cfgs: LearnedMlpActuatorCfg) -> ActuatorSet:
  return build(chain("a", "b", "c"), *cfgs, num_envs=WORLDS)[1]


def cfg(path: Path, *joints: str, **changes: Any) -> LearnedMlpActuatorCfg:
  return LearnedMlpActuatorCfg(target_names_expr=joints or (".*",), network_file=path, **changes)


def samples(steps: int, seed: int = 0) -> torch.Tensor:
  """Targets, positions and velocities of some substeps, (steps, 3, num_envs, joints)."""
  return torch.randn(steps, 3, WORLDS, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def step(actuators: ActuatorSet, sample: torch.Tensor) -> torch.Tensor:
  """Efforts of one substep in the order of the joints, (num_envs, joints)."""
  target, position, velocity = sample
  # Velocity and effort targets are not the network's business, whatever they are.
  other = torch.full_like(target, float("nan"))
  ctrl = actuators.compute(target, other, other, position, velocity)
  place = {column.target.name: column.ctrl for actuator in actuators.groups for column in actuator.columns}
  return ctrl[:, [actuators.ctrl_ids.index(place[joint]) for joint in "abc"]]


@pytest.mark.parametrize("order", ["pos_vel", "vel_pos"])
@pytest.mark.parametrize("column", range(2 * HISTORY))
def test_columns_are_errors_and_velocities_newest_first(tmp_path: Path, order: Any, column: int) -> None:
  scales = {"position_scale": 2.0, "velocity_scale": 3.0, "effort_scale": 5.0}
  actuators = make(cfg(stored(picker(column), tmp_path / "n.pt"), input_order=order, **scales))
  given = samples(5)
  got = torch.stack([step(actuators, sample) for sample in given])
  is_error = (column < HISTORY) == (order == "pos_vel")
  series = 2.0 * (given[:, 0] - given[:, 1]) if is_error else 3.0 * given[:, 2]
  age = column % HISTORY
  for k in range(5):
    torch.testing.assert_close(got[k], 5.0 * series[max(k - age, 0)], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("save", [scripted, stored])
def test_every_joint_of_every_world_is_one_row_of_the_network(tmp_path: Path, save: Any) -> None:
  net = network()
  actuators = make(cfg(save(net, tmp_path / "n.pt"), effort_limit={"[ab]": 0.15, "c": 0.05}))
  given = samples(4)
  effort = [step(actuators, sample) for sample in given][-1]
  errors, velocities = given[:, 0] - given[:, 1], given[:, 2]
  for world in range(WORLDS):
    for joint, limit in enumerate((0.15, 0.15, 0.05)):
      row = [errors[k, world, joint] for k in (3, 2, 1)] + [velocities[k, world, joint] for k in (3, 2, 1)]
      expected = np.clip(net(torch.tensor([row], dtype=torch.float32)).item(), -limit, limit)
      assert effort[world, joint].item() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("name", "kind"), [("elu", nn.ELU), ("relu", nn.ReLU), ("tanh", nn.Tanh)])
def test_a_state_dict_has_the_configured_activation(tmp_path: Path, name: Any, kind: type[nn.Module]) -> None:
  net = nn.Sequential(nn.Linear(2 * HISTORY, 4), kind(), nn.Linear(4, 1))
  actuators = make(cfg(stored(net, tmp_path / "n.pt"), activation=name))
  sample = samples(1)[0]
  row = [sample[0, 0, 0] - sample[1, 0, 0]] * 3 + [sample[2, 0, 0]] * 3
  expected = net(torch.tensor([row], dtype=torch.float32)).item()
  assert step(actuators, sample)[0, 0].item() == pytest.approx(expected, abs=1e-6)


def test_the_output_is_clipped_to_the_torque_speed_line_without_forced_braking(tmp_path: Path) -> None:
  path = stored(picker(0), tmp_path / "n.pt")
  motor = cfg(path, saturation_effort=10.0, velocity_limit=20.0, effort_limit=8.0, position_scale=1e3)
  one, zero = torch.ones(WORLDS, 3, dtype=torch.float64), torch.zeros(WORLDS, 3, dtype=torch.float64)
  actuators = make(motor)
  speeds = torch.tensor([2.0, 15.0, 30.0], dtype=torch.float64)
  assert actuators.compute(one, zero, zero, zero, one * speeds)[0].tolist() == pytest.approx([8.0, 2.5, 0.0])
  assert actuators.compute(-one, zero, zero, zero, one * speeds)[0].tolist() == pytest.approx([-8.0, -8.0, -8.0])
  motor.braking = True
  assert make(motor).compute(one, zero, zero, zero, one * speeds)[0].tolist() == pytest.approx([8.0, 2.5, -5.0])


def test_a_reset_restarts_the_history_and_leaves_other_worlds_bit_identical(tmp_path: Path) -> None:
  path, mask = stored(network(), tmp_path / "n.pt"), torch.tensor([False, True, False])
  given, after = samples(4), samples(3, seed=1)
  twin, actuators, fresh = (make(cfg(path)) for _ in range(3))
  for sample in given:
    step(twin, sample)
    step(actuators, sample)
  zero = torch.zeros(WORLDS, 3, dtype=torch.float64)
  actuators.reset(mask, zero, zero, zero)
  for sample in after:
    untouched, effort, first = step(twin, sample), step(actuators, sample), step(fresh, sample)
    assert torch.equal(effort[~mask], untouched[~mask])
    # The first sample stands for those before it, as in a world that was just built.
    assert torch.equal(effort[mask], first[mask])


def test_the_delay_is_before_the_network_and_never_on_measurements(tmp_path: Path) -> None:
  path = stored(picker(0), tmp_path / "n.pt")
  actuators = make(cfg(path, delay_min_lag=2, delay_max_lag=2))
  given = samples(5)
  zero = torch.zeros(WORLDS, 3, dtype=torch.float64)
  actuators.reset(torch.ones(WORLDS, dtype=torch.bool), zero + 7.0, zero, zero)
  for k, sample in enumerate(given):
    target = given[k - 2, 0] if k >= 2 else zero + 7.0
    torch.testing.assert_close(step(actuators, sample), target - sample[1], rtol=1e-6, atol=1e-6)


def test_configs_of_one_network_are_one_batch_and_other_networks_another(tmp_path: Path) -> None:
  path, other = stored(network(), tmp_path / "n.pt"), stored(network(seed=1), tmp_path / "m.pt")
  whole, parts = make(cfg(path)), make(cfg(path, "c"), cfg(path, "a", "b"))
  assert [actuator.target_names for actuator in parts.groups] == [("a", "b", "c")]
  mixed = make(cfg(path, "a"), cfg(other, "b"), cfg(path, "c"))
  assert [actuator.target_names for actuator in mixed.groups] == [("a", "c"), ("b",)]
  for sample in samples(3):
    expected = step(whole, sample)
    assert torch.equal(step(parts, sample), expected)
    torch.testing.assert_close(step(mixed, sample)[:, [0, 2]], expected[:, [0, 2]])


def test_saved_and_loaded_histories_continue_alike(tmp_path: Path) -> None:
  path = stored(network(), tmp_path / "n.pt")
  first, second = make(cfg(path)), make(cfg(path))
  given = samples(4)
  for sample in given[:3]:
    step(first, sample)
  second.load_state_dict(first.state_dict())
  assert torch.equal(step(first, given[3]), step(second, given[3]))


def test_a_network_has_no_gains_to_be_changed(tmp_path: Path) -> None:
  (actuator,) = make(cfg(stored(network(), tmp_path / "n.pt"))).groups
  assert isinstance(actuator, LearnedMlp)
  with pytest.raises(ValueError, match=r"parameter 'stiffness' does not exist.*effort_limit"):
    actuator.expand("stiffness")
  assert not any(parameter.requires_grad for parameter in actuator.network.parameters())


def test_a_network_of_another_period_than_the_timestep_is_refused(tmp_path: Path) -> None:
  path = stored(network(), tmp_path / "n.pt")
  assert make(cfg(path, sample_period=0.002)).groups
  with pytest.raises(ValueError, match=r"trained on samples every 0.005 s, the model has a timestep of 0.002 s"):
    make(cfg(path, sample_period=0.005))


class Trap:
  """Runs when it is unpickled."""

  def __reduce__(self) -> tuple[Any, ...]:
    return print, ("sprung",)


def test_a_file_that_would_run_code_is_refused_and_runs_none(
  tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
  torch.save({"0.weight": Trap()}, tmp_path / "trap.pt")
  with pytest.raises(ValueError, match=r"network file .*trap.pt: .*Weights only load failed"):
    make(cfg(tmp_path / "trap.pt"))
  torch.save(network(), tmp_path / "whole.pt")
  with pytest.raises(ValueError, match=r"network file .*whole.pt: .*Weights only load failed"):
    make(cfg(tmp_path / "whole.pt"))
  assert "sprung" not in capsys.readouterr().out


@pytest.mark.parametrize("save", [scripted, stored])
def test_a_network_of_the_wrong_width_is_refused_by_name(tmp_path: Path, save: Any) -> None:
  with pytest.raises(ValueError, match=r"LearnedMlpActuatorCfg: network file .*wide.pt: does not take 6 inputs"):
    make(cfg(save(network(width=8), tmp_path / "wide.pt")))
  with pytest.raises(ValueError, match=r"pair.pt: makes \(2, 2\) of two rows; it must make one number of each"):
    make(cfg(save(network(outputs=2), tmp_path / "pair.pt")))
  path = save(network(width=8), tmp_path / "four.pt")
  assert make(cfg(path, history_length=4)).groups


@pytest.mark.parametrize(
  ("changes", "message"),
  [
    ({"path": "nowhere.pt"}, "LearnedMlpActuatorCfg: network file .*nowhere.pt: no such file"),
    ({"activation": "softsing"}, "activation 'softsing' does not exist. Nearest: softsign"),
    ({"input_order": "velpos"}, "input_order 'velpos' does not exist. Nearest: vel_pos"),
    ({"history_length": 0}, "history_length must be at least 1, got 0"),
    ({"effort_scale": 0.0}, "effort_scale must not be zero, got 0.0"),
    ({"position_scale": float("nan")}, "position_scale must be a number, got nan"),
    ({"effort_limit": -1.0}, "effort_limit must be positive, got -1.0"),
    ({"saturation_effort": 3.0}, "saturation_effort is given, but velocity_limit is not"),
    ({"velocity_limit": 3.0}, "velocity_limit is given, but saturation_effort is not"),
    ({"saturation_effort": 3.0, "velocity_limit": 0.0}, "velocity_limit must be positive, got 0.0"),
  ],
)
def test_impossible_settings_are_refused_by_name_at_build(
  tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
  path = stored(network(), tmp_path / "n.pt")
  with pytest.raises(ValueError, match=message):
    make(cfg(**({"path": path} | changes)))


def test_state_dicts_that_are_no_chain_of_linear_layers_are_refused(tmp_path: Path) -> None:
  torch.save({"0.weight": torch.zeros(1, 6), "1.running_mean": torch.zeros(1)}, tmp_path / "n.pt")
  with pytest.raises(ValueError, match=r"not a chain of linear layers; it also has: 1\.running_mean"):
    make(cfg(tmp_path / "n.pt"))
  torch.save({"conv.weight": torch.zeros(1, 6, 3)}, tmp_path / "n.pt")
  with pytest.raises(ValueError, match=r"'conv.weight' of shape \(1, 6, 3\) is not a linear layer"):
    make(cfg(tmp_path / "n.pt"))
  torch.save({"epoch": 3}, tmp_path / "n.pt")
  with pytest.raises(ValueError, match="not a chain of linear layers; it also has: epoch"):
    make(cfg(tmp_path / "n.pt"))
