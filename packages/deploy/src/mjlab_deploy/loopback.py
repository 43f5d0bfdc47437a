"""A simulated robot behind the messages of a real one: 500 Hz, checksums, delays and losses."""

import struct
import zlib
from collections import deque
from dataclasses import replace

import mujoco
import numpy as np

from mjlab_deploy.bundle import Bundle
from mjlab_deploy.camera import Cameras
from mjlab_deploy.closed_loop import ClosedLoop
from mjlab_deploy.description import Description
from mjlab_deploy.errors import DeployError
from mjlab_deploy.model_readings import actuators_of
from mjlab_deploy.robot_io import RobotCommand, RobotInfo, RobotIO, RobotState

_STATE, _COMMAND, _IMAGE = b"MJS1", b"MJC1", b"MJI1"
_HEAD = struct.Struct("<4sIdI")


def encode(kind: bytes, sequence: int, time: float, values: np.ndarray) -> bytes:
  """Return a message: kind, number, time, count, float32 values, CRC-32."""
  body = _HEAD.pack(kind, sequence, time, len(values)) + values.astype("<f4").tobytes()
  return body + struct.pack("<I", zlib.crc32(body))


def decode(kind: bytes, message: bytes, count: int) -> tuple[int, float, np.ndarray] | None:
  """Return number, time and values of a message; None if it is damaged or of another kind or size."""
  if len(message) != _HEAD.size + 4 * count + 4:
    return None
  body, (checksum,) = message[:-4], struct.unpack("<I", message[-4:])
  found, sequence, time, length = _HEAD.unpack_from(body)
  if found != kind or length != count or zlib.crc32(body) != checksum:
    return None
  return sequence, time, np.frombuffer(body, "<f4", offset=_HEAD.size).astype(float)


class LoopbackRobot(RobotIO):
  """The robot of a bundle in MuJoCo C, which speaks and obeys as a real one. `advance` is its time.

  Its drives let the robot go by themselves if no command has arrived for `watchdog`. Its cameras draw an image in every
  period of the policy. Images are messages of their own, which are late and get lost like those of the state.

  Args:
    bundle: The bundle.
    rate: Messages per second [Hz].
    delay: Messages that each direction is late.
    loss: Probability that a message is lost, in each direction.
    watchdog: Time without a command after which drives damp [s].
    noise: Standard deviation of the noise of all measurements [their units].
    seed: Seed of losses and noise.
  """

  def __init__(
    self,
    bundle: Bundle,
    *,
    rate: float = 500.0,
    delay: int = 0,
    loss: float = 0.0,
    watchdog: float = 0.016,
    noise: float = 1e-5,
    seed: int = 0,
  ) -> None:
    self._loop = ClosedLoop(bundle)
    self.model, self.data = self._loop.model, self._loop.data
    self.description: Description = bundle.description
    self.rate, self.delay, self.loss, self.watchdog, self.noise = rate, delay, loss, watchdog, noise
    self.model.opt.timestep = 1.0 / rate
    self._rng = np.random.default_rng(seed)
    self._joints = self.description.robot.joints
    measured = ("joint/position", "joint/velocity", "imu/gyro", "imu/projected_gravity")
    self._extra = [item for item in self._loop.sensors.inputs if item.name not in measured]
    self._cameras = Cameras(self.model, self.description)
    self._images: dict[str, np.ndarray] = {}
    self._frames: deque[list[bytes]] = deque([[] for _ in range(delay)])
    self._next_image = 0.0
    prefix = f"{self.description.robot.name}/"
    self._actuators = [_actuator(self.model, prefix + joint.name) for joint in self._joints]
    self._is_servo = [self.model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE for i in self._actuators]
    self._command = np.zeros((3, len(self._joints)))
    self._root = self.model.body(prefix + self.description.robot.root_body).id
    self._to_robot: deque[bytes] = deque()
    self._to_runner: deque[bytes] = deque([b""] * delay)
    self._inbox: RobotState | None = None
    self._sequence = self._commands = 0
    self._last_command = -np.inf
    self.is_damped = True
    """True while the drives only damp."""
    self.frozen: RobotState | None = None
    """A state that is sent again and again, as by a sensor that hangs."""
    self.start()

  def start(self, height: float = 0.0) -> None:
    """Put the robot into its default pose, its root `height` above that of the record or of the model [m]."""
    mujoco.mj_resetData(self.model, self.data)
    for joint, column in zip(self._joints, self._loop.sensors.qpos, strict=True):
      self.data.qpos[column] = joint.default_position
    if self.description.robot.is_floating:
      self.data.qpos[2] += height
    mujoco.mj_forward(self.model, self.data)

  def info(self) -> RobotInfo:
    return RobotInfo(
      joint_names=tuple(joint.name for joint in self._joints),
      rate=self.rate,
      readings=tuple(item.name for item in (*self._extra, *self._cameras.inputs)),
    )

  @property
  def time(self) -> float:
    """Time of the robot [s]."""
    return float(self.data.time)

  # The runner's side

  def read(self) -> RobotState | None:
    return self._inbox

  def write(self, command: RobotCommand) -> None:
    values = np.concatenate((command.position, command.stiffness, command.damping))
    self._commands += 1
    message = encode(_COMMAND, self._commands, self.time, values)
    self._to_robot.append(b"" if self._rng.random() < self.loss else message)

  # The robot's side

  def advance(self) -> None:
    """Take the commands that have arrived, simulate one message's time, and send the state."""
    count = len(self._joints)
    while len(self._to_robot) > self.delay:
      if (found := decode(_COMMAND, self._to_robot.popleft(), 3 * count)) is not None:
        self._obey(found[2].reshape(3, count))
        self._last_command = self.time
    if self.time - self._last_command >= self.watchdog - 1e-9:
      self._damp()
    self._drive_motors()
    mujoco.mj_step(self.model, self.data)
    self._send()

  def _obey(self, command: np.ndarray) -> None:
    self.is_damped = not command[1].any()
    self._command = command
    for actuator, is_servo, (target, kp, kd) in zip(self._actuators, self._is_servo, command.T, strict=True):
      if actuator >= 0 and is_servo:
        self.model.actuator_gainprm[actuator, 0] = kp
        self.model.actuator_biasprm[actuator, 1:3] = -kp, -kd
        self.data.ctrl[actuator] = target

  def _damp(self) -> None:
    self.is_damped = True
    self._command[1] = 0.0
    for actuator, is_servo in zip(self._actuators, self._is_servo, strict=True):
      if actuator >= 0 and is_servo:
        self.model.actuator_gainprm[actuator, 0] = 0.0
        self.model.actuator_biasprm[actuator, 1] = 0.0

  def _drive_motors(self) -> None:
    """Compute the efforts of motors, which have no servo in the model."""
    position = self.data.qpos[self._loop.sensors.qpos]
    velocity = self.data.qvel[self._loop.sensors.qvel]
    target, kp, kd = self._command
    efforts = kp * (target - position) - kd * velocity
    for joint, actuator, is_servo, effort in zip(self._joints, self._actuators, self._is_servo, efforts, strict=True):
      if actuator >= 0 and not is_servo:
        limit = np.inf if joint.effort_limit is None else joint.effort_limit
        self.data.ctrl[actuator] = np.clip(effort, -limit, limit) / self.model.actuator_gear[actuator, 0]

  def _send(self) -> None:
    self._sequence += 1
    sensed = self._loop.readings()
    gyro = sensed.get("imu/gyro", np.zeros(3))
    values = np.concatenate(
      (
        self.data.qpos[self._loop.sensors.qpos],
        self.data.qvel[self._loop.sensors.qvel],
        gyro,
        self.data.xquat[self._root],
        *(sensed[item.name] for item in self._extra),
      )
    )
    values = values + self._rng.normal(0.0, self.noise, values.shape)
    self._send_images()
    message = encode(_STATE, self._sequence, self.time, values)
    self._to_runner.append(b"" if self._rng.random() < self.loss else message)
    # A camera that has sent nothing yet is one that is not ready.
    is_ready = len(self._images) == len(self._cameras.inputs)
    if (found := decode(_STATE, self._to_runner.popleft(), len(values))) is not None and is_ready:
      self._inbox = self._state(*found)

  def _send_images(self) -> None:
    """Draw and send images that are due, and take those that have arrived."""
    sent: list[bytes] = []
    if self._cameras.inputs and self.time >= self._next_image - 1e-9:
      self._next_image = self.time + self.description.timing.control_dt
      for place, image in enumerate(self._cameras.draw(self.data).values()):
        message = encode(_IMAGE, place, self.time, image.ravel())
        sent.append(b"" if self._rng.random() < self.loss else message)
    self._frames.append(sent)
    for message, item in zip(self._frames.popleft(), self._cameras.inputs, strict=False):
      if (found := decode(_IMAGE, message, int(np.prod(item.shape)))) is not None:
        self._images[item.name] = found[2].reshape(item.shape)

  def _state(self, sequence: int, time: float, values: np.ndarray) -> RobotState:
    if self.frozen is not None:
      return replace(self.frozen, sequence=sequence, time=time)
    count = len(self._joints)
    position, velocity, gyro, orientation, rest = np.split(values, [count, 2 * count, 2 * count + 3, 2 * count + 7])
    widths = np.cumsum([int(np.prod(item.shape)) for item in self._extra])[:-1]
    extra = zip(self._extra, np.split(rest, widths) if self._extra else [], strict=True)
    return RobotState(
      time=time,
      sequence=sequence,
      position=position,
      velocity=velocity,
      gyro=gyro,
      orientation=orientation,
      readings={item.name: value for item, value in extra} | self._images,
    )


def _actuator(model: mujoco.MjModel, joint: str) -> int:
  """Return the position servo or the motor of a joint; -1 if nothing drives it."""
  found = actuators_of(model, model.joint(joint).id)
  if not found:
    return -1
  gain, bias = model.actuator_gainprm[found[0], 0], model.actuator_biastype[found[0]]
  is_motor = bias == mujoco.mjtBias.mjBIAS_NONE and gain == 1.0
  if bias != mujoco.mjtBias.mjBIAS_AFFINE and not is_motor:
    raise DeployError(f"{joint}: the loopback robot needs position servos or motors")
  return found[0]
