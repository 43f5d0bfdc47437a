"""Unitree's interface through its SDK and DDS on this machine; skipped without them."""

import importlib
import importlib.util
import platform
import sys
import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from mjlab_deploy.robot.robot_io import RobotCommand
from mjlab_deploy.robot.unitree import MODELS, connect

PACKAGE = "unitree_sdk2py"
pytest.importorskip("cyclonedds", exc_type=ImportError)
SPEC = importlib.util.find_spec(PACKAGE)
if SPEC is None:
  pytest.skip("Unitree's SDK is not installed", allow_module_level=True)


@pytest.fixture(autouse=True)
def _sdk(monkeypatch: pytest.MonkeyPatch) -> None:
  # The package on the index (1.0.1) lacks a part that its __init__ imports, and the library for checksums; it
  # has a slower one in Python for other systems.
  assert SPEC is not None
  package = ModuleType(PACKAGE)
  package.__path__ = list(SPEC.submodule_search_locations or ())
  monkeypatch.setitem(sys.modules, PACKAGE, package)
  monkeypatch.setattr(platform, "system", lambda: "another")


def send_until(arrived: Callable[[], bool], send: Callable[[], object]) -> None:
  limit = time.monotonic() + 300
  while not arrived():
    assert time.monotonic() < limit
    send()
    time.sleep(0.02)


@pytest.mark.parametrize("model", MODELS)
def test_states_and_commands_go_through_dds(model: str) -> None:
  facts = MODELS[model]
  robot = connect(model, "lo", joints=tuple(reversed(facts.motors)))
  channel: Any = importlib.import_module(f"{PACKAGE}.core.channel")
  messages: Any = importlib.import_module(f"{PACKAGE}.idl.{facts.messages}.msg.dds_")
  default: Any = importlib.import_module(f"{PACKAGE}.idl.default")
  checksum = importlib.import_module(f"{PACKAGE}.utils.crc").CRC().Crc
  received: list[Any] = []
  subscriber = channel.ChannelSubscriber("rt/lowcmd", messages.LowCmd_)
  subscriber.Init(received.append, 10)
  publisher = channel.ChannelPublisher("rt/lowstate", messages.LowState_)
  publisher.Init()

  state = getattr(default, f"{facts.messages}_msg_dds__LowState_")()
  state.imu_state.gyroscope[:] = [0.1, 0.2, 0.3]
  count = len(facts.motors)
  for motor in range(count):
    state.motor_state[motor].q, state.motor_state[motor].dq = 0.01 * motor, -0.01 * motor
  if facts.sends_mode:
    state.mode_machine = 5

  def publish() -> None:
    state.tick += 2
    state.crc = checksum(state)
    publisher.Write(state)

  send_until(lambda: robot.read() is not None, publish)
  read = robot.read()
  assert read is not None
  angles = 0.01 * np.arange(count)[::-1]
  for found, wanted in ((read.position, angles), (read.velocity, -angles), (read.gyro, [0.1, 0.2, 0.3])):
    np.testing.assert_allclose(found, wanted, atol=1e-6)
  assert robot.num_damaged == 0

  gains = np.arange(1.0, count + 1)
  command = RobotCommand(position=0.1 * gains, stiffness=10.0 * gains, damping=gains)
  send_until(lambda: bool(received), lambda: robot.write(command))
  message = received[0]
  assert message.crc == checksum(message)
  for name, wanted in (("q", command.position), ("kp", command.stiffness), ("kd", command.damping)):
    motors = [getattr(motor, name) for motor in message.motor_cmd[:count]]
    np.testing.assert_allclose(motors, wanted[::-1], rtol=1e-6)
  if facts.sends_mode:
    assert message.mode_machine == 5
  for each in (subscriber, publisher, *robot.channels):
    each.Close()
