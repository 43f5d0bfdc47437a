"""Home pose of a robot: put on the ground, settled under gravity on its servos, and tried for two seconds."""

import re
from dataclasses import dataclass

import mujoco
import numpy as np
from mjlab_actuators import ActuatorCfg
from mjlab_core import MjlabError
from mjlab_scene import EntityArticulationCfg, EntityCfg, InitialStateCfg, Scene, SceneCfg
from mjlab_terrain import PlaneCfg

from mjlab.new.limbs import colliding, lowest

SECONDS = 2.0
MAX_TILT = 20.0  # degrees
MAX_DROP = 0.12  # share of the height


@dataclass(kw_only=True)
class Home:
  """Pose that a robot rests in."""

  root: np.ndarray
  """Position and unit quaternion of a floating base, (7,) [m, 1]."""
  joint_pos: dict[str, float]
  """Position of each hinge and slide [rad, m]."""
  stands: bool
  """True if the robot stays there for `SECONDS`, its servos holding the pose."""
  touching: tuple[str, ...]
  """Bodies that touch the ground at the end."""
  model: mujoco.MjModel
  """Robot on a plane; its names begin with "robot/"."""
  qpos: np.ndarray
  """The home pose in this model."""


Attitude = tuple[float, float, float, float]


def settle(spec: mujoco.MjSpec, actuators: tuple[ActuatorCfg, ...], pose: dict[str, float], rot: Attitude) -> Home:
  """Return the pose into which a robot settles from `pose`; that pose on the ground if it falls over.

  Args:
    spec: The robot without actuators that `actuators` replace.
    actuators: Its servos.
    pose: Positions of hinges and slides [rad, m].
    rot: Attitude of a floating base, (w, x, y, z).

  Raises:
    MjlabError: The robot diverges.
  """
  floats = any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints)
  entity = EntityCfg(
    spec_fn=spec.copy,
    init_state=InitialStateCfg(
      pos=(0.0, 0.0, 0.0),
      rot=rot if floats else None,
      joint_pos={re.escape(name): value for name, value in pose.items()},
    ),
    articulation=EntityArticulationCfg(actuators=actuators),
  )
  scene = Scene(SceneCfg(num_envs=1, terrain=PlaneCfg(), entities={"robot": entity}))
  model = scene.spec.compile()
  data = mujoco.MjData(model)
  start = _on_the_ground(model, data, model.key_qpos[0]) if floats else model.key_qpos[0].copy()
  settled, stays, _ = _simulate(model, data, start, model.key_ctrl[0], 2.0 * MAX_DROP)
  home = start
  touching: tuple[str, ...] = ()
  if stays:
    home = _rounded(model, settled, floats)
    ctrl = _ctrl(model, home)
    _, stays, touching = _simulate(model, data, home, ctrl, MAX_DROP)
  if not stays:
    home = start
  joints = {name: float(home[model.joint(f"robot/{name}").qposadr[0]]) for name in pose}
  place = home[:7] if floats else np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
  return Home(root=place, joint_pos=joints, stands=stays, touching=touching, model=model, qpos=home)


def exclude_overlaps(spec: mujoco.MjSpec, pose: dict[str, float]) -> list[tuple[str, str]]:
  """Exclude contacts between bodies of the robot that overlap in a pose; return the pairs."""
  model = spec.copy().compile()
  data = mujoco.MjData(model)
  for name, value in pose.items():
    data.joint(name).qpos[0] = value
  mujoco.mj_forward(model, data)
  pairs = {
    tuple(
      sorted((model.body(model.geom_bodyid[contact.geom1]).name, model.body(model.geom_bodyid[contact.geom2]).name))
    )
    for contact in data.contact[: data.ncon]
    if contact.dist < 0.0
  }
  for number, (one, other) in enumerate(sorted(pairs)):
    spec.add_exclude(name=f"overlap_{number}", bodyname1=one, bodyname2=other)
  return sorted(pairs)


def attitude(spec: mujoco.MjSpec) -> Attitude:
  """Return the attitude of the root in the first keyframe, or that of the model."""
  model = spec.copy().compile()
  data = mujoco.MjData(model)
  if model.nkey:
    mujoco.mj_resetDataKeyframe(model, data, 0)
  if not model.njnt or model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
    return (1.0, 0.0, 0.0, 0.0)
  w, x, y, z = data.qpos[3:7]
  return (float(w), float(x), float(y), float(z))


def _on_the_ground(model: mujoco.MjModel, data: mujoco.MjData, start: np.ndarray) -> np.ndarray:
  """Return a configuration with the robot's lowest colliding point on the ground."""
  data.qpos[:] = start
  mujoco.mj_kinematics(model, data)
  solid = [i for i in colliding(model) if model.body(model.geom_bodyid[i]).name.startswith("robot/")]
  qpos = start.copy()
  qpos[2] -= min(lowest(model, data, i) for i in solid)
  return qpos


def _simulate(
  model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray, ctrl: np.ndarray, max_drop: float
) -> tuple[np.ndarray, bool, tuple[str, ...]]:
  """Return the configuration after `SECONDS`, True if the root kept its height and attitude, and what touches."""
  mujoco.mj_resetDataKeyframe(model, data, 0)
  data.qpos[:], data.ctrl[:] = qpos, ctrl
  mujoco.mj_forward(model, data)
  root = _root(model)
  axis, height = data.xmat[root].reshape(3, 3)[2].copy(), data.xpos[root, 2]
  reach = height - min(0.0, float(data.xpos[:, 2].min()))
  for _ in range(round(SECONDS / model.opt.timestep)):
    mujoco.mj_step(model, data)
  if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(data.qpos).all():
    raise MjlabError("the robot diverges on its servos; give other --motors, or a smaller timestep in the file")
  mujoco.mj_forward(model, data)
  cosine = float(axis @ data.xmat[root].reshape(3, 3)[2])
  stays = cosine > np.cos(np.radians(MAX_TILT)) and abs(data.xpos[root, 2] - height) <= max(max_drop * reach, 1e-6)
  names = set()
  for contact in data.contact[: data.ncon]:
    names |= {model.body(model.geom_bodyid[geom]).name for geom in contact.geom}
  touching = tuple(sorted(name.removeprefix("robot/") for name in names if name.startswith("robot/")))
  return data.qpos.copy(), stays, touching


def _root(model: mujoco.MjModel) -> int:
  return next(i for i in range(1, model.nbody) if model.body(i).name.startswith("robot/"))


def _rounded(model: mujoco.MjModel, qpos: np.ndarray, floats: bool) -> np.ndarray:
  """Return a configuration at the origin, turned forward, within limits, in steps of 0.1 mm or 1e-4 rad."""
  qpos = qpos.copy()
  for i in range(model.njnt):
    at = model.jnt_qposadr[i]
    if model.jnt_limited[i] and model.jnt_type[i] != mujoco.mjtJoint.mjJNT_BALL:
      low, high = model.jnt_range[i]
      qpos[at] = np.clip(qpos[at], low, high)
  if floats:
    w, x, y, z = qpos[3:7]
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    level = np.zeros(4)
    mujoco.mju_mulQuat(level, np.array([np.cos(yaw / 2), 0.0, 0.0, -np.sin(yaw / 2)]), qpos[3:7])
    qpos[:2], qpos[3:7] = 0.0, level
  return qpos


def _ctrl(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
  """Return controls that hold the positions of servos; others keep those of the keyframe."""
  ctrl = model.key_ctrl[0].copy()
  for i in range(model.nu):
    joint = model.actuator_trnid[i, 0]
    is_joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
    if is_joint and model.actuator_biasprm[i, 1] != 0.0:
      ctrl[i] = qpos[model.jnt_qposadr[joint]] * model.actuator_gear[i, 0]
  return ctrl
