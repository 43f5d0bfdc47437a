"""State that an entity starts in: configured, read from its spec, and joined to the keyframe of a scene."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from mjlab_actuators import command_fields_of
from mjlab_core import Config, ConfigError, Finite, MjlabError, check_fields, check_value, match_values

INIT_STATE = "init_state"
"""Name of the scene's keyframe."""

_IDENTITY = (1.0, 0.0, 0.0, 0.0)
_ORIGIN = (0.0, 0.0, 0.0, *_IDENTITY)


@dataclass(kw_only=True)
class InitialStateCfg(Config):
  """The state an entity is reset to, relative to the origin of its world.

  Patterns are matched as a whole against names; a pattern that matches nothing is an error. A joint that no pattern
  names keeps the model's reference position (zero unless the model says otherwise) and zero velocity.
  """

  pos: tuple[Finite, Finite, Finite] | None = None
  """Position of the root body [m]; None: the keyframe's if `joint_pos` is None, else the model's (fixed base: zero)."""
  rot: tuple[Finite, Finite, Finite, Finite] | None = None
  """Orientation of the root body, unit quaternion (w, x, y, z); None: as for `pos`."""
  lin_vel: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
  """Linear velocity of the root link's origin, world frame [m/s]; floating base only."""
  ang_vel: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
  """Angular velocity of the root link, world frame [rad/s]; floating base only."""
  joint_pos: Mapping[str, float | tuple[float, float, float, float]] | None = field(default_factory=dict)
  """Joint positions by pattern [rad or m], a quaternion for a ball joint; None takes the model's first keyframe."""
  joint_vel: Mapping[str, float | tuple[float, float, float]] = field(default_factory=dict)
  """Joint velocities by pattern [rad/s or m/s], three numbers for a ball joint."""
  ctrl: Mapping[str, float | Sequence[float]] = field(default_factory=dict)
  """Controls of the scene's keyframe by actuator pattern, one number per input; an input that is a position defaults to
  the joint's initial position."""


@dataclass(frozen=True, kw_only=True)
class InitialState:
  """State that an entity starts in, by local name, so that it does not depend on what else is in the scene."""

  root_pose: np.ndarray
  """Position and unit quaternion of the root body, relative to the world's origin, (7,) [m, 1]."""
  root_velocity: np.ndarray
  """Linear and angular velocity of the root link, world frame, (6,) [m/s, rad/s]; zero unless the base floats."""
  joint_pos: dict[str, np.ndarray]
  """Position of each joint but the free one, (1,) [rad or m] or a unit quaternion (4,)."""
  joint_vel: dict[str, np.ndarray]
  """Velocity of each joint but the free one, (1,) or (3,) [rad/s or m/s]."""
  ctrl: dict[str, tuple[float, ...]]
  """Control of each actuator in the scene's keyframe."""


def read_initial_state(
  spec: mujoco.MjSpec, cfg: InitialStateCfg, root: mujoco.MjsBody | None, floating: bool, owner: str
) -> InitialState:
  """Return the initial state of the entity that `spec` describes.

  Args:
    spec: The entity alone, every element named.
    cfg: Overrides what the spec says.
    root: The entity's own root body; None for a fixed base, which has none.
    floating: True if `root` has a free joint.
    owner: Beginning of error messages.

  Raises:
    MjlabError: A pattern matches nothing, a value has the wrong size, a quaternion is zero, a position is outside the
      limits of its joint, a velocity is given for a base that does not float, or `joint_pos` is None and the spec has
      no keyframe.
  """
  check_fields(cfg, owner)
  state = _reference_state(spec, root)
  _place_joints(spec, cfg, floating, state, owner)
  _place_root(cfg, floating, state, owner)
  _set_controls(spec, cfg, state, owner)
  return state


def _reference_state(spec: mujoco.MjSpec, root: mujoco.MjsBody | None) -> InitialState:
  """Return what the model itself says, at rest."""
  joints = [joint for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
  return InitialState(
    root_pose=np.array(_ORIGIN) if root is None else _placed(spec, root),
    root_velocity=np.zeros(6),
    joint_pos={joint.name: _reference(joint, spec.compiler.degree) for joint in joints},
    joint_vel={joint.name: np.zeros(_widths(joint)[1]) for joint in joints},
    ctrl={},
  )


def _place_joints(spec: mujoco.MjSpec, cfg: InitialStateCfg, floating: bool, state: InitialState, owner: str) -> None:
  """Overwrite joints with the keyframe or the configured values, which must be within limits."""
  if cfg.joint_pos is None:
    if not spec.keys:
      raise MjlabError(f"{owner}: joint_pos=None takes the model's keyframe, but the model has none")
    _read_key(spec, spec.keys[0], floating, state, owner)
  else:
    named = _set_joints(state.joint_pos, cfg.joint_pos, owner, "joint_pos")
    given = [joint for joint in spec.joints if joint.name in named]
    if problems := list(_limit_problems(given, state, spec.compiler.degree)):
      raise ConfigError(*(f"{owner}: {problem}" for problem in problems))
  for name, value in state.joint_pos.items():
    if value.size == 4:
      state.joint_pos[name] = _unit(value, f"{owner}, joint_pos of '{name}'")
  _set_joints(state.joint_vel, cfg.joint_vel, owner, "joint_vel")


def _place_root(cfg: InitialStateCfg, floating: bool, state: InitialState, owner: str) -> None:
  """Overwrite pose and velocity of the root with configured ones."""
  if cfg.pos is not None:
    state.root_pose[:3] = cfg.pos
  if cfg.rot is not None:
    state.root_pose[3:] = cfg.rot
  state.root_pose[3:] = _unit(state.root_pose[3:], f"{owner}, rot")
  velocity = [*cfg.lin_vel, *cfg.ang_vel]
  if any(velocity):
    if not floating:
      raise MjlabError(f"{owner}: lin_vel and ang_vel need a floating base; this one has no free joint")
    state.root_velocity[:] = velocity


def _set_controls(spec: mujoco.MjSpec, cfg: InitialStateCfg, state: InitialState, owner: str) -> None:
  """Overwrite controls with configured ones; those that no keyframe gave hold the joints where they are."""
  for actuator in spec.actuators:
    state.ctrl.setdefault(actuator.name, _resting_ctrl(actuator, state.joint_pos))
  _, names, values = match_values(cfg.ctrl, list(state.ctrl), what="actuator", owner=owner)
  for name, value in zip(names, values, strict=True):
    state.ctrl[name] = tuple(_sized(value, len(state.ctrl[name]), f"{owner}, ctrl of '{name}'"))


def _widths(joint: mujoco.MjsJoint) -> tuple[int, int]:
  """Return the numbers of a joint in qpos and in qvel."""
  return {mujoco.mjtJoint.mjJNT_FREE: (7, 6), mujoco.mjtJoint.mjJNT_BALL: (4, 3)}.get(joint.type, (1, 1))


def _set_joints(
  state: dict[str, np.ndarray], values: Mapping[str, float | tuple[float, ...]], owner: str, field: str
) -> list[str]:
  """Overwrite `state` with `values` by pattern and return the names that they match."""
  _, names, matched = match_values(values, list(state), what="joint", owner=owner)
  for name, value in zip(names, matched, strict=True):
    state[name] = _sized(value, state[name].size, f"{owner}, {field} of '{name}'")
  return names


def _placed(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> np.ndarray:
  """Return the pose in the world of a body on top level, through the frames around it, (7,)."""
  pose = np.array(_ORIGIN)
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
    return np.array(_IDENTITY)
  return np.array([joint.ref * _radians(joint, degree)])


def _radians(joint: mujoco.MjsJoint, degree: bool) -> float:
  # A spec holds what the file says; the compiler converts degrees later.
  return math.pi / 180 if degree and joint.type == mujoco.mjtJoint.mjJNT_HINGE else 1.0


def _sized(value: float | Sequence[float], size: int, where: str) -> np.ndarray:
  numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
  if numbers.shape != (size,):
    wanted = {1: "one number", 2: "two numbers", 3: "three numbers", 4: "a quaternion (w, x, y, z)"}[size]
    raise MjlabError(f"{where}: {value!r} must be {wanted}")
  check_value(where, tuple(numbers.tolist()), tuple[Finite, ...])
  return numbers


def _unit(quaternion: np.ndarray, where: str) -> np.ndarray:
  norm = np.linalg.norm(quaternion)
  if norm < 1e-6:
    raise MjlabError(f"{where}: the quaternion {quaternion.tolist()} is zero and names no orientation")
  return quaternion / norm


def _limit_problems(joints: Sequence[mujoco.MjsJoint], state: InitialState, degree: bool) -> Iterator[str]:
  for joint in joints:
    limited = joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE or (
      joint.limited == mujoco.mjtLimited.mjLIMITED_AUTO and joint.range[0] != joint.range[1]
    )
    if not limited or joint.type == mujoco.mjtJoint.mjJNT_BALL:
      continue
    low, high = np.asarray(joint.range) * _radians(joint, degree)
    value = state.joint_pos[joint.name][0]
    if not low - 1e-6 <= value <= high + 1e-6:
      yield f"initial position {value:g} of joint '{joint.name}' is outside [{low:g}, {high:g}]"


def _num_inputs(actuator: mujoco.MjsActuator) -> int:
  return max(1, len(command_fields_of(actuator)))


def _resting_ctrl(actuator: mujoco.MjsActuator, joint_pos: Mapping[str, np.ndarray]) -> tuple[float, ...]:
  """Return a number per input: where that is a position, the joint's times the gear, else zero."""
  fields = command_fields_of(actuator) or ("effort_target",)
  position = joint_pos.get(actuator.target) if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT else None
  length = 0.0 if position is None or position.size != 1 else float(position[0] * actuator.gear[0])
  return tuple(length if field == "position_target" else 0.0 for field in fields)


def _read_key(spec: mujoco.MjSpec, key: mujoco.MjsKey, floating: bool, state: InitialState, owner: str) -> None:
  """Overwrite `state` with a keyframe of the entity's model."""
  nq, nv = (sum(numbers) for numbers in zip((0, 0), *map(_widths, spec.joints), strict=True))
  for numbers, expected, what in ((key.qpos, nq, "qpos"), (key.qvel, nv, "qvel")):
    if len(numbers) not in (0, expected):
      raise MjlabError(f"{owner}: keyframe '{key.name}' has {len(numbers)} numbers in {what}, the model {expected}")
  qpos, qvel = np.array(key.qpos), np.array(key.qvel)
  for joint in spec.joints:
    widths = _widths(joint)
    (position, qpos), (velocity, qvel) = (np.split(of, [n]) for of, n in zip((qpos, qvel), widths, strict=True))
    if joint.type != mujoco.mjtJoint.mjJNT_FREE:
      if position.size:
        state.joint_pos[joint.name] = position
      if velocity.size:
        state.joint_vel[joint.name] = velocity
      continue
    if position.size:
      state.root_pose[:] = position
    if velocity.size:
      state.root_velocity[:3] = velocity[:3]
      quat = state.root_pose[3:] / np.linalg.norm(state.root_pose[3:])
      mujoco.mju_rotVecQuat(state.root_velocity[3:], velocity[3:], quat)
  if not floating and any(body.mocap for body in spec.bodies):
    if len(key.mpos):
      state.root_pose[:3] = list(key.mpos)[:3]
    if len(key.mquat):
      state.root_pose[3:] = list(key.mquat)[:4]
  inputs = [_num_inputs(actuator) for actuator in spec.actuators]
  if len(key.ctrl) == sum(inputs):
    numbers = iter(key.ctrl)
    for actuator, count in zip(spec.actuators, inputs, strict=True):
      state.ctrl[actuator.name] = tuple(float(next(numbers)) for _ in range(count))


def add_init_state(spec: mujoco.MjSpec, states: Mapping[str, InitialState], roots: Mapping[str, str]) -> None:
  """Add the keyframe "init_state" to an assembled scene: every entity in its initial state, at the world's origin.

  Joints, mocap bodies and actuators outside of entities keep the model's reference and zero control.

  Args:
    spec: The scene; edited.
    states: Initial states by the prefix of the entity's names.
    roots: Full name of the root body by the same prefix.
  """
  qpos: list[float] = []
  qvel: list[float] = []
  for joint in spec.joints:
    prefix, state = _owner(joint.name, states)
    if state is None:
      is_free = joint.type == mujoco.mjtJoint.mjJNT_FREE
      nq, nv = _widths(joint)
      qpos.extend([*joint.parent.pos, *joint.parent.quat] if is_free else _IDENTITY if nq == 4 else [0.0])
      qvel.extend([0.0] * nv)
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
    is_root = state is not None and roots[prefix] == body.name
    pose = state.root_pose if state is not None and is_root else [*body.pos, *body.quat]
    mpos.extend(pose[:3])
    mquat.extend(pose[3:])
  ctrl: list[float] = []
  for actuator in spec.actuators:
    prefix, state = _owner(actuator.name, states)
    at_rest = (0.0,) * _num_inputs(actuator)
    ctrl.extend(at_rest if state is None else state.ctrl[actuator.name.removeprefix(prefix)])
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
