"""The scene's one keyframe, put together from the initial states of its entities."""

from collections.abc import Mapping

import mujoco
import numpy as np

from mjlab_scene.initial_state import POSITION_WIDTH, VELOCITY_WIDTH, InitialState

INIT_STATE = "init_state"
"""Name of the scene's keyframe."""


def add_init_state(spec: mujoco.MjSpec, states: Mapping[str, InitialState], roots: Mapping[str, str]) -> None:
  """Add the keyframe "init_state" to the assembled `spec`: every entity at its initial state, at the world's origin.

  `states` and `roots` (full name of the root body) go by the prefix of the entity's names. Joints, mocap bodies and
  actuators that belong to no entity keep the model's reference and zero control.
  """
  qpos: list[float] = []
  qvel: list[float] = []
  for joint in spec.joints:
    prefix, state = _owner(joint.name, states)
    if state is None:
      reference = [0.0] * POSITION_WIDTH[joint.type]
      if joint.type == mujoco.mjtJoint.mjJNT_BALL:
        reference[0] = 1.0
      elif joint.type == mujoco.mjtJoint.mjJNT_FREE:
        reference = [*joint.parent.pos, *joint.parent.quat]
      qpos.extend(reference)
      qvel.extend([0.0] * VELOCITY_WIDTH[joint.type])
    elif joint.type == mujoco.mjtJoint.mjJNT_FREE:
      qpos.extend(state.root_pose)
      qvel.extend([*state.root_velocity[:3], *_into_body(state.root_pose[3:], state.root_velocity[3:])])
    else:
      name = joint.name.removeprefix(prefix)
      qpos.extend(state.joint_pos[name])
      qvel.extend(state.joint_vel[name])
  mpos: list[float] = []
  mquat: list[float] = []
  for body in spec.bodies:
    if not body.mocap:
      continue
    prefix, state = _owner(body.name, states)
    at_root = state is not None and roots[prefix] == body.name
    mpos.extend(state.root_pose[:3] if state is not None and at_root else body.pos)
    mquat.extend(state.root_pose[3:] if state is not None and at_root else body.quat)
  ctrl: list[float] = []
  for actuator in spec.actuators:
    prefix, state = _owner(actuator.name, states)
    ctrl.append(0.0 if state is None else state.ctrl[actuator.name.removeprefix(prefix)])
  spec.add_key(name=INIT_STATE, qpos=qpos, qvel=qvel, mpos=mpos, mquat=mquat, ctrl=ctrl)


def _owner(name: str, states: Mapping[str, InitialState]) -> tuple[str, InitialState | None]:
  for prefix, state in states.items():
    if name.startswith(prefix):
      return prefix, state
  return "", None


def _into_body(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
  inverse, rotated = np.zeros(4), np.zeros(3)
  mujoco.mju_negQuat(inverse, quaternion)
  mujoco.mju_rotVecQuat(rotated, vector, inverse)
  return rotated
