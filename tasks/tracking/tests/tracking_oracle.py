"""The tracking task by plain NumPy and MuJoCo C, world by world, written from the formulas of its specification."""

import copy
import math
from pathlib import Path

import mujoco
import numpy as np
from mjlab_envs import ManagerBasedRlEnv
from mjlab_motions.motion_file import load_motion

BODIES = (
  "pelvis",
  *(f"left_{name}_link" for name in ("hip_roll", "knee", "ankle_roll")),
  *(f"right_{name}_link" for name in ("hip_roll", "knee", "ankle_roll")),
  "torso_link",
  *(f"left_{name}_link" for name in ("shoulder_roll", "elbow", "wrist_yaw")),
  *(f"right_{name}_link" for name in ("shoulder_roll", "elbow", "wrist_yaw")),
)
TORSO = BODIES.index("torso_link")
ENDS = tuple(i for i, name in enumerate(BODIES) if "ankle_roll" in name or "wrist_yaw" in name)
STEP, SUBSTEPS = 0.02, 4
RANDOMIZED = ("geom_friction", "body_ipos")
"""Fields of MjModel that the task's events write."""


class Bodies:
  """Poses and velocities of the 14 bodies at their origins, world frame."""

  def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    ids = [model.body(f"robot/{name}").id for name in BODIES]
    self.pos = data.xpos[ids].copy()
    self.rotation = data.xmat[ids].reshape(-1, 3, 3).copy()
    velocity = np.zeros((len(ids), 6))
    for row, body in zip(velocity, ids, strict=True):
      mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, row, 0)
    self.spin, self.speed = velocity[:, :3], velocity[:, 3:]


class Reference:
  """A clip frame by frame, its velocities by central differences of MuJoCo's own, its bodies by MuJoCo C."""

  def __init__(self, path: Path, model: mujoco.MjModel) -> None:
    clip, data = load_motion(path), mujoco.MjData(model)
    assert clip.rate == 1.0 / STEP
    names = [model.joint(j).name.removeprefix("robot/") for j in range(1, model.njnt)]
    joints = clip.joint_pos.numpy()[:, [clip.joint_names.index(name) for name in names]]
    self.qpos = np.concatenate((clip.root_pos.numpy(), clip.root_quat.numpy(), joints), 1)
    self.qvel = np.zeros((len(self.qpos), model.nv))
    self.bodies: list[Bodies] = []
    for k, qpos in enumerate(self.qpos):
      before, after = max(k - 1, 0), min(k + 1, len(self.qpos) - 1)
      mujoco.mj_differentiatePos(model, self.qvel[k], (after - before) * STEP, self.qpos[before], self.qpos[after])
      # The change of orientation is along the axes of the frame before, the joint's velocity along those of this one.
      self.qvel[k, 3:6] = matrix(qpos[3:7]).T @ matrix(self.qpos[before, 3:7]) @ self.qvel[k, 3:6]
      data.qpos[:], data.qvel[:] = qpos, self.qvel[k]
      mujoco.mj_forward(model, data)
      self.bodies.append(Bodies(model, data))


class World:
  """One world in MuJoCo C."""

  def __init__(self, env: ManagerBasedRlEnv, world: int, scale: np.ndarray) -> None:
    self.model = copy.copy(env.sim.mj_model)
    for name in RANDOMIZED:
      getattr(self.model, name)[:] = getattr(env.sim.model, name)[world].double().numpy()
    mujoco.mj_setConst(self.model, mujoco.MjData(self.model))
    self.data = mujoco.MjData(self.model)
    self.origin = env.scene.env_origins[world].double().numpy()
    self.bias = env.scene["robot"].data.encoder_bias[world].double().numpy()
    self.default = env.scene["robot"].data.default_joint_pos[0].double().numpy()
    self._scale = scale
    self._imu = self.model.site("robot/imu_in_pelvis").id
    ranges = self.model.jnt_range[1:]
    self._middle, self._half = ranges.mean(1), 0.9 * (ranges[:, 1] - ranges[:, 0]) / 2.0
    bodies = [self.model.body(body).name for body in self.model.geom_bodyid]
    self._robot = {geom for geom, body in enumerate(bodies) if body.startswith("robot/")}

  def simulate(self, qpos: np.ndarray, qvel: np.ndarray, warmstart: np.ndarray, action: np.ndarray) -> int:
    """One environment step; in how many of its substeps the robot touches itself with more than 10 N."""
    data = self.data
    data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = qpos, qvel, warmstart
    data.ctrl[:] = (self.default + self._scale * action - self.bias)[self.model.actuator_trnid[:, 0] - 1]
    count, force = 0, np.zeros(6)
    for _ in range(SUBSTEPS):
      mujoco.mj_step(self.model, data)
      strongest = 0.0
      for index, pair in enumerate(data.contact.geom.tolist()):
        if self._robot.issuperset(pair):
          mujoco.mj_contactForce(self.model, data, index, force)
          strongest = max(strongest, float(np.linalg.norm(force[:3])))
      count += strongest > 10.0
    return count

  def look(self, qpos: np.ndarray, qvel: np.ndarray) -> Bodies:
    """Take over a state and derive what follows from it."""
    self.data.qpos[:], self.data.qvel[:] = qpos, qvel
    mujoco.mj_forward(self.model, self.data)
    return Bodies(self.model, self.data)

  def rewards(self, robot: Bodies, wanted: Bodies, actions: list[np.ndarray], collisions: int) -> dict[str, float]:
    """Every reward term, unweighted, in the state looked at."""
    place, turn = self._laid_over(robot, wanted)
    q = self.data.qpos[7:]
    away = wanted.pos[TORSO] + self.origin - robot.pos[TORSO]
    return {
      "motion_global_root_pos": math.exp(-np.sum(away**2) / 0.3**2),
      "motion_global_root_ori": math.exp(-(angle(wanted.rotation[TORSO], robot.rotation[TORSO]) ** 2) / 0.4**2),
      "motion_body_pos": math.exp(-np.mean(np.sum((place - robot.pos) ** 2, 1)) / 0.3**2),
      "motion_body_ori": math.exp(
        -np.mean([angle(turn @ a, b) ** 2 for a, b in zip(wanted.rotation, robot.rotation, strict=True)]) / 0.4**2
      ),
      "motion_body_lin_vel": math.exp(-np.mean(np.sum((wanted.speed - robot.speed) ** 2, 1)) / 1.0**2),
      "motion_body_ang_vel": math.exp(-np.mean(np.sum((wanted.spin - robot.spin) ** 2, 1)) / 3.14**2),
      "action_rate_l2": float(np.sum((actions[-1] - actions[-2]) ** 2)),
      "joint_limit": float(np.maximum(np.abs(q - self._middle) - self._half, 0.0).sum()),
      "self_collisions": float(collisions),
    }

  def failures(self, robot: Bodies, wanted: Bodies) -> dict[str, bool]:
    """Which conditions of failure hold."""
    place, _ = self._laid_over(robot, wanted)
    height = wanted.pos[TORSO, 2] + self.origin[2] - robot.pos[TORSO, 2]
    tilt = wanted.rotation[TORSO][2, 2] - robot.rotation[TORSO][2, 2]
    return {
      "anchor_pos": bool(abs(height) > 0.25),
      "anchor_ori": bool(abs(tilt) > 0.8),
      "ee_body_pos": bool((np.abs(place - robot.pos)[list(ENDS), 2] > 0.25).any()),
    }

  def observe(self, robot: Bodies, wanted: Bodies, command: np.ndarray, action: np.ndarray) -> dict[str, np.ndarray]:
    """What the critic sees, by term, in the state looked at."""
    axes, at = robot.rotation[TORSO].T, robot.pos[TORSO]
    imu = np.zeros(6)
    mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_SITE, self._imu, imu, 1)
    return {
      "command": command,
      "motion_anchor_pos_b": axes @ (wanted.pos[TORSO] + self.origin - at),
      "motion_anchor_ori_b": (axes @ wanted.rotation[TORSO])[:, :2].ravel(),
      "body_pos": ((robot.pos - at) @ axes.T).ravel(),
      "body_ori": (axes @ robot.rotation)[:, :, :2].ravel(),
      "base_lin_vel": imu[3:],
      "base_ang_vel": imu[:3],
      "joint_pos": self.data.qpos[7:] - self.default,
      "joint_vel": self.data.qvel[6:].copy(),
      "actions": action,
    }

  def _laid_over(self, robot: Bodies, wanted: Bodies) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the reference turned and moved on the ground until the torsos meet, and that turn."""
    turn = about_z(robot.rotation[TORSO] @ wanted.rotation[TORSO].T)
    held = np.array([*robot.pos[TORSO, :2], wanted.pos[TORSO, 2] + self.origin[2]])
    return held + (wanted.pos - wanted.pos[TORSO]) @ turn.T, turn


def matrix(quat: np.ndarray) -> np.ndarray:
  mujoco.mju_quat2Mat(out := np.empty(9), quat)
  return out.reshape(3, 3)


def angle(a: np.ndarray, b: np.ndarray) -> float:
  """Between two orientations [rad], also where it is small."""
  turn = a.T @ b
  sine = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
  return math.atan2(float(np.linalg.norm(sine)), (np.trace(turn) - 1.0) / 2.0)


def about_z(rotation: np.ndarray) -> np.ndarray:
  """The heading of a rotation: where it takes the x axis, seen from above."""
  yaw = math.atan2(rotation[1, 0], rotation[0, 0])
  c, s = math.cos(yaw), math.sin(yaw)
  return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
