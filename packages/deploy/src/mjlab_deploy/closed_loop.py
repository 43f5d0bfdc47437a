"""A policy and its robot in MuJoCo C, as in training."""

from collections.abc import Mapping

import mujoco
import numpy as np

from mjlab_deploy.bundle import Bundle
from mjlab_deploy.description import Joint
from mjlab_deploy.errors import DeployError, reading
from mjlab_deploy.model_readings import ModelReadings, Readings, actuators_of, joint_id
from mjlab_deploy.scene import load_scene


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
    self._servos: list[tuple[str, int, int, float]] = []
    self._drives: list[tuple[str, int, int, int, int, Joint]] = []
    by_name = {joint.name: joint for joint in self.description.robot.joints}
    with reading("targets: joint of the robot", KeyError):
      targets = [(t, column, by_name[name]) for t in self.description.targets for column, name in enumerate(t.joints)]
    for target, column, joint in targets:
      model, number = self.model, joint_id(self.model, f"{self.description.robot.name}/{joint.name}")
      with reading(f"joint '{joint.name}' needs one actuator in scene.xml", ValueError):
        (actuator,) = actuators_of(model, number)
      is_servo, is_effort = (
        model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE,
        target.quantity == "effort",
      )
      gear = float(model.actuator_gear[actuator, 0])
      if is_servo or is_effort:
        self._servos.append((target.name, column, actuator, 1.0 / gear if is_effort else gear))
      elif target.quantity == "velocity" or joint.stiffness is None or joint.damping is None:
        raise DeployError(f"joint '{joint.name}': its actuator model is not one that MuJoCo computes")
      else:
        q, v = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
        self._drives.append((target.name, column, actuator, q, v, joint))

  def start(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
    """Put the scene into a state."""
    mujoco.mj_resetData(self.model, self.data)
    self.data.qpos[:], self.data.qvel[:] = qpos, qvel
    mujoco.mj_forward(self.model, self.data)

  def readings(self) -> Readings:
    """Return the readings of the present state."""
    # After a step positions are new and all that follows from them is old.
    mujoco.mj_fwdPosition(self.model, self.data)
    mujoco.mj_sensorPos(self.model, self.data)
    mujoco.mj_fwdVelocity(self.model, self.data)
    mujoco.mj_sensorVel(self.model, self.data)
    return self.sensors.read(self.data)

  def step(self, targets: Mapping[str, np.ndarray]) -> None:
    """Apply targets for one period of the policy."""
    data = self.data
    for _ in range(self.description.timing.decimation):
      for output, column, actuator, factor in self._servos:
        data.ctrl[actuator] = float(targets[output][column]) * factor
      for output, column, actuator, q, v, joint in self._drives:
        effort = (joint.stiffness or 0.0) * (targets[output][column] - data.qpos[q]) - (
          joint.damping or 0.0
        ) * data.qvel[v]
        limit = joint.effort_limit
        data.ctrl[actuator] = effort if limit is None else min(max(effort, -limit), limit)
      mujoco.mj_step(self.model, data)

  @property
  def tilt(self) -> float:
    """Angle between the root's z axis and the vertical [rad]."""
    robot = self.description.robot
    up = self.data.body(f"{robot.name}/{robot.root_body}").xmat[8]
    return float(np.arccos(np.clip(up, -1.0, 1.0)))
