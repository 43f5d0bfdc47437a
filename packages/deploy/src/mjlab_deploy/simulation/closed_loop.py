"""A policy and its robot in MuJoCo C, as in training."""

from collections.abc import Mapping

import mujoco
import numpy as np

from mjlab_deploy.bundle import Bundle
from mjlab_deploy.errors import DeployError, check_known, reading
from mjlab_deploy.simulation.model_readings import ModelReadings, Readings, actuators_of
from mjlab_deploy.simulation.scene import load_scene


class ClosedLoop:
  """The robot of a bundle in MuJoCo C; targets act for one period of the policy.

  Args:
    bundle: The bundle.

  Raises:
    DeployError: The bundle has no scene, or its actuators are of a kind that MuJoCo alone does not compute.
  """

  def __init__(self, bundle: Bundle) -> None:
    self.description = bundle.description
    self.model = load_scene(bundle)
    self.model.opt.timestep = self.description.timing.physics_dt
    self.data = mujoco.MjData(self.model)
    self.sensors = ModelReadings(self.model, self.description)
    robot, model = self.description.robot, self.model
    joints, self._actuators, factors = [], [], []
    for target in self.description.targets:
      for name in target.joints:
        check_known("targets: joint of the robot", name, robot.joint_names)
        number = robot.joint_names.index(name)
        joint = robot.joints[number]
        with reading(f"joint '{name}' needs one actuator in scene.xml", ValueError):
          (actuator,) = actuators_of(model, self.sensors.joints[number])
        gear, factor = float(model.actuator_gear[actuator, 0]), 0.0
        if target.quantity == "effort":
          factor = 1.0 / gear
        elif model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE:
          factor = gear
        elif target.quantity == "velocity" or joint.stiffness is None or joint.damping is None:
          raise DeployError(f"joint '{name}': its actuator model is not one that MuJoCo computes")
        joints.append(number)
        self._actuators.append(actuator)
        factors.append(factor)
    self._qpos, self._qvel, self._factor = self.sensors.qpos[joints], self.sensors.qvel[joints], np.array(factors)
    # Servos that MuJoCo does not compute.
    is_own = self._factor == 0.0
    self._kp, self._kd = (robot.values(gain)[joints] * is_own for gain in ("stiffness", "damping"))
    self._limit = robot.values("effort_limit", np.inf)[joints]

  def start(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
    """Put the scene into a state."""
    mujoco.mj_resetData(self.model, self.data)
    self.data.qpos[:], self.data.qvel[:] = qpos, qvel
    mujoco.mj_forward(self.model, self.data)

  def readings(self) -> Readings:
    """Return the readings of the present state."""
    # After a step only qpos and qvel are up to date.
    mujoco.mj_fwdPosition(self.model, self.data)
    mujoco.mj_sensorPos(self.model, self.data)
    mujoco.mj_fwdVelocity(self.model, self.data)
    mujoco.mj_sensorVel(self.model, self.data)
    return self.sensors.read(self.data)

  def step(self, targets: Mapping[str, np.ndarray]) -> None:
    """Apply targets for one period of the policy."""
    data = self.data
    wanted = np.concatenate([targets[target.name] for target in self.description.targets]).astype(float)
    for _ in range(self.description.timing.decimation):
      effort = self._kp * (wanted - data.qpos[self._qpos]) - self._kd * data.qvel[self._qvel]
      data.ctrl[self._actuators] = self._factor * wanted + np.clip(effort, -self._limit, self._limit)
      mujoco.mj_step(self.model, data)

  @property
  def tilt(self) -> float:
    """Angle between the root's z axis and the vertical [rad]."""
    return float(np.arccos(np.clip(self.data.xmat[self.sensors.root, 8], -1.0, 1.0)))
