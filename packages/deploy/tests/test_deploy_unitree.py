"""Unitree's messages: the loopback robot speaks them, and the runner drives it through them. No SDK is needed."""

import copy
import zlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from deploy_bundles import DESCRIPTION, HINGE, SCENE, write_bundle
from mjlab_deploy import DeployError, open_bundle
from mjlab_deploy.robot.robot_io import RobotCommand
from mjlab_deploy.robot.runner import Runner
from mjlab_deploy.robot.unitree import MODELS, UnitreeRobot, connect
from mjlab_deploy.simulation.loopback import LoopbackRobot

ROBOTS = pytest.mark.parametrize("model", MODELS)


def checksum(message: Any) -> int:
  content = copy.deepcopy(message)
  content.crc = 0
  return zlib.crc32(repr(content).encode())


def make_command(model: str = "go2") -> SimpleNamespace:
  count = 35 if model == "g1" else 20
  motors = [SimpleNamespace(mode=0, q=0.0, dq=0.0, tau=0.0, kp=0.0, kd=0.0) for _ in range(count)]
  head = {"mode_pr": 9, "mode_machine": 9} if model == "g1" else {"head": [0, 0], "level_flag": 0}
  return SimpleNamespace(**head, motor_cmd=motors, crc=0)


def make_state(model: str, tick: int, position: np.ndarray, **imu: Any) -> SimpleNamespace:
  motors = [SimpleNamespace(q=0.0, dq=0.0) for _ in range(35 if model == "g1" else 20)]
  for motor, value in zip(motors, position, strict=False):
    motor.q, motor.dq = float(value), float(-value)
  measured = SimpleNamespace(**({"quaternion": [1.0, 0.0, 0.0, 0.0], "gyroscope": [0.1, 0.2, 0.3]} | imu))
  state = SimpleNamespace(tick=tick, mode_machine=5, imu_state=measured, motor_state=motors, crc=0)
  state.crc = checksum(state)
  return state


def robot(model: str, sent: list[Any], **options: Any) -> UnitreeRobot:
  return UnitreeRobot(
    model, make_command=lambda: make_command(model), checksum=checksum, send=sent.append, clock=lambda: 3.5, **options
  )


@ROBOTS
def test_a_state_is_read_in_the_order_of_the_bundle(model: str) -> None:
  motors = MODELS[model].motors
  io = robot(model, [], joints=tuple(reversed(motors)))
  assert io.read() is None
  io.receive(make_state(model, 100, np.arange(len(motors))))
  state = io.read()
  assert state is not None
  np.testing.assert_array_equal(state.position, np.arange(len(motors))[::-1])
  np.testing.assert_array_equal(state.velocity, -np.arange(len(motors))[::-1])
  np.testing.assert_array_equal(state.gyro, [0.1, 0.2, 0.3])
  assert (state.time, io.info().joint_names[0]) == (3.5, motors[-1])


@ROBOTS
def test_a_command_goes_to_the_motors_of_its_joints(model: str) -> None:
  sent: list[Any] = []
  motors = MODELS[model].motors
  io = robot(model, sent, joints=(motors[3], motors[0]))
  io.receive(make_state(model, 100, np.zeros(4)))
  io.write(RobotCommand(position=np.array([0.3, 0.1]), stiffness=np.array([30.0, 10.0]), damping=np.array([3.0, 1.0])))
  (message,) = sent
  third, first = message.motor_cmd[3], message.motor_cmd[0]
  assert (third.q, third.kp, third.kd, third.dq, third.tau) == (0.3, 30.0, 3.0, 0.0, 0.0)
  assert (first.q, first.kp, first.kd, first.mode) == (0.1, 10.0, 1.0, 1)
  assert [motor.mode for motor in message.motor_cmd].count(1) == 2
  assert message.crc == checksum(message)
  if model == "g1":
    assert (message.mode_pr, message.mode_machine) == (0, 5)
  else:
    assert (message.head, message.level_flag) == ([0xFE, 0xEF], 0xFF)


def test_lost_messages_are_counted_by_the_tick_and_damaged_ones_left_out() -> None:
  io: Any = robot("go2", [])
  numbers = []
  # Ticks are milliseconds; two messages are lost before the third, and the counter overflows.
  for tick in (2**32 - 4, 2**32 - 2, 4, 6):
    io.receive(make_state("go2", tick, np.zeros(12)))
    numbers.append(io.read().sequence)
  assert np.diff(numbers).tolist() == [1, 3, 1]
  broken = make_state("go2", 8, np.zeros(12))
  broken.motor_state[0].q = 1.0
  io.receive(broken)
  assert (io.read().sequence, io.num_damaged) == (numbers[-1], 1)


def test_the_runner_drives_the_loopback_robot_through_unitrees_messages(tmp_path: Path) -> None:
  """The pole is the first motor of a Go2."""
  name, clock = MODELS["go2"].motors[0], [0.0]
  renamed = replace(
    DESCRIPTION,
    robot=replace(DESCRIPTION.robot, joints=(replace(HINGE, name=name),)),
    targets=(replace(DESCRIPTION.targets[0], joints=(name,)),),
  )
  scene = SCENE.replace("robot/hinge", f"robot/{name}")
  with open_bundle(write_bundle(tmp_path / "bundle", renamed, scene=scene)) as bundle:
    simulated = LoopbackRobot(bundle)

    def obey(message: Any) -> None:
      assert message.crc == checksum(message)
      motor = message.motor_cmd[0]
      position, stiffness, damping = (np.array([value]) for value in (motor.q, motor.kp, motor.kd))
      simulated.write(RobotCommand(position=position, stiffness=stiffness, damping=damping))

    io = UnitreeRobot(
      "go2", make_command=make_command, checksum=checksum, send=obey, joints=(name,), clock=lambda: clock[0]
    )
    runner = Runner(bundle, io, stand_time=0.2)

    def advance(seconds: float) -> None:
      end = simulated.time + seconds
      while simulated.time < end - 1e-9:
        simulated.advance()
        clock[0] = simulated.time
        state = simulated.read()
        assert state is not None
        tick = round(simulated.time * 1000)
        message = make_state("go2", tick, state.position, gyroscope=[*np.random.default_rng(tick).normal(0, 1e-4, 3)])
        message.motor_state[0].dq = float(state.velocity[0])
        message.crc = checksum(message)
        io.receive(message)
        if runner.reason == "not started":
          runner.start()
        runner.tick(simulated.time)

    advance(0.1)
    runner.command["command/angle"][:] = 0.4
    advance(1.5)
    assert runner.phase == "policy", runner.reason
    assert simulated.data.qpos[0] > 0.2
    clock[0] += 0.02
    assert runner.tick(clock[0]) == "damping"
    assert "no state for" in runner.reason
    simulated.advance()
    assert simulated.is_damped


@pytest.mark.parametrize("reason", [ModuleNotFoundError("No module named 'cyclonedds'"), OSError("crc_amd64.so")])
def test_a_missing_sdk_is_named_with_a_remedy(monkeypatch: pytest.MonkeyPatch, reason: Exception) -> None:
  def missing(name: str) -> Any:
    raise reason

  monkeypatch.setattr("importlib.import_module", missing)
  with pytest.raises(DeployError, match="install it from its repository"):
    connect("g1", "eth0")


def test_unknown_robots_and_motors_are_named() -> None:
  with pytest.raises(DeployError, match="robot 'go1' does not exist; there are 'g1', 'go2'"):
    connect("go1", "eth0")
  with pytest.raises(DeployError, match="motor of the go2 'tail' does not exist"):
    robot("go2", [], joints=("tail",))
