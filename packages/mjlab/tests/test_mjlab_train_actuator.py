"""`train-actuator`: from a CSV to a network that an actuator config loads."""

import contextlib
import os
import re
import signal
from pathlib import Path

import mjlab_pendulum
import pytest
import torch
from mjlab import cli
from mjlab.cli import _train_actuator
from mjlab_actuators import LearnedMlpActuatorCfg
from mjlab_envs import ManagerBasedRlEnv, mdp

QUICK = ["--epochs", "3", "--hidden", "8"]


@pytest.fixture
def records(tmp_path: Path) -> Path:
  """Two seconds of a motor that is a spring, with a column that is not read."""
  torch.manual_seed(0)
  error, velocity = torch.randn(2, 400).double()
  lines = ["time,position_target,position,velocity,effort,temperature"]
  for k in range(400):
    lines.append(f"{0.005 * k:.3f},{error[k]},0,{velocity[k]},{2 * error[k] - 0.1 * velocity[k]},20")
  path = tmp_path / "motor.csv"
  path.write_text("\n".join(lines) + "\n")
  return path


def test_a_network_a_plot_and_how_to_use_them(records: Path, capsys: pytest.CaptureFixture[str]) -> None:
  assert cli.main(["train-actuator", str(records), *QUICK, "--history-length", "2"]) == 0
  network = records.with_suffix(".pt")
  assert {path.name for path in records.parent.iterdir()} == {"motor.csv", "motor.pt", "motor.png"}
  shown = capsys.readouterr().out
  assert "400 rows every 0.005 s, joints joint" in shown
  assert "not read: temperature" in shown
  assert "best PD   held out" in shown
  assert "(stiffness 2, damping 0.1)" in shown
  assert re.search(r"motor     held out \S+ \(stiffness 2, damping \S+, delay \S+ s, friction \S+\)", shown)
  pasted = shown.partition("use it as: ")[2].replace("(...,)", "('.*',)")
  cfg = eval(pasted, {"LearnedMlpActuatorCfg": LearnedMlpActuatorCfg})
  assert (cfg.network_file, cfg.history_length, cfg.sample_period) == (str(network), 2, 0.005)
  cfg.validate(["hinge"])


def test_files_are_overwritten_only_with_force(records: Path, capsys: pytest.CaptureFixture[str]) -> None:
  for suffix in (".pt", ".png"):
    mine = records.with_suffix(suffix)
    mine.write_text("mine")
    assert cli.train_actuator([str(records), *QUICK]) == 2
    assert f"{mine} exists; --force overwrites it" in capsys.readouterr().err
    assert {path.name for path in records.parent.iterdir()} == {"motor.csv", mine.name}
    assert mine.read_text() == "mine"
    mine.unlink()
  records.with_suffix(".pt").write_text("mine")
  assert cli.train_actuator([str(records), *QUICK, "--force"]) == 0
  assert torch.load(records.with_suffix(".pt"), weights_only=True)


def test_ctrl_c_writes_the_network_so_far(
  records: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  def interrupted(done: float, note: str) -> None:
    if done == 2:
      os.kill(os.getpid(), signal.SIGINT)

  monkeypatch.setattr(_train_actuator, "progress_bar", lambda *_: contextlib.nullcontext(interrupted))
  assert cli.train_actuator([str(records), "--epochs", "1000000", "--hidden", "8"]) == 0
  assert "stopped (Ctrl-C) after 2 of 1000000 epochs" in capsys.readouterr().out
  assert torch.load(records.with_suffix(".pt"), weights_only=True)
  assert {path.name for path in records.parent.iterdir()} == {"motor.csv", "motor.pt", "motor.png"}


def test_an_environment_loads_the_network(records: Path) -> None:
  words = [str(records), "--epochs", "40", "--batch-size", "16", "--history-length", "1"]
  assert cli.train_actuator(words) == 0
  cfg = mjlab_pendulum.pendulum().env
  articulation = cfg.scene.entities["robot"].articulation
  assert articulation is not None
  network = LearnedMlpActuatorCfg(
    target_names_expr=("hinge",), network_file=records.with_suffix(".pt"), history_length=1, sample_period=0.005
  )
  articulation.actuators = (network,)
  cfg.scene.num_envs, cfg.sim.timestep, cfg.events = 2, 0.005, {}
  cfg.actions = {"target": mdp.JointPositionActionCfg(actuators=".*", scale=1.0)}
  with ManagerBasedRlEnv(cfg, "cpu") as env:
    env.reset()
    env.step(torch.tensor([[0.0], [1.0]]))
    effort = env.scene["robot"].data.qfrc_actuator[:, 0]
  # The recorded motor is a spring of 2 N m/rad with little damping.
  assert float(effort[1] - effort[0]) == pytest.approx(2.0, abs=0.5)
