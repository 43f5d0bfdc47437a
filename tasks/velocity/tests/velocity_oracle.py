"""The velocity tasks by plain NumPy and MuJoCo C, world by world, written from the formulas of their specification."""

import copy
import math
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from mjlab_envs import ManagerBasedRlEnv
from velocity_facts import Robot

SUBSTEP, SUBSTEPS, STEP = 0.005, 4, 0.02
RANDOMIZED = ("geom_friction", "body_ipos")
"""Fields of MjModel that the tasks' events write."""
GROUND = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
"""Geom groups that rays see."""
DOWN = np.array([0.0, 0.0, -1.0])


def world_model(env: ManagerBasedRlEnv, world: int) -> mujoco.MjModel:
  """The compiled model with the randomised fields of one world; MuJoCo C recomputes its constants."""
  model = copy.copy(env.sim.mj_model)
  for name in RANDOMIZED:
    getattr(model, name)[:] = getattr(env.sim.model, name)[world].double().numpy()
  mujoco.mj_setConst(model, mujoco.MjData(model))
  return model


@dataclass
class Contacts:
  """Contacts of one substep of one world."""

  found: np.ndarray
  """Which feet touch the ground, (feet,)."""
  force: np.ndarray
  """That each foot exerts on it, world frame, (feet, 3) [N]."""
  strongest: dict[str, np.ndarray] = field(default_factory=dict)
  """By sensor, the strongest contact of each of its primaries [N]."""


class World:
  """One world in MuJoCo C."""

  def __init__(self, env: ManagerBasedRlEnv, world: int, robot: Robot) -> None:
    self.index = world
    self.robot = robot
    self.model = world_model(env, world)
    self.data = mujoco.MjData(self.model)
    self._hit = np.zeros(1, dtype=np.int32)
    self.bias = env.scene["robot"].data.encoder_bias[world].double().numpy()
    model = self.model
    self._feet = [[model.geom(f"robot/{name}").id for name in names] for names in robot.foot_geoms]
    self._touch = {name: [model.geom(f"robot/{g}").id for g in geoms] for name, geoms in robot.touch.items()}
    self._sites = [model.site(f"robot/{foot}").id for foot in robot.feet]
    self._imu = model.site(f"robot/{robot.imu}").id
    self._root = model.body(f"robot/{robot.root}").id
    self._torso = model.body(f"robot/{robot.torso}").id
    bodies = [model.body(model.geom_bodyid[g]).name for g in range(model.ngeom)]
    self._ground = {g for g, body in enumerate(bodies) if body == "terrain"}
    self._robot = {g for g, body in enumerate(bodies) if body.startswith("robot/")}
    self._flat = all(model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE for g in self._ground)
    ranges = np.array([model.joint(f"robot/{name}").range for name in robot.joints])
    self._middle, self._half = ranges.mean(1), 0.9 * (ranges[:, 1] - ranges[:, 0]) / 2.0

  def control(self, action: np.ndarray) -> np.ndarray:
    """Servo targets in the order of the actuators: default + scale * action - encoder bias."""
    target = self.robot.default + self.robot.action_scale * action - self.bias
    joints = [self.model.joint(int(j)).name.removeprefix("robot/") for j in self.model.actuator_trnid[:, 0]]
    return target[[self.robot.joints.index(name) for name in joints]]

  def simulate(self, qpos: Any, qvel: Any, warmstart: Any, action: np.ndarray) -> list[Contacts]:
    """One environment step of MuJoCo C, and the contacts of each of its substeps."""
    data = self.data
    data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = qpos, qvel, warmstart
    data.ctrl[:] = self.control(action)
    contacts = []
    for _ in range(SUBSTEPS):
      mujoco.mj_step(self.model, data)
      contacts.append(self._contacts())
    return contacts

  def _contacts(self) -> Contacts:
    feet = len(self._feet)
    seen = Contacts(np.zeros(feet, dtype=bool), np.zeros((feet, 3)), {"self_collision": np.zeros(1)})
    seen.strongest |= {name: np.zeros(len(geoms)) for name, geoms in self._touch.items()}
    local = np.zeros(6)
    frames = self.data.contact.frame.reshape(-1, 3, 3)
    for index, pair in enumerate(self.data.contact.geom.tolist()):
      mujoco.mj_contactForce(self.model, self.data, index, local)
      strength = math.hypot(*local[:3])
      if self._robot.issuperset(pair):
        seen.strongest["self_collision"] = np.maximum(seen.strongest["self_collision"], strength)
      if self._ground.isdisjoint(pair):
        continue
      for name, geoms in self._touch.items():
        for place, geom in enumerate(geoms):
          if geom in pair:
            seen.strongest[name][place] = max(seen.strongest[name][place], strength)
      for foot, geoms in enumerate(self._feet):
        if not set(geoms).isdisjoint(pair):
          seen.found[foot] = True
          # MuJoCo's contact force acts from the first geom on the second.
          push = frames[index].T @ local[:3]
          seen.force[foot] += push if pair[0] in geoms else -push
    return seen

  def look(self, qpos: Any, qvel: Any) -> None:
    """Take over a state and derive what follows from it."""
    self.data.qpos[:], self.data.qvel[:] = qpos, qvel
    mujoco.mj_forward(self.model, self.data)
    mujoco.mj_subtreeVel(self.model, self.data)

  def touches_ground(self) -> bool:
    """Whether anything touches the ground."""
    return any(contact.geom1 in self._ground or contact.geom2 in self._ground for contact in self.data.contact)

  def _axes(self, body: int) -> np.ndarray:
    return self.data.xmat[body].reshape(3, 3)

  @property
  def rotation(self) -> np.ndarray:
    """Columns are the root's axes in the world."""
    return self._axes(self._root)

  @property
  def tilt(self) -> float:
    """Angle between the root's z axis and the vertical [rad]."""
    return math.acos(np.clip(self.rotation[2, 2], -1.0, 1.0))

  @property
  def root_lin_vel(self) -> np.ndarray:
    """Of the root's origin, root frame [m/s]. MuJoCo's free joint keeps it in the world frame."""
    return self.rotation.T @ self.data.qvel[:3]

  @property
  def root_ang_vel(self) -> np.ndarray:
    """Root frame [rad/s], as MuJoCo's free joint keeps it."""
    return self.data.qvel[3:6]

  @property
  def gravity(self) -> np.ndarray:
    """Its direction in the root frame."""
    return self.rotation.T @ np.array([0.0, 0.0, -1.0])

  def ray_down(self, point: Any, reach: float, lift: float) -> float:
    """Height of the ground [m] that a ray downwards sees from `lift` above a point to `reach` below it; or NaN."""
    start = np.array([point[0], point[1], point[2] + lift])
    distance = mujoco.mj_ray(self.model, self.data, start, DOWN, GROUND, 1, self._root, self._hit)
    return start[2] - distance if 0.0 <= distance <= lift + reach else math.nan

  @property
  def heights(self) -> np.ndarray:
    """Of the feet's sites above the highest ground under their rays, as far as rays of 1 m can see."""
    points = self.data.site_xpos[self._sites]
    if self._flat:
      return np.clip(points[:, 2], 0.0, 1.0)
    radius, count = self.robot.ring
    heights = []
    for site, point in zip(self._sites, points, strict=True):
      yaw = facing(self.data.site_xmat[site].reshape(3, 3))
      angles = yaw + 2.0 * math.pi * np.arange(count) / count
      ring = [point] + [point + radius * np.array([math.cos(a), math.sin(a), 0.0]) for a in angles]
      ground = [self.ray_down(p, 1.0, 0.1) for p in ring]
      heights.append(min([1.0] + [max(point[2] - z, 0.0) for z in ground if not math.isnan(z)]))
    return np.array(heights)

  def scan(self, rays: range = range(187)) -> np.ndarray:
    """Ground under the points of the height scan, world frame, x first, (rays, 3) [m]; NaN where a ray sees none."""
    origin, yaw = self.data.xpos[self._root], facing(self.rotation)
    c, s = math.cos(yaw), math.sin(yaw)
    points = []
    for ray in rays:
      x, y = 0.1 * (ray % 17) - 0.8, 0.1 * (ray // 17) - 0.5
      point = origin[0] + c * x - s * y, origin[1] + s * x + c * y, origin[2]
      points.append([*point[:2], self.ray_down(point, 5.0, 1.0)])
    return np.array(points)

  @property
  def lean(self) -> np.ndarray:
    """Up, as far as it is not up in the robot: the ground's normal under a Go1 on rough ground, else the vertical."""
    if self._flat or not self.robot.touch:
      return self._axes(self._torso).T[:2] @ np.array([0.0, 0.0, 1.0])
    return self.rotation.T[:2] @ fitted_normal(self.scan(range(0, 187, 6)))

  @property
  def lowest(self) -> float:
    """Clearance of the lowest of the feet's geoms above z = 0 [m]."""
    lowest = math.inf
    for geom in (geom for geoms in self._feet for geom in geoms):
      size, axes = self.model.geom_size[geom], self.data.geom_xmat[geom].reshape(3, 3)
      reach = size[0] + (
        0.0 if self.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE else size[1] * abs(axes[2, 2])
      )
      lowest = min(lowest, self.data.geom_xpos[geom, 2] - reach)
    return lowest

  @property
  def feet_velocity(self) -> np.ndarray:
    """Horizontal, world frame, (feet, 2)."""
    return np.stack([self._velocity(mujoco.mjtObj.mjOBJ_SITE, site, False)[3:5] for site in self._sites])

  def _velocity(self, kind: mujoco.mjtObj, number: int, local: bool) -> np.ndarray:
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(self.model, self.data, kind, number, velocity, int(local))
    return velocity

  def observe(self, action: np.ndarray, command: np.ndarray, air: np.ndarray, now: Contacts):
    """What the critic sees, by term, and joint positions as the actor sees them before noise."""
    imu = self._velocity(mujoco.mjtObj.mjOBJ_SITE, self._imu, True)
    position = self.data.qpos[7:] - self.robot.default
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
      "foot_contact": now.found.astype(float),
      "foot_contact_forces": (np.sign(now.force) * np.log(1.0 + np.abs(now.force))).ravel(),
    }
    if not self._flat:
      below = self.data.xpos[self._root, 2] - self.scan()[:, 2]
      critic["height_scan"] = np.where(np.isnan(below), 5.0, below) / 5.0
    return critic, position + self.bias

  def rewards(
    self, command: np.ndarray, actions: list[np.ndarray], feet: "Feet", step: list[Contacts]
  ) -> dict[str, float]:
    """Every reward term, unweighted; `step` holds the contacts of its substeps."""
    robot, now = self.robot, step[-1]
    v, w, position = self.root_lin_vel, self.root_ang_vel, self.data.qpos[7:]
    speed = math.hypot(command[0], command[1]) + abs(command[2])
    moves = float(speed > 0.05)
    std = robot.standing if speed < 0.05 else robot.walking if speed < 1.5 else robot.running
    slip = np.linalg.norm(self.feet_velocity, axis=1)
    landed = feet.landed()
    spin = self._velocity(mujoco.mjtObj.mjOBJ_XBODY, self._torso, False)
    rewards = {
      "track_linear_velocity": math.exp(-((v[0] - command[0]) ** 2 + (v[1] - command[1]) ** 2 + v[2] ** 2) / 0.25),
      "track_angular_velocity": math.exp(-((w[2] - command[2]) ** 2 + w[0] ** 2 + w[1] ** 2) / 0.5),
      "upright": math.exp(-np.sum(self.lean**2) / 0.2),
      "pose": math.exp(-np.mean(((position - robot.default) / std) ** 2)),
      "body_ang_vel": spin[0] ** 2 + spin[1] ** 2,
      "angular_momentum": float(np.sum(self.data.subtree_angmom[self._root] ** 2)),
      "dof_pos_limits": float(np.maximum(np.abs(position - self._middle) - self._half, 0.0).sum()),
      "action_rate_l2": float(np.sum((actions[-1] - actions[-2]) ** 2)),
      "air_time": np.sum((feet.air_time > 0.05 + 1e-9) & (feet.air_time < 0.5 - 1e-9)) * float(speed > 0.5),
      "foot_clearance": float(np.sum(np.abs(self.heights - 0.1) * slip)) * moves,
      "foot_swing_height": float(np.sum((feet.peaks / 0.1 - 1.0) ** 2 * landed)) * moves,
      "foot_slip": float(np.sum(slip**2 * now.found)) * moves,
      "soft_landing": float(np.sum(np.linalg.norm(now.force, axis=1) * landed)) * moves,
    }
    counted = {
      "self_collisions": "self_collision",
      "shank_collision": "shank_ground_touch",
      "trunk_head_collision": "trunk_ground_touch",
    }
    for name, sensor in counted.items():
      if sensor in now.strongest:
        rewards[name] = float(sum((contacts.strongest[sensor] > 10.0).any() for contacts in step))
    return rewards


def matrix(quat: np.ndarray) -> np.ndarray:
  mujoco.mju_quat2Mat(out := np.empty(9), quat)
  return out.reshape(3, 3)


def facing(axes: np.ndarray) -> float:
  """Heading of a frame with these axes as columns [rad]: of x, or where that is near vertical, of y less 90 degrees."""
  if np.hypot(axes[0, 0], axes[1, 0]) > 0.1:
    return math.atan2(axes[1, 0], axes[0, 0])
  return math.atan2(-axes[0, 1], axes[1, 1])


def fitted_normal(points: np.ndarray) -> np.ndarray:
  """Upward unit normal of the plane z = a x + b y + c through points (n, 3), NaN ones left out; vertical if there is
  none."""
  points = points[~np.isnan(points).any(1)]
  if len(points) < 3 or np.linalg.matrix_rank(points[:, :2] - points[:, :2].mean(0), tol=1e-6) < 2:
    return np.array([0.0, 0.0, 1.0])
  (a, b, _), *_ = np.linalg.lstsq(np.column_stack([points[:, :2], np.ones(len(points))]), points[:, 2], rcond=None)
  return np.array([-a, -b, 1.0]) / math.sqrt(a * a + b * b + 1.0)


class Feet:
  """What the feet of one world did since the episode began: contact by substep, heights by step."""

  def __init__(self, count: int) -> None:
    self.count = count
    self.contacts: list[np.ndarray] = []
    self.heights: list[np.ndarray] = []
    self.phases: list[list[tuple[bool, int]]] = [[] for _ in range(count)]
    """Contact and length in substeps of each phase of each foot."""

  def step(self, contacts: list[np.ndarray], heights: np.ndarray) -> None:
    self.contacts += contacts
    self.heights.append(heights)
    for contact in contacts:
      for phases, found in zip(self.phases, contact.tolist(), strict=True):
        if phases and phases[-1][0] == found:
          phases[-1] = (found, phases[-1][1] + 1)
        else:
          phases.append((found, 1))

  @property
  def air_time(self) -> np.ndarray:
    last = [phases[-1] if phases else (True, 0) for phases in self.phases]
    return np.array([0.0 if found else length * SUBSTEP for found, length in last])

  def landed(self) -> np.ndarray:
    """Feet whose flight ended within this step; the drop at the start of an episode does not count."""
    landed = []
    for phases in self.phases:
      stands, lasted = phases[-1]
      flew = len(phases) >= 3
      landed.append(stands and lasted <= SUBSTEPS and flew)
    return np.array(landed)

  @property
  def peaks(self) -> np.ndarray:
    """Greatest height of each foot in the steps since the one that it last ended on the ground."""
    peaks = []
    for foot in range(self.count):
      height = self.heights[-1][foot]
      for step in range(len(self.heights) - 2, -1, -1):
        if self.contacts[SUBSTEPS * step + SUBSTEPS - 1][foot]:
          break
        height = max(height, self.heights[step][foot])
      peaks.append(height)
    return np.array(peaks)
