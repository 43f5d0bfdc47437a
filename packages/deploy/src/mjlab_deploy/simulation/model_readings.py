"""Readings of a bundle's inputs from a MuJoCo model."""

from typing import Any

import mujoco
import numpy as np

from mjlab_deploy.description import Description, Input, Origin
from mjlab_deploy.errors import reading

Readings = dict[str, np.ndarray]
CAMERA = ("camera_rgb", "camera_depth")
"""Quantities that `mjlab_deploy.simulation.camera` draws."""


class ModelReadings:
  """Inputs of a policy that a MuJoCo model can supply, except images.

  Args:
    model: The model.
    description: Contents of `bundle.json`.

  Raises:
    DeployError: The model lacks a joint or the root of the robot, or an element that an input names.
  """

  def __init__(self, model: mujoco.MjModel, description: Description) -> None:
    self.model = model
    prefix = f"{description.robot.name}/" if description.robot.name else ""
    self.inputs: list[Input] = [
      item for item in description.inputs if item.origin is not None and item.origin.quantity not in CAMERA
    ]
    with reading("scene.xml", KeyError):
      self.joints = [model.joint(f"{prefix}{joint.name}").id for joint in description.robot.joints]
      """Numbers of the robot's joints."""
      self.root = int(model.body(f"{prefix}{description.robot.root_body}").id)
      """Number of the robot's root body."""
    self.qpos = model.jnt_qposadr[self.joints]
    """Columns of the robot's joints in qpos."""
    self.qvel = model.jnt_dofadr[self.joints]
    """Columns of the robot's joints in qvel."""
    # Find missing elements now.
    self.read(mujoco.MjData(model))

  def read(self, data: mujoco.MjData) -> Readings:
    """Return the inputs for a state whose positions, velocities and sensors are computed."""
    found: Readings = {}
    for item in self.inputs:
      assert item.origin is not None
      with reading(f"input '{item.name}': scene.xml", KeyError):
        found[item.name] = self._read(item.origin, data)
    return found

  def _read(self, origin: Origin, data: mujoco.MjData) -> np.ndarray:
    if origin.quantity == "joint_position":
      return data.qpos[self.qpos].copy()
    if origin.quantity == "joint_velocity":
      return data.qvel[self.qvel].copy()
    if origin.quantity == "sensor":
      return data.sensor(origin.name).data.copy()
    element = data.site(origin.name) if origin.object_type == "site" else data.body(origin.name)
    if origin.quantity in ("linear_velocity", "angular_velocity"):
      velocity = np.zeros(6)
      mujoco.mj_objectVelocity(self.model, data, mujoco.mjtObj.mjOBJ_XBODY, element.id, velocity, 1)
      return velocity[3:] if origin.quantity == "linear_velocity" else velocity[:3]
    frame = data.body(origin.relative_to or 0)
    to_frame = frame.xmat.reshape(3, 3).T
    if origin.quantity == "position":
      return to_frame @ (element.xpos - frame.xpos)
    rotation = to_frame @ element.xmat.reshape(3, 3)
    if origin.quantity == "projected_gravity":
      return -rotation[2]
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, rotation.ravel())
    return quat


def actuators_of(model: mujoco.MjModel, joint: int) -> list[int]:
  """Return the numbers of the actuators of a joint."""
  is_of_joint = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == joint)
  return np.flatnonzero(is_of_joint).tolist()


def joint_facts(model: mujoco.MjModel, name: str) -> dict[str, Any]:
  """Return armature and position range of a joint, as fields of `Joint`."""
  joint = model.joint(name)
  return {
    "armature": float(model.dof_armature[joint.dofadr[0]]),
    "position_range": tuple(joint.range.tolist()) if joint.limited[0] else None,
  }
