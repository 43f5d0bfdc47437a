"""The state an entity starts in, read from its configuration and its spec before anything is compiled."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mjlab_core.names import match_values

from mjlab_scene.entity_cfg import InitialStateCfg

POSITION_WIDTH = {
  mujoco.mjtJoint.mjJNT_FREE: 7,
  mujoco.mjtJoint.mjJNT_BALL: 4,
  mujoco.mjtJoint.mjJNT_SLIDE: 1,
  mujoco.mjtJoint.mjJNT_HINGE: 1,
}
VELOCITY_WIDTH = {
  mujoco.mjtJoint.mjJNT_FREE: 6,
  mujoco.mjtJoint.mjJNT_BALL: 3,
  mujoco.mjtJoint.mjJNT_SLIDE: 1,
  mujoco.mjtJoint.mjJNT_HINGE: 1,
}


@dataclass(frozen=True, kw_only=True)
class InitialState:
  """Where an entity starts, by name, so that it does not depend on what else is in the scene."""

  root_pose: np.ndarray
  """Position and unit quaternion of the root body, relative to the world's origin, (7,) [m, 1]."""
  root_velocity: np.ndarray
  """Linear and angular velocity of the root link, world frame, (6,) [m/s, rad/s]; zero unless the base floats."""
  joint_pos: dict[str, np.ndarray]
  """Position of each joint but the free one, (1,) [rad or m] or a unit quaternion (4,)."""
  joint_vel: dict[str, np.ndarray]
  """Velocity of each joint but the free one, (1,) or (3,) [rad/s or m/s]."""
  ctrl: dict[str, float]
  """Control of each actuator in the scene's keyframe."""


def read_initial_state(
  spec: mujoco.MjSpec, cfg: InitialStateCfg, root: mujoco.MjsBody | None, floating: bool, owner: str
) -> InitialState:
  """The initial state of the entity that `spec` describes; `root` is its own root body, None if that is yet to be made.

  Raises:
    ValueError: a pattern matches nothing, a value has the wrong size, a zero quaternion, a position outside the limits
      of its joint, a velocity for a base that does not float, or `joint_pos` is None and the spec has no keyframe.
  """
  joints = [joint for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
  root_pose = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) if root is None else _placed(spec, root)
  root_velocity = np.zeros(6)
  joint_pos = {joint.name: _reference(joint, spec.compiler.degree) for joint in joints}
  joint_vel = {joint.name: np.zeros(VELOCITY_WIDTH[joint.type]) for joint in joints}
  ctrl: dict[str, float] = {}

  if cfg.joint_pos is None:
    if not spec.keys:
      raise ValueError(f"{owner}: joint_pos is None, which takes the model's keyframe, but the model has none")
    _read_key(spec, spec.keys[0], floating, root_pose, root_velocity, joint_pos, joint_vel, ctrl, owner)
  else:
    _, names, values = match_values(cfg.joint_pos, list(joint_pos), what="joint", owner=owner)
    for name, value in zip(names, values, strict=True):
      joint_pos[name] = _sized(value, joint_pos[name].size, f"{owner}, joint_pos of '{name}'")
    _check_limits([joint for joint in joints if joint.name in names], joint_pos, spec.compiler.degree, owner)
  _, names, values = match_values(cfg.joint_vel, list(joint_vel), what="joint", owner=owner)
  for name, value in zip(names, values, strict=True):
    joint_vel[name] = _sized(value, joint_vel[name].size, f"{owner}, joint_vel of '{name}'")

  if cfg.pos is not None:
    root_pose[:3] = _sized(cfg.pos, 3, f"{owner}, pos")
  if cfg.rot is not None:
    root_pose[3:] = _sized(cfg.rot, 4, f"{owner}, rot")
  root_pose[3:] = _unit(root_pose[3:], f"{owner}, rot")
  for name, value in joint_pos.items():
    if value.size == 4:
      joint_pos[name] = _unit(value, f"{owner}, joint_pos of '{name}'")
  velocity = [*_sized(cfg.lin_vel, 3, f"{owner}, lin_vel"), *_sized(cfg.ang_vel, 3, f"{owner}, ang_vel")]
  if any(velocity):
    if not floating:
      raise ValueError(f"{owner}: lin_vel and ang_vel need a floating base, and this one has no free joint")
    root_velocity[:] = velocity

  for actuator in spec.actuators:
    ctrl.setdefault(actuator.name, _servo_target(actuator, joint_pos))
  _, names, values = match_values(cfg.ctrl, [a.name for a in spec.actuators], what="actuator", owner=owner)
  ctrl.update(zip(names, map(float, values), strict=True))
  return InitialState(
    root_pose=root_pose, root_velocity=root_velocity, joint_pos=joint_pos, joint_vel=joint_vel, ctrl=ctrl
  )


def _placed(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> np.ndarray:
  """Pose in the world of a body on top level, through the frames around it, (7,)."""
  pose = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
  element: mujoco.MjsBody | mujoco.MjsFrame | None = body
  while element is not None:
    quat = np.array(element.quat)
    if element.alt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT:
      quat = np.array(
        spec.resolve_orientation(
          degree=bool(spec.compiler.degree), sequence=spec.compiler.eulerseq, orientation=element.alt
        )
      )
    pos, rot = np.zeros(3), np.zeros(4)
    mujoco.mju_mulPose(pos, rot, np.array(element.pos), quat, pose[:3], pose[3:])
    pose[:3], pose[3:] = pos, rot
    element = element.frame
  return pose


def _reference(joint: mujoco.MjsJoint, degree: bool) -> np.ndarray:
  if joint.type == mujoco.mjtJoint.mjJNT_BALL:
    return np.array([1.0, 0.0, 0.0, 0.0])
  return np.array([joint.ref * _radians(joint, degree)])


def _radians(joint: mujoco.MjsJoint, degree: bool) -> float:
  # A spec holds what the file says; the compiler converts degrees later.
  return math.pi / 180 if degree and joint.type == mujoco.mjtJoint.mjJNT_HINGE else 1.0


def _sized(value: float | Sequence[float], size: int, where: str) -> np.ndarray:
  numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
  if numbers.shape != (size,):
    wanted = {1: "one number", 3: "three numbers", 4: "a quaternion (w, x, y, z)"}[size]
    raise ValueError(f"{where}: {value!r} must be {wanted}")
  if not np.isfinite(numbers).all():
    raise ValueError(f"{where}: {value!r} must be finite")
  return numbers


def _unit(quaternion: np.ndarray, where: str) -> np.ndarray:
  norm = np.linalg.norm(quaternion)
  if norm < 1e-6:
    raise ValueError(f"{where}: the quaternion {quaternion.tolist()} is zero and names no orientation")
  return quaternion / norm


def _check_limits(
  joints: Sequence[mujoco.MjsJoint], joint_pos: Mapping[str, np.ndarray], degree: bool, owner: str
) -> None:
  for joint in joints:
    limited = joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE or (
      joint.limited == mujoco.mjtLimited.mjLIMITED_AUTO and joint.range[0] != joint.range[1]
    )
    if not limited or joint.type == mujoco.mjtJoint.mjJNT_BALL:
      continue
    low, high = np.asarray(joint.range) * _radians(joint, degree)
    value = joint_pos[joint.name][0]
    if not low - 1e-6 <= value <= high + 1e-6:
      raise ValueError(f"{owner}: initial position {value:g} of joint '{joint.name}' is outside [{low:g}, {high:g}]")


def _servo_target(actuator: mujoco.MjsActuator, joint_pos: Mapping[str, np.ndarray]) -> float:
  servo = (
    actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT
    and actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED
    and actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE
    and actuator.biasprm[1] != 0
  )
  position = joint_pos.get(actuator.target)
  return float(position[0] * actuator.gear[0]) if servo and position is not None and position.size == 1 else 0.0


def _read_key(
  spec: mujoco.MjSpec,
  key: mujoco.MjsKey,
  floating: bool,
  root_pose: np.ndarray,
  root_velocity: np.ndarray,
  joint_pos: dict[str, np.ndarray],
  joint_vel: dict[str, np.ndarray],
  ctrl: dict[str, float],
  owner: str,
) -> None:
  qpos, qvel = list(key.qpos), list(key.qvel)
  for numbers, widths, what in ((qpos, POSITION_WIDTH, "qpos"), (qvel, VELOCITY_WIDTH, "qvel")):
    expected = sum(widths[joint.type] for joint in spec.joints)
    if numbers and len(numbers) != expected:
      raise ValueError(f"{owner}: keyframe '{key.name}' has {len(numbers)} numbers in {what}, the model {expected}")
  q, v = 0, 0
  for joint in spec.joints:
    nq, nv = POSITION_WIDTH[joint.type], VELOCITY_WIDTH[joint.type]
    position, velocity = np.array(qpos[q : q + nq]), np.array(qvel[v : v + nv])
    q, v = q + nq, v + nv
    if joint.type == mujoco.mjtJoint.mjJNT_FREE:
      if qpos:
        root_pose[:] = position
      if qvel:
        root_velocity[:] = velocity
        root_velocity[3:] = _rotate(root_pose[3:], velocity[3:])
      continue
    if qpos:
      joint_pos[joint.name] = position
    if qvel:
      joint_vel[joint.name] = velocity
  mocap = [body for body in spec.bodies if body.mocap]
  if not floating and mocap:
    if len(key.mpos):
      root_pose[:3] = list(key.mpos)[:3]
    if len(key.mquat):
      root_pose[3:] = list(key.mquat)[:4]
  if len(key.ctrl) == len(spec.actuators):
    ctrl.update({actuator.name: float(value) for actuator, value in zip(spec.actuators, key.ctrl, strict=True)})


def _rotate(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
  rotated = np.zeros(3)
  mujoco.mju_rotVecQuat(rotated, vector, quaternion / np.linalg.norm(quaternion))
  return rotated
