"""Fits of a motor with friction and delay to its records."""

import csv
import math
import sys
from pathlib import Path
from typing import IO, Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_actuators import ActuatorSet, IdealPdActuatorCfg, LearnedMlpActuatorCfg
from mjlab_core import MjlabError
from mjlab_sysid import MotorFit, MotorFitCfg, MotorModel, fit_motor, read_records
from mjlab_sysid.motors.motor_model import fit_motor_model

PERIOD = 0.005
PENDULUM = f"""
<mujoco>
  <option timestep="{PERIOD}"/>
  <worldbody><body><joint name="hinge" axis="0 1 0" armature="0.02" damping="0.05"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3"/></body></worldbody>
</mujoco>
"""
KP, KD, LIMIT, FRICTION, DELAY = 12.0, 0.6, 4.0, 0.8, 2
HEADER = ("time", "position_target", "position", "velocity", "effort")


def motor(error: float, velocity: float) -> float:
  """Return the effort of the hidden motor for an error that is DELAY samples old."""
  drive = min(max(KP * error - KD * velocity, -LIMIT), LIMIT)
  return drive - FRICTION * math.tanh(velocity / 0.3)


def drive(effort_of: Any, seed: int, steps: int) -> np.ndarray:
  """Return rows of HEADER while `effort_of` (target, position, velocity) -> effort follows steps and sweeps."""
  spec = mujoco.MjSpec.from_string(PENDULUM)
  spec.add_actuator(name="m", target="hinge", trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()
  model = spec.compile()
  data, random = mujoco.MjData(model), np.random.default_rng(seed)
  rows, level, speed = [], 0.0, 1.0
  for step in range(steps):
    if step % 80 == 0:
      level, speed = random.uniform(-1.0, 1.0), random.uniform(2.0, 15.0)
    target = level + 0.3 * math.sin(speed * data.time)
    mujoco.mj_forward(model, data)
    position, velocity = data.qpos[0], data.qvel[0]
    effort = effort_of(target, position, velocity)
    rows.append((data.time, target, position, velocity, effort))
    data.ctrl[0] = effort
    mujoco.mj_step(model, data)
  return np.array(rows)


def hidden_motor() -> Any:
  late: list[float] = []

  def effort_of(target: float, position: float, velocity: float) -> float:
    late.append(target)
    return motor(late[max(len(late) - 1 - DELAY, 0)] - position, velocity)

  return effort_of


def built(cfg: Any, dtype: torch.dtype) -> ActuatorSet:
  """Build the actuator of the pendulum."""
  spec, actuators = mujoco.MjSpec.from_string(PENDULUM), ActuatorSet([cfg])
  actuators.edit_spec(spec)
  actuators.build(spec.compile(), num_envs=1, device="cpu", dtype=dtype)
  return actuators


def learned(fitted: MotorFit, folder: Path) -> LearnedMlpActuatorCfg:
  """Save a fit, and return the config that it shows for pasting."""
  fitted.save(folder / "motor.pt")
  shown = fitted.config(folder / "motor.pt").replace("(...,)", "('hinge',)")
  return eval(shown, {"LearnedMlpActuatorCfg": LearnedMlpActuatorCfg})


def write(path: Path, rows: Any, header: tuple[str, ...] = HEADER) -> Path:
  with path.open("w", newline="") as file:
    writer = csv.writer(file)
    writer.writerow(header)
    writer.writerows(rows)
  return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
  return write(tmp_path_factory.mktemp("motor") / "records.csv", drive(hidden_motor(), seed=0, steps=8000))


@pytest.fixture(scope="module")
def fitted(recorded: Path) -> MotorFit:
  return fit_motor(read_records([recorded]), MotorFitCfg(history_length=4, epochs=60))


def test_a_motor_with_friction_and_delay_is_recovered_far_better_than_by_pd(fitted: MotorFit) -> None:
  effort = fitted.held_out[:, 0]
  assert effort.square().mean().sqrt() > 1.0
  # In N m, of a motor that gives up to 4.
  assert fitted.held_out_error < 0.06
  assert fitted.train_error < 0.06
  # The best PD controller for these records does not have the gains of the hidden motor.
  assert fitted.pd_error > 15.0 * fitted.held_out_error
  assert fitted.curve[-1].held_out_error < 0.2 * fitted.curve[0].held_out_error


def test_the_parametric_motor_is_recovered_too(fitted: MotorFit) -> None:
  motor = fitted.motor
  found = (motor.stiffness, motor.damping, motor.delay, motor.friction, motor.effort_limit)
  assert found == pytest.approx((KP, KD, DELAY, FRICTION, LIMIT), rel=0.03)
  assert motor.friction_speed == pytest.approx(0.3, rel=0.1)
  assert math.isinf(motor.velocity_limit)
  # The records are of such a motor, so that no network is better.
  assert fitted.motor_error < fitted.held_out_error < 0.2 * fitted.pd_error


def test_an_envelope_and_a_delay_of_half_a_sample_are_found() -> None:
  parametric = MotorModel(30.0, 0.5, 1.5, 0.4, 0.1, math.inf, 6.0, 12.0)

  def limited(target: float, position: float, velocity: float) -> float:
    return float(parametric._replace(delay=0.0).efforts(np.array([[target, position, velocity, 0.0]]))[0])

  rows = drive(limited, seed=1, steps=1500)[:, 1:]
  rows[:, 3] = parametric.efforts(rows)
  found = fit_motor_model([rows], 0)
  assert math.isinf(found.effort_limit)
  for name in parametric._fields:
    assert getattr(found, name) == pytest.approx(getattr(parametric, name), rel=0.03), name


def test_the_learned_motor_moves_a_joint_like_the_real_one_on_new_targets(fitted: MotorFit, tmp_path: Path) -> None:
  kp, kd = fitted.pd_gains
  ideal = IdealPdActuatorCfg(target_names_expr=("hinge",), stiffness=kp, damping=kd)

  def effort_of(cfg: Any) -> Any:
    actuators = built(cfg, torch.float64)

    def effort(*numbers: float) -> float:
      target, position, velocity = (torch.tensor([[number]], dtype=torch.float64) for number in numbers)
      zero = torch.zeros_like(target)
      return actuators.compute(target, zero, zero, position, velocity).item()

    return effort

  real, like, pd = (
    drive(which, seed=7, steps=1600)[:, 2]
    for which in (hidden_motor(), effort_of(learned(fitted, tmp_path)), effort_of(ideal))
  )
  assert np.sqrt(np.mean(np.square(like - real))) < 0.01
  assert np.sqrt(np.mean(np.square(pd - real))) > 8.0 * np.sqrt(np.mean(np.square(like - real)))


def test_the_stored_network_gives_the_reported_efforts(fitted: MotorFit, tmp_path: Path) -> None:
  cfg = learned(fitted, tmp_path)
  assert [path.name for path in tmp_path.iterdir()] == ["motor.pt"]
  assert (cfg.sample_period, cfg.history_length) == (PERIOD, 4)
  cfg.validate(["hinge"])
  group: Any = built(cfg, torch.float32).groups[0]
  rows = torch.randn(5, 8)
  torch.testing.assert_close(group.network(rows), fitted.network(rows))


def test_the_same_seed_gives_the_same_network(recorded: Path) -> None:
  records = read_records([recorded])
  one, same, other = (fit_motor(records, MotorFitCfg(epochs=1, seed=seed)) for seed in (1, 1, 2))
  assert torch.equal(one.held_out, same.held_out)
  assert not torch.equal(one.held_out, other.held_out)


def test_training_ends_when_the_callback_returns_true(recorded: Path) -> None:
  fit = fit_motor(read_records([recorded]), MotorFitCfg(epochs=50), lambda progress: progress.epoch == 2)
  assert [point.epoch for point in fit.curve] == [1, 2]
  assert fit.held_out_error == fit.curve[-1].held_out_error


def test_held_out_samples_are_never_trained_on_and_windows_stay_in_their_segment(tmp_path: Path) -> None:
  # Training would follow the nonsense of the held-out efforts if it saw them.
  rows = drive(hidden_motor(), seed=3, steps=400)
  clean = write(tmp_path / "clean.csv", rows[:320])
  rows[320:, 4] = 1e3
  spoilt = write(tmp_path / "spoilt.csv", rows)
  cfg = MotorFitCfg(epochs=2, held_out=0.2)
  fit = fit_motor(read_records([spoilt]), cfg)
  assert fit.train_error < 10.0
  assert fit.held_out_error > 100.0
  two = fit_motor(read_records([clean, clean]), MotorFitCfg(epochs=1, history_length=5, held_out=0.25))
  assert len(two.held_out) == 2 * (80 - 4)


def test_a_plot_shows_errors_and_efforts(fitted: MotorFit, tmp_path: Path) -> None:
  fitted.save_plot(tmp_path / "motor.png")
  assert (tmp_path / "motor.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
  assert [path.name for path in tmp_path.iterdir()] == ["motor.png"]


def test_without_matplotlib_a_plot_says_what_to_install(
  fitted: MotorFit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  monkeypatch.setitem(sys.modules, "matplotlib", None)
  with pytest.raises(ModuleNotFoundError, match="mjlab-sysid with its extra 'plot'"):
    fitted.save_plot(tmp_path / "motor.png")
  assert not list(tmp_path.iterdir())


def test_a_failed_write_leaves_the_old_file(fitted: MotorFit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  path = tmp_path / "motor.pt"
  path.write_text("old")

  def fail(state: object, file: IO[bytes]) -> None:
    file.write(b"half")
    raise OSError("disk full")

  monkeypatch.setattr(torch, "save", fail)
  with pytest.raises(OSError, match="disk full"):
    fitted.save(path)
  assert path.read_text() == "old"
  assert [file.name for file in tmp_path.iterdir()] == ["motor.pt"]
  monkeypatch.undo()
  # Even the superuser cannot write this folder.
  with pytest.raises(OSError, match="motor"):
    fitted.save("/proc/motor.pt")


def table(rows: int = 12) -> list[list[float]]:
  return [[PERIOD * k, 0.1 * k, 0.05 * k, 0.2, math.sin(k)] for k in range(rows)]


@pytest.mark.parametrize(
  ("changes", "message"),
  [
    ({"history_length": 0}, "history_length must be at least 1, got 0"),
    ({"epochs": 0}, "epochs must be at least 1"),
    ({"hidden": ()}, "hidden must have at least 1 element"),
    ({"activation": "relo"}, "activation 'relo' does not exist. Nearest: relu"),
    ({"learning_rate": 0.0}, "learning_rate must be positive"),
    ({"held_out": 1.0}, r"held_out must be in \(0, 1\)"),
    ({"history_length": 5}, "stretch 1 of 1 has 12 rows; both parts, by held_out 0.2, need history_length 5 or more"),
  ],
)
def test_impossible_settings_are_refused_by_name(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
  records = read_records([write(tmp_path / "a.csv", table())])
  with pytest.raises(MjlabError, match=message):
    fit_motor(records, MotorFitCfg(**changes))


def test_a_constant_effort_is_refused(tmp_path: Path) -> None:
  records = read_records([write(tmp_path / "a.csv", [[*row[:4], 1.5] for row in table(40)])])
  with pytest.raises(MjlabError, match="'effort' never changes"):
    fit_motor(records)
