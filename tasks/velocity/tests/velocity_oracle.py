"""The flat Go1 task by plain NumPy and MuJoCo C, world by world, written from the formulas of its specification."""

import copy
import math
from typing import Any

import mujoco
import numpy as np
from mjlab_envs import ManagerBasedRlEnv

FEET = ("FR", "FL", "RR", "RL")
JOINTS = tuple(f"{foot}_{joint}_joint" for foot in FEET for joint in ("hip", "thigh", "calf"))
SUBSTEP, SUBSTEPS, STEP = 0.005, 4, 0.02
DEFAULT = np.array([x for foot in FEET for x in (0.1 if foot[1] == "R" else -0.1, 0.9, -1.8)])
LIMITS = np.array([(-0.863, 0.863), (-0.686, 4.501), (-2.818, -0.888)] * 4)
ACTION_SCALE = np.array([0.372753038708, 0.372753038708, 0.248502025806] * 4)
STD_STANDING = np.array([0.05, 0.05, 0.1] * 4)
STD_MOVING = np.array([0.3, 0.3, 0.6] * 4)
RANDOMIZED = ("geom_friction", "body_ipos")
"""Fields of MjModel that the task's events write."""


def world_model(env: ManagerBasedRlEnv, world: int) -> mujoco.MjModel:
  """The model of one world: the compiled one with that world's randomised fields, constants made anew by MuJoCo C."""
  model = copy.copy(env.sim.mj_model)
  for field in RANDOMIZED:
    getattr(model, field)[:] = getattr(env.sim.model, field)[world].double().numpy()
  mujoco.mj_setConst(model, mujoco.MjData(model))
  return model


class World:
  """One world in MuJoCo C."""

  def __init__(self, env: ManagerBasedRlEnv, world: int) -> None:
    self.index = world
    self.model = world_model(env, world)
    self.data = mujoco.MjData(self.model)
    self.bias = env.scene["robot"].data.encoder_bias[world].double().numpy()
    self._feet = [self.model.geom(f"robot/{foot}_foot_collision").id for foot in FEET]
    self._sites = [self.model.site(f"robot/{foot}").id for foot in FEET]
    self._imu = self.model.site("robot/imu").id
    self._trunk = self.model.body("robot/trunk").id
    self._ground = [g for g in range(self.model.ngeom) if self.model.body(self.model.geom_bodyid[g]).name == "terrain"]

  def control(self, action: np.ndarray) -> np.ndarray:
    """Servo set-points in the order of the actuators: default + scale * action - encoder bias."""
    target = DEFAULT + ACTION_SCALE * action - self.bias
    joints = [self.model.joint(int(j)).name.removeprefix("robot/") for j in self.model.actuator_trnid[:, 0]]
    return target[[JOINTS.index(name) for name in joints]]

  def simulate(self, qpos: Any, qvel: Any, warmstart: Any, action: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """One environment step of MuJoCo C; contact (4,) and ground force (4, 3) of the feet for each substep."""
    data = self.data
    data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = qpos, qvel, warmstart
    data.ctrl[:] = self.control(action)
    contacts = []
    for _ in range(SUBSTEPS):
      mujoco.mj_step(self.model, data)
      contacts.append(self._contacts())
    return contacts

  def _contacts(self) -> tuple[np.ndarray, np.ndarray]:
    """Which feet touch the ground, and the force that each exerts on it, world frame."""
    found, force = np.zeros(4, dtype=bool), np.zeros((4, 3))
    local = np.zeros(6)
    for index, contact in enumerate(self.data.contact):
      pair = (contact.geom1, contact.geom2)
      for foot, geom in enumerate(self._feet):
        other = pair[1] if pair[0] == geom else pair[0]
        if geom in pair and other in self._ground:
          found[foot] = True
          mujoco.mj_contactForce(self.model, self.data, index, local)
          # MuJoCo's contact force acts from the first geom on the second.
          push = contact.frame.reshape(3, 3).T @ local[:3]
          force[foot] += push if pair[0] == geom else -push
    return found, force

  def look(self, qpos: Any, qvel: Any) -> None:
    """Take over a state and derive what follows from it."""
    self.data.qpos[:], self.data.qvel[:] = qpos, qvel
    mujoco.mj_forward(self.model, self.data)
    mujoco.mj_subtreeVel(self.model, self.data)

  def touches_ground(self) -> bool:
    """Whether anything touches the ground."""
    return any(contact.geom1 in self._ground or contact.geom2 in self._ground for contact in self.data.contact)

  @property
  def rotation(self) -> np.ndarray:
    """Columns are the trunk's axes in the world."""
    return self.data.xmat[self._trunk].reshape(3, 3)

  @property
  def yaw(self) -> float:
    """Heading of the trunk's x axis [rad]."""
    return math.atan2(self.rotation[1, 0], self.rotation[0, 0])

  @property
  def tilt(self) -> float:
    """Angle between the trunk's z axis and the vertical [rad]."""
    return math.acos(np.clip(self.rotation[2, 2], -1.0, 1.0))

  @property
  def root_lin_vel(self) -> np.ndarray:
    """Of the trunk's origin, trunk frame [m/s]. MuJoCo's free joint keeps it in the world frame."""
    return self.rotation.T @ self.data.qvel[:3]

  @property
  def root_ang_vel(self) -> np.ndarray:
    """Trunk frame [rad/s], as MuJoCo's free joint keeps it."""
    return self.data.qvel[3:6]

  @property
  def gravity(self) -> np.ndarray:
    return self.rotation.T @ np.array([0.0, 0.0, -1.0])

  @property
  def heights(self) -> np.ndarray:
    """Of the feet's centres above the plane z = 0, as far as rays of 1 m can see."""
    return np.clip(self.data.site_xpos[self._sites, 2], 0.0, 1.0)

  @property
  def lowest(self) -> float:
    """Clearance of the lowest foot's sphere, radius 23 mm."""
    return float(self.data.site_xpos[self._sites, 2].min()) - 0.023

  @property
  def feet_velocity(self) -> np.ndarray:
    """Horizontal, world frame, (4, 2)."""
    return np.stack([self._site_velocity(site, False)[3:5] for site in self._sites])

  def _site_velocity(self, site: int, local: bool) -> np.ndarray:
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, int(local))
    return velocity

  def observe(self, action: np.ndarray, command: np.ndarray, air: np.ndarray, found: np.ndarray, force: np.ndarray):
    """What the critic sees, by term, and joint positions as the actor sees them before noise."""
    imu = self._site_velocity(self._imu, True)
    position = self.data.qpos[7:] - DEFAULT
    critic = {
      "base_lin_vel": imu[3:],
      "base_ang_vel": imu[:3],
      "projected_gravity": self.gravity,
      "joint_pos": position,
      "joint_vel": self.data.qvel[6:].copy(),
      "actions": action,
      "command": command,
      "foot_height": self.heights,
      "foot_air_time": air,
      "foot_contact": found.astype(float),
      "foot_contact_forces": (np.sign(force) * np.log(1.0 + np.abs(force))).ravel(),
    }
    return critic, position + self.bias

  def rewards(
    self, command: np.ndarray, actions: list[np.ndarray], feet: "Feet", found: np.ndarray, force: np.ndarray
  ) -> dict[str, float]:
    """Every reward term, unweighted."""
    v, w, position = self.root_lin_vel, self.root_ang_vel, self.data.qpos[7:]
    speed = math.hypot(command[0], command[1]) + abs(command[2])
    moves = float(speed > 0.05)
    std = STD_STANDING if speed < 0.05 else STD_MOVING
    middle, half = LIMITS.mean(1), 0.9 * (LIMITS[:, 1] - LIMITS[:, 0]) / 2.0
    slip = np.linalg.norm(self.feet_velocity, axis=1)
    landed = feet.landed()
    spin = self.rotation @ w
    return {
      "track_linear_velocity": math.exp(-((v[0] - command[0]) ** 2 + (v[1] - command[1]) ** 2 + v[2] ** 2) / 0.25),
      "track_angular_velocity": math.exp(-((w[2] - command[2]) ** 2 + w[0] ** 2 + w[1] ** 2) / 0.5),
      "upright": math.exp(-(self.gravity[0] ** 2 + self.gravity[1] ** 2) / 0.2),
      "pose": math.exp(-np.mean(((position - DEFAULT) / std) ** 2)),
      "body_ang_vel": spin[0] ** 2 + spin[1] ** 2,
      "angular_momentum": float(np.sum(self.data.subtree_angmom[self._trunk] ** 2)),
      "dof_pos_limits": float(np.maximum(np.abs(position - middle) - half, 0.0).sum()),
      "action_rate_l2": float(np.sum((actions[-1] - actions[-2]) ** 2)),
      "air_time": np.sum((feet.air_time > 0.05 + 1e-9) & (feet.air_time < 0.5 - 1e-9)) * float(speed > 0.5),
      "foot_clearance": float(np.sum(np.abs(self.heights - 0.1) * slip)) * moves,
      "foot_swing_height": float(np.sum((feet.peaks / 0.1 - 1.0) ** 2 * landed)) * moves,
      "foot_slip": float(np.sum(slip**2 * found)) * moves,
      "soft_landing": float(np.sum(np.linalg.norm(force, axis=1) * landed)) * moves,
    }


class Feet:
  """What the feet of one world did since the episode began: contact by substep, heights by step."""

  def __init__(self) -> None:
    self.contacts: list[np.ndarray] = []
    self.heights: list[np.ndarray] = []

  def step(self, contacts: list[np.ndarray], heights: np.ndarray) -> None:
    self.contacts += contacts
    self.heights.append(heights)

  def phases(self, foot: int) -> list[tuple[bool, int]]:
    """Contact and length in substeps of each phase of a foot."""
    phases: list[tuple[bool, int]] = []
    for found in (bool(contact[foot]) for contact in self.contacts):
      if phases and phases[-1][0] == found:
        phases[-1] = (found, phases[-1][1] + 1)
      else:
        phases.append((found, 1))
    return phases

  @property
  def air_time(self) -> np.ndarray:
    last = [self.phases(foot)[-1] if self.contacts else (True, 0) for foot in range(4)]
    return np.array([0.0 if found else length * SUBSTEP for found, length in last])

  def landed(self) -> np.ndarray:
    """Feet whose flight ended within this step; the drop at the start of an episode is none."""
    landed = []
    for foot in range(4):
      phases = self.phases(foot)
      stands, lasted = phases[-1]
      flew = len(phases) >= 3
      landed.append(stands and lasted <= SUBSTEPS and flew)
    return np.array(landed)

  @property
  def peaks(self) -> np.ndarray:
    """Greatest height of each foot in the steps since the one that it last ended on the ground."""
    peaks = []
    for foot in range(4):
      height = self.heights[-1][foot]
      for step in range(len(self.heights) - 2, -1, -1):
        if self.contacts[SUBSTEPS * step + SUBSTEPS - 1][foot]:
          break
        height = max(height, self.heights[step][foot])
      peaks.append(height)
    return np.array(peaks)
