"""A simulated robot behind the messages of a real one: 500 Hz, delays and losses."""

from collections import deque
from dataclasses import replace
from typing import TypeVar

import mujoco
import numpy as np

from mjlab_deploy.bundle import Bundle
from mjlab_deploy.camera import Cameras
from mjlab_deploy.closed_loop import ClosedLoop
from mjlab_deploy.description import Description
from mjlab_deploy.model_readings import Readings, actuators_of, joint_id
from mjlab_deploy.robot_io import RobotCommand, RobotInfo, RobotIO, RobotState

MessageT = TypeVar("MessageT")
RATE = 500.0
"""Messages per second [Hz]."""
_NOISE = 1e-5
"""Standard deviation of the noise of all measurements [their units]."""


class LoopbackRobot(RobotIO):
  """The robot of a bundle in MuJoCo C, with the messages of a real one. `advance` is its time.

  Each joint is driven by a position servo with the gains of the command, whatever actuator the scene has. The drives
  damp by themselves if no command has arrived for `watchdog`. The cameras draw an image in every period of the policy.
  Images are separate messages, which are late and get lost like those of the state.

  Args:
    bundle: The bundle.
    delay: Messages that each direction is late.
    loss: Probability that a message is lost, in each direction.
    watchdog: Time without a command after which drives damp [s].
    seed: Seed of losses and noise.
  """

  def __init__(
    self,
    bundle: Bundle,
    *,
    delay: int = 0,
    loss: float = 0.0,
    watchdog: float = 0.016,
    seed: int = 0,
  ) -> None:
    self._loop = ClosedLoop(bundle)
    self.model, self.data = self._loop.model, self._loop.data
    self.description: Description = bundle.description
    self.rate, self.delay, self.loss, self.watchdog = RATE, delay, loss, watchdog
    self.model.opt.timestep = 1.0 / RATE
    self._rng = np.random.default_rng(seed)
    measured = ("joint/position", "joint/velocity", "imu/gyro", "imu/projected_gravity")
    self._extra = [item.name for item in self._loop.sensors.inputs if item.name not in measured]
    self._cameras = Cameras(self.model, self.description)
    self._next_image = 0.0
    self._root = self.model.body(f"{self.description.robot.name}/{self.description.robot.root_body}").id
    self._driven, self._servos = self._make_servos()
    self._images: Readings = {}
    self._sent_images: deque[Readings] = deque({} for _ in range(delay))
    self._sent_states: deque[RobotState | None] = deque([None] * delay)
    self._commands: deque[RobotCommand | None] = deque()
    self._newest: RobotState | None = None
    self._sequence = 0
    self._last_command = -np.inf
    self.is_damped = True
    """True while the drives only damp."""
    self.frozen: RobotState | None = None
    """A state that is sent again and again, as by a sensor that hangs."""
    self.start()

  def _make_servos(self) -> tuple[list[int], list[int]]:
    """Turn the actuator of each driven joint into a servo; return the columns of these joints and the actuators."""
    model, driven, servos = self.model, [], []
    for column, joint in enumerate(self.description.robot.joints):
      for servo in actuators_of(model, joint_id(model, f"{self.description.robot.name}/{joint.name}"))[:1]:
        driven.append(column)
        servos.append(servo)
        if joint.effort_limit is not None:
          model.actuator_forcelimited[servo] = True
          model.actuator_forcerange[servo] = -joint.effort_limit, joint.effort_limit
    model.actuator_gaintype[servos] = mujoco.mjtGain.mjGAIN_FIXED
    model.actuator_biastype[servos] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_ctrllimited[servos] = False
    model.actuator_gear[servos, 0] = 1.0
    return driven, servos

  def start(self) -> None:
    """Put the robot into its default pose, its root where the model has it."""
    mujoco.mj_resetData(self.model, self.data)
    self.data.qpos[self._loop.sensors.qpos] = self.description.robot.values("default_position")
    mujoco.mj_forward(self.model, self.data)

  def info(self) -> RobotInfo:
    return RobotInfo(
      joint_names=self.description.robot.joint_names,
      rate=self.rate,
      readings=(*self._extra, *(item.name for item in self._cameras.inputs)),
    )

  @property
  def time(self) -> float:
    """Time of the robot [s]."""
    return float(self.data.time)

  def _transmit(self, message: MessageT) -> MessageT | None:
    """Return a message, or None if it is lost."""
    return None if self._rng.random() < self.loss else message

  # The runner's side

  def read(self) -> RobotState | None:
    return self._newest

  def write(self, command: RobotCommand) -> None:
    self._commands.append(self._transmit(command))

  # The robot's side

  def advance(self) -> None:
    """Take the commands that have arrived, simulate the time of one message, and send the state."""
    while len(self._commands) > self.delay:
      if (command := self._commands.popleft()) is not None:
        self._obey(command)
        self._last_command = self.time
    if self.time - self._last_command >= self.watchdog - 1e-9:
      self._set_stiffness(np.zeros(len(self._servos)))
    mujoco.mj_step(self.model, self.data)
    self._send()

  def _obey(self, command: RobotCommand) -> None:
    self._set_stiffness(command.stiffness[self._driven])
    self.model.actuator_biasprm[self._servos, 2] = -command.damping[self._driven]
    self.data.ctrl[self._servos] = command.position[self._driven]

  def _set_stiffness(self, stiffness: np.ndarray) -> None:
    self.is_damped = not stiffness.any()
    self.model.actuator_gainprm[self._servos, 0] = stiffness
    self.model.actuator_biasprm[self._servos, 1] = -stiffness

  def _send(self) -> None:
    """Send the state and the images that are due, and take those that have arrived."""
    sensed = self._loop.readings()
    self._sequence += 1
    state = RobotState(
      time=self.time,
      sequence=self._sequence,
      position=self._measured(self.data.qpos[self._loop.sensors.qpos]),
      velocity=self._measured(self.data.qvel[self._loop.sensors.qvel]),
      gyro=self._measured(sensed.get("imu/gyro", np.zeros(3))),
      orientation=self._measured(self.data.xquat[self._root]),
      readings={name: self._measured(sensed[name]) for name in self._extra},
    )
    if self.frozen is not None:
      state = replace(self.frozen, sequence=state.sequence, time=state.time)
    self._sent_images.append(self._draw())
    self._images |= self._sent_images.popleft()
    self._sent_states.append(self._transmit(state))
    arrived = self._sent_states.popleft()
    # A camera without an image is not ready.
    if arrived is not None and len(self._images) == len(self._cameras.inputs):
      self._newest = replace(arrived, readings=arrived.readings | self._images)

  def _measured(self, values: np.ndarray) -> np.ndarray:
    return values + self._rng.normal(0.0, _NOISE, values.shape)

  def _draw(self) -> Readings:
    """Return the images that are due and not lost."""
    if not self._cameras.inputs or self.time < self._next_image - 1e-9:
      return {}
    self._next_image = self.time + self.description.timing.control_dt
    return {name: image for name, image in self._cameras.draw(self.data).items() if self._transmit(name) is not None}
