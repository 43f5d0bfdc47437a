"""State that an entity starts in: configured, read from its spec, and joined to the keyframe of a scene."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from mjlab_actuators import command_fields_of
from mjlab_core import Config, ConfigError, Finite, MjlabError, check_fields, check_value, match_values

INIT_STATE = "init_state"
"""Name of the scene's keyframe."""

_IDENTITY = (1.0, 0.0, 0.0, 0.0)
_FREE = mujoco.mjtJoint.mjJNT_FREE


@dataclass(kw_only=True)
class InitialStateCfg(Config):
  """The state an entity is reset to, relative to the origin of its world.

  Patterns match whole names; a pattern that matches nothing is an error. A joint that no pattern
  matches keeps the model's reference position, zero by default, and zero velocity.
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
  the initial position of its target."""


@dataclass(frozen=True, kw_only=True)
class InitialState:
  """State that an entity starts in, by local name, so that it does not depend on the rest of the scene."""

  root: str
  """Name of the root body."""
  root_pose: np.ndarray
  """Position and unit quaternion of the root body, relative to the world's origin, (7,) [m, 1]."""
  root_velocity: np.ndarray
  """Linear and angular velocity of the root link, world frame, (6,) [m/s, rad/s]; zero unless the base floats."""
  joint_pos: dict[str, np.ndarray]
  """Position of each joint but the free one, (1,) [rad or m] or a unit quaternion (4,)."""
  joint_vel: dict[str, np.ndarray]
  """Velocity of each joint but the free one, (1,) or (3,) [rad/s or m/s]."""
  tendon_len: dict[str, float]
  """Length of each tendon [m or rad]."""
  site_pos: dict[str, float]
  """Position along its gear of each site that an actuator acts on [m or rad]."""
  ctrl: dict[str, np.ndarray]
  """Control of each actuator in the scene's keyframe, one number per input."""


def read_initial_state(
  spec: mujoco.MjSpec, cfg: InitialStateCfg, root: str, has_root: bool, owner: str
) -> tuple[mujoco.MjModel, InitialState]:
  """Return the model of an entity alone, and its initial state: the reference or a keyframe, changed by `cfg`.

  Args:
    spec: The entity alone, every element named.
    cfg: Changes of the state.
    root: Name of the root body.
    has_root: True if the spec has this body, with a free joint or as mocap body; False for a fixed base.
    owner: Beginning of error messages.

  Raises:
    MjlabError: The spec cannot be compiled, a pattern matches nothing, a value has the wrong size, a quaternion is
      zero, a position is outside the limits of its joint, a velocity is given for a base that does not float, or
      `joint_pos` is None and the spec has no keyframe.
  """
  check_fields(cfg, owner)
  model, data, holds_ctrl = _compiled(spec, cfg.joint_pos is None, owner)
  joints = {model.joint(i).name: data.joint(i) for i in range(model.njnt) if model.jnt_type[i] != _FREE}
  positions = {name: joint.qpos for name, joint in joints.items()}
  moved = _set(positions, cfg.joint_pos or {}, "joint", owner, "joint_pos")
  if problems := list(_limit_problems(model, {name: positions[name] for name in moved}, owner)):
    raise ConfigError(*problems)
  for name, position in positions.items():
    if position.size == 4:
      position[:] = _unit(position, f"{owner}, joint_pos of '{name}'")
  _set({name: joint.qvel for name, joint in joints.items()}, cfg.joint_vel, "joint", owner, "joint_vel")
  pose, velocity = _place_root(model, data, cfg, model.body(root).id if has_root else 0, owner)
  for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_transmission):
    stage(model, data)
  lengths = data.actuator_length[model.actuator_outadr]
  ctrl: dict[str, np.ndarray] = {}
  for i, length in enumerate(lengths):
    start = model.actuator_ctrladr[i]
    inputs = ctrl[model.actuator(i).name] = data.ctrl[start : start + model.actuator_ctrlnum[i]]
    if not holds_ctrl:
      inputs[:] = [length if field == "position_target" else 0.0 for field in command_fields_of(model, i)] or 0.0
  _set(ctrl, cfg.ctrl, "actuator", owner, "ctrl")
  at_site = np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_SITE)
  return model, InitialState(
    root=root,
    root_pose=pose,
    root_velocity=velocity,
    joint_pos={name: joint.qpos.copy() for name, joint in joints.items()},
    joint_vel={name: joint.qvel.copy() for name, joint in joints.items()},
    tendon_len={model.tendon(i).name: float(length) for i, length in enumerate(data.ten_length)},
    site_pos={model.site(model.actuator_trnid[i, 0]).name: float(lengths[i]) for i in at_site},
    ctrl={name: inputs.copy() for name, inputs in ctrl.items()},
  )


def _compiled(spec: mujoco.MjSpec, with_key: bool, owner: str) -> tuple[mujoco.MjModel, mujoco.MjData, bool]:
  """Return the entity alone at its reference or its first keyframe, and True if that has the controls."""
  if with_key and not spec.keys:
    raise MjlabError(f"{owner}: joint_pos=None takes the model's keyframe, but the model has none")
  alone = spec.copy()
  for key in list(alone.keys)[int(with_key) :]:
    alone.delete(key)
  ctrl: list[float] = []
  for key in alone.keys:
    # The keyframe of a model lacks the actuators that configs add.
    ctrl, key.ctrl, key.act = list(key.ctrl), [], []
  try:
    model = alone.compile()
  except ValueError as error:
    raise MjlabError(f"{owner}: its model cannot be made: {error}") from error
  data = mujoco.MjData(model)
  if with_key:
    mujoco.mj_resetDataKeyframe(model, data, 0)
  holds_ctrl = with_key and len(ctrl) == model.nu
  if holds_ctrl:
    data.ctrl[:] = ctrl
  return model, data, holds_ctrl


def _set(arrays: Mapping[str, np.ndarray], values: Mapping[str, Any], what: str, owner: str, field: str) -> list[str]:
  """Overwrite arrays with values by pattern, and return the names that they match."""
  _, names, matched = match_values(values, list(arrays), what=what, owner=owner)
  for name, value in zip(names, matched, strict=True):
    where, size = f"{owner}, {field} of '{name}'", arrays[name].size
    numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
    if numbers.shape != (size,):
      wanted = "a quaternion (w, x, y, z)" if size == 4 else f"of length {size}"
      raise MjlabError(f"{where}: {value!r} must be {wanted}")
    check_value(where, tuple(numbers.tolist()), tuple[Finite, ...])
    arrays[name][:] = numbers
  return names


def _limit_problems(model: mujoco.MjModel, positions: Mapping[str, np.ndarray], owner: str) -> Iterator[str]:
  for name, position in positions.items():
    joint = model.joint(name)
    low, high = joint.range
    if model.jnt_limited[joint.id] and position.size == 1 and not low - 1e-6 <= position[0] <= high + 1e-6:
      yield f"{owner}: initial position {position[0]:g} of joint '{name}' is outside [{low:g}, {high:g}]"


def _place_root(
  model: mujoco.MjModel, data: mujoco.MjData, cfg: InitialStateCfg, body: int, owner: str
) -> tuple[np.ndarray, np.ndarray]:
  """Place the root body as `cfg` says, and return its pose and its velocity; body 0 stands for a fixed base."""
  mujoco.mj_kinematics(model, data)
  pose, velocity = np.concatenate((data.xpos[body], data.xquat[body])), np.zeros(6)
  free = data.joint(model.body_jntadr[body]) if model.body_jntnum[body] else None
  if free is not None:
    velocity[:3] = free.qvel[:3]
    mujoco.mju_rotVecQuat(velocity[3:], free.qvel[3:], pose[3:])
  if cfg.pos is not None:
    pose[:3] = cfg.pos
  if cfg.rot is not None:
    pose[3:] = _unit(np.array(cfg.rot), f"{owner}, rot")
  given = [*cfg.lin_vel, *cfg.ang_vel]
  if free is not None:
    free.qpos[:] = pose
  elif body:
    row = model.body_mocapid[body]
    data.mocap_pos[row], data.mocap_quat[row] = pose[:3], pose[3:]
  if any(given):
    if free is None:
      raise MjlabError(f"{owner}: lin_vel and ang_vel need a floating base; this one has no free joint")
    velocity[:] = given
  return pose, velocity


def _unit(quaternion: np.ndarray, where: str) -> np.ndarray:
  norm = np.linalg.norm(quaternion)
  if norm < 1e-6:
    raise MjlabError(f"{where}: the quaternion {quaternion.tolist()} is zero and names no orientation")
  return quaternion / norm


def add_init_state(spec: mujoco.MjSpec, states: Mapping[str, InitialState]) -> None:
  """Add the keyframe "init_state" to an assembled scene: every entity in its initial state, at the world's origin.

  Joints, mocap bodies and actuators outside of entities keep the model's reference and zero control.

  Args:
    spec: The scene; edited.
    states: Initial states by the prefix of the entity's names.
  """
  key: dict[str, list[float]] = defaultdict(list)
  for joint in spec.joints:
    name, state = _state_of(joint.name, states)
    if joint.type == _FREE:
      qpos, qvel = [*joint.parent.pos, *joint.parent.quat] if state is None else state.root_pose, np.zeros(6)
      if state is not None:
        into_body = np.zeros(4)
        mujoco.mju_negQuat(into_body, state.root_pose[3:])
        qvel[:3] = state.root_velocity[:3]
        mujoco.mju_rotVecQuat(qvel[3:], state.root_velocity[3:], into_body)
    elif state is not None:
      qpos, qvel = state.joint_pos[name], state.joint_vel[name]
    else:
      qpos, qvel = (_IDENTITY, np.zeros(3)) if joint.type == mujoco.mjtJoint.mjJNT_BALL else ([0.0], [0.0])
    key["qpos"] += [*qpos]
    key["qvel"] += [*qvel]
  for body in spec.bodies:
    if body.mocap:
      name, state = _state_of(body.name, states)
      pose = state.root_pose if state is not None and state.root == name else [*body.pos, *body.quat]
      key["mpos"] += [*pose[:3]]
      key["mquat"] += [*pose[3:]]
  for actuator in spec.actuators:
    name, state = _state_of(actuator.name, states)
    # An actuator has an input for each bit, or one if it has no bits.
    key["ctrl"] += [0.0] * max(1, int(actuator.ctrlspec).bit_count()) if state is None else [*state.ctrl[name]]
  spec.add_key(name=INIT_STATE, **key)


def _state_of(name: str, states: Mapping[str, InitialState]) -> tuple[str, InitialState | None]:
  """Return the local name of an element and the state of its entity, if it belongs to one."""
  return next(
    ((name.removeprefix(prefix), of) for prefix, of in states.items() if name.startswith(prefix)), (name, None)
  )
