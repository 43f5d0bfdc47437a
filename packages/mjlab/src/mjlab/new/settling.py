"""Home pose of a robot: put on the ground, settled under gravity on its servos, and tried for two seconds."""

from dataclasses import dataclass

import mujoco
import numpy as np
from mjlab_actuators import ActuatorCfg
from mjlab_core import MjlabError
from mjlab_scene import EntityArticulationCfg, EntityCfg, InitialStateCfg, Scene, SceneCfg
from mjlab_terrain import PlaneCfg

from mjlab.new.limbs import heights, posed, within_limits
from mjlab.new.model_file import RobotModel

SECONDS = 2.0
MAX_TILT = 20.0  # degrees
MAX_DROP = 0.12  # share of the height


@dataclass(kw_only=True)
class Home:
  """Pose that a robot rests in."""

  qpos: np.ndarray
  """Configuration."""
  stands: bool
  """True if the robot stays there for `SECONDS`, its servos holding the pose."""
  end: np.ndarray
  """Configuration after `SECONDS`."""
  model: mujoco.MjModel
  """Robot on a plane; its names begin with "robot/"."""


def settle(spec: mujoco.MjSpec, actuators: tuple[ActuatorCfg, ...], qpos: np.ndarray) -> Home:
  """Return the pose into which a robot settles from `qpos`; that pose on the ground if it falls over.

  Args:
    spec: The robot without actuators that `actuators` replace, and without keyframes.
    actuators: Its servos.
    qpos: Configuration.

  Raises:
    MjlabError: The robot diverges.
  """
  start = _trial(spec, actuators, qpos, 2.0 * MAX_DROP)
  if start.stands:
    home = _trial(spec, actuators, _facing_forward(start.model, start.end), MAX_DROP)
    if home.stands:
      return home
  start.stands = False
  return start


def exclude_overlaps(robot: RobotModel, qpos: np.ndarray) -> list[tuple[str, str]]:
  """Exclude contacts between bodies of the robot that overlap in a configuration; return the pairs."""
  model, data = posed(robot, qpos)
  touching = data.contact.geom[data.contact.dist < 0.0]
  bodies = np.unique(np.sort(model.geom_bodyid[touching], axis=1), axis=0)
  # Body 0 has the ground.
  pairs = [(model.body(one).name, model.body(other).name) for one, other in bodies if one > 0]
  for number, (one, other) in enumerate(pairs):
    robot.spec.add_exclude(name=f"overlap_{number}", bodyname1=one, bodyname2=other)
  return pairs


def _trial(spec: mujoco.MjSpec, actuators: tuple[ActuatorCfg, ...], qpos: np.ndarray, max_drop: float) -> Home:
  """Try a configuration on the ground for `SECONDS`."""
  keyed = spec.copy()
  keyed.add_key(name="home", qpos=qpos)
  entity = EntityCfg(
    spec_fn=lambda: keyed,
    init_state=InitialStateCfg(joint_pos=None),
    articulation=EntityArticulationCfg(actuators=actuators),
  )
  model = Scene(SceneCfg(num_envs=1, terrain=PlaneCfg(), entities={"robot": entity})).spec.compile()
  data = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, data, 0)
  mujoco.mj_forward(model, data)
  if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
    data.qpos[2] -= min(heights(model, data).values())
    mujoco.mj_forward(model, data)
  start = data.qpos.copy()
  root = model.body(f"robot/{spec.worldbody.bodies[0].name}").id
  axis, height = data.xmat[root].reshape(3, 3)[2].copy(), data.xpos[root, 2]
  reach = height - min(0.0, float(data.xpos[:, 2].min()))
  mujoco.mj_step(model, data, nstep=round(SECONDS / model.opt.timestep))
  if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(data.qpos).all():
    raise MjlabError("the robot diverges on its servos; give other --motors, or a smaller timestep in the file")
  mujoco.mj_forward(model, data)
  cosine, drop = float(axis @ data.xmat[root].reshape(3, 3)[2]), abs(data.xpos[root, 2] - height)
  stands = cosine > np.cos(np.radians(MAX_TILT)) and drop <= max(max_drop * reach, 1e-6)
  return Home(qpos=start, stands=bool(stands), end=data.qpos.copy(), model=model)


def _facing_forward(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
  """Return a configuration within limits and, of a floating base, at the origin and turned forward."""
  qpos = within_limits(model, qpos)
  if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
    # Rotations about the vertical have only these two parts.
    backward = qpos[3:7] * (1.0, 0.0, 0.0, -1.0)
    mujoco.mju_normalize4(backward)
    mujoco.mju_mulQuat(qpos[3:7], backward, qpos[3:7].copy())
    qpos[:2] = 0.0
  return qpos
