"""`mjlab-deploy run` drives the loopback robot of a bundle."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from deploy_bundles import DESCRIPTION, HINGE, SCENE, SERVO, write_bundle
from mcap.reader import make_reader
from mjlab_deploy import Bundle, open_bundle
from mjlab_deploy.arrays import read_arrays
from mjlab_deploy.command import main
from mjlab_deploy.simulation.simulated_run import SimulatedRun


def test_a_run_is_logged(bundle: Bundle, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  log = tmp_path / "log.npz"
  words = ["run", str(bundle.folder), "--seconds", "2", "--command", "0.4", "--latency", "4ms", "--log", str(log)]
  assert main(words) == 0
  assert "ran 2.0 s; joints are" in capsys.readouterr().out
  rows = read_arrays(log, 2**24)
  assert rows["position"].shape == rows["target"].shape
  assert rows["is_policy"][-1] == 1.0
  assert rows["position"][-1, 0] > 0.2


def test_a_log_as_mcap_has_states_commands_and_the_operators_command(bundle: Bundle, tmp_path: Path) -> None:
  log = tmp_path / "log.mcap"
  assert main(["run", str(bundle.folder), "--seconds", "1.2", "--command", "0.4", "--log", str(log)]) == 0
  found: dict[str, list[tuple[int, dict[str, object]]]] = {}
  with log.open("rb") as file:
    for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
      found.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
  states, commands, wanted = (found[name] for name in ("/joint_states", "/joint_commands", "/operator_commands"))
  assert len(states) == len(commands) == len(wanted) == 600
  assert states[0][1].keys() == {"name", "position", "velocity"}
  assert commands[-1][1]["name"] == ["hinge"]
  assert wanted[-1][1] == {"is_policy": 1.0, "command_angle": [pytest.approx(0.4)]}
  # Messages are 2 ms apart.
  assert states[-1][0] - states[0][0] == pytest.approx(1.198e9, abs=10)


@pytest.mark.parametrize(
  ("words", "message"),
  [
    (["--command", "1,2"], "command has 1 numbers, got 2"),
    (["--log"], "expected one argument"),
    (["--latency", "3h"], "argument --latency: expected 0 to 1 s, such as 10ms, got '3h'"),
    (["--latency", "10"], "argument --latency: expected 0 to 1 s, such as 10ms, got '10'"),
    (["--seconds", "-1"], "argument --seconds: expected a number above 0, got '-1'"),
    (["--command", "1;2"], "argument --command: expected numbers such as 0.5,0,0, got '1;2'"),
  ],
)
def test_a_mistake_is_reported(
  bundle: Bundle, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
  try:
    code = main(["run", str(bundle.folder), *words])
  except SystemExit as error:
    code = error.code
  assert code in (1, 2)
  assert message in capsys.readouterr().err


def test_a_robot_in_damping_ends_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  slow = replace(DESCRIPTION, robot=replace(DESCRIPTION.robot, joints=(replace(HINGE, velocity_limit=1e-3),)))
  assert main(["run", str(write_bundle(tmp_path / "bundle", slow)), "--seconds", "3"]) == 1
  assert "damping after" in capsys.readouterr().out


def test_motors_without_a_servo_are_driven_alike(tmp_path: Path) -> None:
  """Actuator models of the training, such as one with a torque-speed line, are motors in the scene."""
  reached = []
  for actuator in (SERVO, '<motor name="robot/hinge" joint="robot/hinge"/>'):
    folder = write_bundle(tmp_path / str(len(reached)), scene=SCENE.replace(SERVO, actuator))
    with open_bundle(folder) as bundle:
      run = SimulatedRun(bundle, command=[0.4])
    run.run(2.0)
    assert run.runner.phase == "policy", run.runner.reason
    reached.append(run.robot.data.qpos[0])
    run.runner.stop()
    for _ in range(5):
      run.robot.advance()
    assert run.robot.is_damped
  assert reached[1] == pytest.approx(reached[0], abs=1e-3)
  assert reached[0] > 0.2


def test_keys_change_the_command_within_its_range(bundle: Bundle) -> None:
  run = SimulatedRun(bundle)
  for presses, key, wanted in ((20, 265, 0.5), (1, 264, 0.4)):
    for _ in range(presses):
      run.press(key)
    np.testing.assert_allclose(run.runner.command["command/angle"], wanted)
  run.press(32)
  assert run.runner.reason == "stopped by the operator"
