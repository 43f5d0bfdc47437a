"""Unitree's G1 and Go2 behind their low-level messages, as `unitree_sdk2py` documents them. Not tried on hardware.

The messages are objects with the fields of Unitree's LowCmd_ and LowState_; `connect` gets them from the SDK, which is
imported only there.
"""

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjlab_deploy.errors import check_known, reading
from mjlab_deploy.formats.other_formats import G1_MOTORS, QUADRUPED_MOTORS
from mjlab_deploy.robot.robot_io import RobotCommand, RobotInfo, RobotIO, RobotState

RATE = 500.0
"""Messages of state per second [Hz]."""
_INCOMPLETE = (
  "Unitree's SDK is missing or incomplete; install it from its repository, unitreerobotics/unitree_sdk2_python; the "
  "package unitree-sdk2 lacks files"
)
_ENABLE, _GO_SERVO = 1, 0x01


@dataclass(frozen=True, kw_only=True)
class UnitreeModel:
  """Messages of a robot."""

  messages: str
  """Family of the messages: "unitree_hg" of humanoids, "unitree_go" of quadrupeds."""
  motors: tuple[str, ...]
  """Joints in the order of the motors."""
  sends_mode: bool
  """True if commands repeat `mode_machine` of the state, which is the variant of the robot."""


MODELS = {
  "g1": UnitreeModel(messages="unitree_hg", motors=G1_MOTORS, sends_mode=True),
  "go2": UnitreeModel(messages="unitree_go", motors=QUADRUPED_MOTORS, sends_mode=False),
}
"""Robots by name."""


class UnitreeRobot(RobotIO):
  """A G1 with 29 joints or a Go2. `receive` takes the messages of its state, from any thread.

  The IMU is that of the pelvis or the trunk. Its own controller must be switched off before (`connect` does not), and
  its drives must damp when commands stop.

  Args:
    model: "g1" or "go2".
    make_command: Returns a new LowCmd_.
    checksum: Returns the CRC of a message.
    send: Publishes a LowCmd_.
    joints: Joints in the order of the bundle; None for the order of the motors.
    clock: Time of arrival of states [s]; the runner must use the same.

  Raises:
    DeployError: The robot is not known, or lacks a joint.
  """

  def __init__(
    self,
    model: str,
    *,
    make_command: Callable[[], Any],
    checksum: Callable[[Any], int],
    send: Callable[[Any], None],
    joints: tuple[str, ...] | None = None,
    clock: Callable[[], float] = time.monotonic,
  ) -> None:
    self.model = MODELS[check_known("robot", model, MODELS)]
    self._joints = self.model.motors if joints is None else joints
    motors = self.model.motors
    self._motor = [motors.index(check_known(f"motor of the {model}", name, motors)) for name in self._joints]
    self._make_command, self._checksum, self._send, self._clock = make_command, checksum, send, clock
    self._state: RobotState | None = None
    self._tick: int | None = None
    self._sequence = 0
    self._mode_machine = 0
    self.channels: tuple[Any, ...] = ()
    """Channels of the SDK, kept alive with the robot."""
    self.num_damaged = 0
    """Number of states whose CRC was wrong; they are not read."""

  def info(self) -> RobotInfo:
    return RobotInfo(joint_names=self._joints, rate=RATE)

  def receive(self, message: Any) -> None:
    """Take a LowState_; a message with a wrong CRC is counted and ignored."""
    if self._checksum(message) != message.crc:
      self.num_damaged += 1
      return
    motors = [message.motor_state[i] for i in self._motor]
    state = RobotState(
      time=self._clock(),
      sequence=self._number(int(message.tick)),
      position=np.array([motor.q for motor in motors], dtype=float),
      velocity=np.array([motor.dq for motor in motors], dtype=float),
      gyro=np.array(message.imu_state.gyroscope, dtype=float),
      orientation=np.array(message.imu_state.quaternion, dtype=float),
    )
    self._mode_machine = int(getattr(message, "mode_machine", 0))
    # Another thread reads the state, which is replaced at once.
    self._state = state

  def _number(self, tick: int) -> int:
    """Return the number of a message; `tick` counts milliseconds, so a gap of two periods is one lost message."""
    passed = 0 if self._tick is None else (tick - self._tick) & 0xFFFFFFFF
    self._tick = tick
    self._sequence += max(1, round(passed * 1e-3 * RATE))
    return self._sequence

  def read(self) -> RobotState | None:
    return self._state

  def write(self, command: RobotCommand) -> None:
    message = self._make_command()
    if self.model.sends_mode:
      message.mode_pr, message.mode_machine = 0, self._mode_machine
    else:
      message.head[0], message.head[1] = 0xFE, 0xEF
      message.level_flag = 0xFF
    for column, index in enumerate(self._motor):
      motor = message.motor_cmd[index]
      motor.mode = _ENABLE if self.model.sends_mode else _GO_SERVO
      motor.q, motor.dq, motor.tau = float(command.position[column]), 0.0, 0.0
      motor.kp, motor.kd = float(command.stiffness[column]), float(command.damping[column])
    message.crc = self._checksum(message)
    self._send(message)


def connect(model: str, network: str, joints: tuple[str, ...] | None = None) -> UnitreeRobot:
  """Return a robot on a network interface ("eth0"; "lo" with Unitree's simulator), through `unitree_sdk2py`.

  Raises:
    DeployError: The SDK is not installed, or the robot is not known.
  """
  family = MODELS[check_known("robot", model, MODELS)].messages
  with reading(_INCOMPLETE, ImportError):
    channel: Any = importlib.import_module("unitree_sdk2py.core.channel")
    messages: Any = importlib.import_module(f"unitree_sdk2py.idl.{family}.msg.dds_")
    default: Any = importlib.import_module("unitree_sdk2py.idl.default")
    crc: Any = importlib.import_module("unitree_sdk2py.utils.crc").CRC()
  channel.ChannelFactoryInitialize(0, network)
  publisher = channel.ChannelPublisher("rt/lowcmd", messages.LowCmd_)
  publisher.Init()
  robot = UnitreeRobot(
    model,
    make_command=getattr(default, f"{family}_msg_dds__LowCmd_"),
    checksum=crc.Crc,
    send=publisher.Write,
    joints=joints,
  )
  subscriber = channel.ChannelSubscriber("rt/lowstate", messages.LowState_)
  subscriber.Init(robot.receive, 10)
  robot.channels = (publisher, subscriber)
  return robot
