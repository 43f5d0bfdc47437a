"""The numbers of both robots and all four tasks, written down from the specification, not read from the code."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_rl import TaskCfg
from mjlab_velocity import g1_flat, g1_rough, go1_flat, go1_rough


@dataclass(frozen=True, kw_only=True)
class Robot:
  """What tasks and oracle must know of a robot."""

  root: str
  torso: str
  imu: str
  feet: tuple[str, ...]
  """Sites of the feet."""
  foot_geoms: tuple[tuple[str, ...], ...]
  """Collision geoms of each foot."""
  touch: dict[str, tuple[str, ...]]
  """Collision geoms whose contact with the ground rough tasks count, by sensor."""
  ring: tuple[float, int]
  """Radius [m] and number of the rays around each foot."""
  joints: tuple[str, ...]
  default: np.ndarray
  action_scale: np.ndarray
  standing: np.ndarray
  walking: np.ndarray
  running: np.ndarray
  start: tuple[float, float]
  """Height of the root above its world's origin at the start of an episode [m]."""
  sole: float
  """Clearance of the feet in the default pose when the root is at `start[0]` above level ground [m]."""
  friction: tuple[float, float]
  """Range of the feet's sliding friction."""
  iterations: int
  experiment: str
  solver: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Task:
  """What the tables say of a task."""

  make: Callable[[], TaskCfg[ManagerBasedRlEnvCfg]]
  robot: Robot
  rough: bool


def _per_joint(joints: tuple[str, ...], values: dict[str, float]) -> np.ndarray:
  """The value whose key a joint's name contains; the one key "" is for all."""
  found = [[value for key, value in values.items() if key in joint] for joint in joints]
  assert all(len(matches) == 1 for matches in found), [j for j, m in zip(joints, found, strict=True) if len(m) != 1]
  return np.array([matches[0] for matches in found])


_LEGS = ("FR", "FL", "RR", "RL")
_GO1_JOINTS = tuple(f"{leg}_{joint}_joint" for leg in _LEGS for joint in ("hip", "thigh", "calf"))
_GO1_MOVING = _per_joint(_GO1_JOINTS, {"hip": 0.3, "thigh": 0.3, "calf": 0.6})

GO1 = Robot(
  root="trunk",
  torso="trunk",
  imu="imu",
  feet=_LEGS,
  foot_geoms=tuple((f"{leg}_foot_collision",) for leg in _LEGS),
  touch={
    "thigh_ground_touch": tuple(f"{leg}_thigh_collision{i}" for leg in _LEGS for i in (1, 2, 3)),
    "shank_ground_touch": tuple(f"{leg}_calf_collision{i}" for leg in _LEGS for i in (1, 2)),
    "trunk_ground_touch": ("trunk_collision", "head_collision"),
  },
  ring=(0.04, 4),
  joints=_GO1_JOINTS,
  default=np.array([x for leg in _LEGS for x in (0.1 if leg[1] == "R" else -0.1, 0.9, -1.8)]),
  action_scale=np.array([0.372753038708, 0.372753038708, 0.248502025806] * 4),
  standing=_per_joint(_GO1_JOINTS, {"hip": 0.05, "thigh": 0.05, "calf": 0.1}),
  walking=_GO1_MOVING,
  running=_GO1_MOVING,
  start=(0.278 + 0.0265, 0.278 + 0.0665),
  sole=0.01,
  friction=(0.3, 1.5),
  iterations=10_000,
  experiment="go1_velocity",
  solver={"cone": "elliptic", "impratio": 10.0, "ccd": 50},
)

_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")
_G1_JOINTS = tuple(
  f"{name}_joint"
  for name in (
    *(f"{side}_{joint}" for side in ("left", "right") for joint in _LEG),
    "waist_yaw",
    "waist_roll",
    "waist_pitch",
    *(f"{side}_{joint}" for side in ("left", "right") for joint in _ARM),
  )
)
_G1_DEFAULT = {
  "hip_pitch": -0.312,
  "knee": 0.669,
  "ankle_pitch": -0.363,
  "shoulder_pitch": 0.2,
  "left_shoulder_roll": 0.2,
  "right_shoulder_roll": -0.2,
  "elbow": 0.6,
}

# Scale of actions, allowed deviation while walking and while running [rad].
_G1_NUMBERS = {
  "hip_pitch": (0.547546462991, 0.3, 0.5),
  "hip_roll": (0.350661466379, 0.15, 0.2),
  "hip_yaw": (0.547546462991, 0.15, 0.2),
  "knee": (0.350661466379, 0.35, 0.6),
  "ankle_pitch": (0.438577313923, 0.25, 0.35),
  "ankle_roll": (0.438577313923, 0.1, 0.15),
  "waist_yaw": (0.547546462991, 0.2, 0.3),
  "waist_roll": (0.438577313923, 0.08, 0.08),
  "waist_pitch": (0.438577313923, 0.1, 0.2),
  "shoulder_pitch": (0.438577313923, 0.15, 0.5),
  "shoulder_roll": (0.438577313923, 0.15, 0.2),
  "shoulder_yaw": (0.438577313923, 0.1, 0.15),
  "elbow": (0.438577313923, 0.15, 0.35),
  "wrist_roll": (0.438577313923, 0.3, 0.3),
  "wrist_pitch": (0.0745008703295, 0.3, 0.3),
  "wrist_yaw": (0.0745008703295, 0.3, 0.3),
}
_G1_SCALE, _G1_WALKING, _G1_RUNNING = (
  _per_joint(_G1_JOINTS, {joint: numbers[i] for joint, numbers in _G1_NUMBERS.items()}) for i in range(3)
)

G1 = Robot(
  root="pelvis",
  torso="torso_link",
  imu="imu_in_pelvis",
  feet=("left_foot", "right_foot"),
  foot_geoms=tuple(tuple(f"{side}_foot{i}_collision" for i in range(1, 8)) for side in ("left", "right")),
  touch={},
  ring=(0.03, 6),
  joints=_G1_JOINTS,
  default=np.array([sum(v for key, v in _G1_DEFAULT.items() if key in joint) for joint in _G1_JOINTS]),
  action_scale=_G1_SCALE,
  standing=_per_joint(_G1_JOINTS, {"": 0.05}),
  walking=_G1_WALKING,
  running=_G1_RUNNING,
  start=(0.76 + 0.01, 0.76 + 0.05),
  sole=0.013,
  friction=(0.3, 1.2),
  iterations=30_000,
  experiment="g1_velocity",
  solver={"cone": "pyramidal", "impratio": 1.0, "ccd": 50},
)

TASKS = {
  "Mjlab-Velocity-Flat-Unitree-Go1": Task(make=go1_flat, robot=GO1, rough=False),
  "Mjlab-Velocity-Flat-Unitree-G1": Task(make=g1_flat, robot=G1, rough=False),
  "Mjlab-Velocity-Rough-Unitree-Go1": Task(make=go1_rough, robot=GO1, rough=True),
  "Mjlab-Velocity-Rough-Unitree-G1": Task(make=g1_rough, robot=G1, rough=True),
}
