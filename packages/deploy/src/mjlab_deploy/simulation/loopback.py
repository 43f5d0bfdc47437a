"""A simulated robot behind the messages of a real one: 500 Hz, with delays."""

from collections import deque

import mujoco
import numpy as np

from mjlab_deploy.bundle import Bundle
from mjlab_deploy.robot.robot_io import RobotCommand, RobotInfo, RobotIO, RobotState
from mjlab_deploy.simulation.camera import Cameras
from mjlab_deploy.simulation.closed_loop import ClosedLoop
from mjlab_deploy.simulation.model_readings import Readings, actuators_of

RATE = 500.0
"""Messages per second [Hz]."""
_NOISE = 1e-5
"""Standard deviation of the noise of all measurements [their units]."""


class LoopbackRobot(RobotIO):
  """The robot of a bundle in MuJoCo C, with the messages of a real one. `advance` is its time.

  Each joint is driven by a position servo with the gains of the command, whatever actuator the scene has. The drives
  damp by themselves if no command has arrived for `watchdog`. The cameras draw an image in every period of the policy.

  Args:
    bundle: The bundle.
    delay: Messages that each direction is late.
    watchdog: Time without a command after which drives damp [s].
  """

  def __init__(self, bundle: Bundle, *, delay: int = 0, watchdog: float = 0.016) -> None:
    self._loop = ClosedLoop(bundle)
    self.model, self.data, self.description = self._loop.model, self._loop.data, bundle.description
    self.delay, self.watchdog = delay, watchdog
    self.model.opt.timestep = 1.0 / RATE
    self._rng = np.random.default_rng(0)
    measured = ("joint/position", "joint/velocity", "imu/gyro", "imu/projected_gravity")
    self._extra = [item.name for item in self._loop.sensors.inputs if item.name not in measured]
    self._cameras = Cameras(self.model, self.description)
    self._images: Readings = {}
    self._next_image = 0.0
    self._driven, self._servos = self._make_servos()
    self._states: deque[RobotState] = deque()
    self._commands: deque[RobotCommand] = deque()
    self._newest: RobotState | None = None
    self._sequence = 0
    self._last_command = -np.inf
    self.is_damped = True
    """True while the drives only damp."""
    # The default pose, with the root where the model has it.
    self.data.qpos[self._loop.sensors.qpos] = self.description.robot.values("default_position")
    mujoco.mj_forward(self.model, self.data)

  def _make_servos(self) -> tuple[list[int], list[int]]:
    """Turn the actuator of each driven joint into a servo; return the columns of these joints and the actuators."""
    model, driven, servos = self.model, [], []
    for column, joint in enumerate(self.description.robot.joints):
      for servo in actuators_of(model, self._loop.sensors.joints[column])[:1]:
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

  def info(self) -> RobotInfo:
    return RobotInfo(
      joint_names=self.description.robot.joint_names,
      rate=RATE,
      readings=(*self._extra, *(item.name for item in self._cameras.inputs)),
    )

  @property
  def time(self) -> float:
    """Time of the robot [s]."""
    return float(self.data.time)

  # The runner's side

  def read(self) -> RobotState | None:
    return self._newest

  def write(self, command: RobotCommand) -> None:
    self._commands.append(command)

  # The robot's side

  def advance(self) -> None:
    """Take the commands that have arrived, simulate the time of one message, and send the state."""
    while len(self._commands) > self.delay:
      command = self._commands.popleft()
      self._set_stiffness(command.stiffness[self._driven])
      self.model.actuator_biasprm[self._servos, 2] = -command.damping[self._driven]
      self.data.ctrl[self._servos] = command.position[self._driven]
      self._last_command = self.time
    if self.time - self._last_command >= self.watchdog - 1e-9:
      self._set_stiffness(np.zeros(len(self._servos)))
    mujoco.mj_step(self.model, self.data)
    self._states.append(self._measure())
    if len(self._states) > self.delay:
      self._newest = self._states.popleft()

  def _set_stiffness(self, stiffness: np.ndarray) -> None:
    self.is_damped = not stiffness.any()
    self.model.actuator_gainprm[self._servos, 0] = stiffness
    self.model.actuator_biasprm[self._servos, 1] = -stiffness

  def _measure(self) -> RobotState:
    """Return the present state, with the newest images."""
    sensed = self._loop.readings()
    if self.time >= self._next_image - 1e-9:
      self._next_image = self.time + self.description.timing.control_dt
      self._images = self._cameras.draw(self.data)
    self._sequence += 1
    return RobotState(
      time=self.time,
      sequence=self._sequence,
      position=self._noisy(self.data.qpos[self._loop.sensors.qpos]),
      velocity=self._noisy(self.data.qvel[self._loop.sensors.qvel]),
      gyro=self._noisy(sensed.get("imu/gyro", np.zeros(3))),
      orientation=self._noisy(self.data.xquat[self._loop.sensors.root]),
      readings={name: self._noisy(sensed[name]) for name in self._extra} | self._images,
    )

  def _noisy(self, values: np.ndarray) -> np.ndarray:
    return values + self._rng.normal(0.0, _NOISE, values.shape)
