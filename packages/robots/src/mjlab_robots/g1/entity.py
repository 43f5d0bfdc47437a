"""The G1 as an entity of a scene: pose, servos, contact preset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from mjlab_robots.entity import robot_entity
from mjlab_robots.g1.model import g1_spec
from mjlab_robots.g1.motors import G1_ACTUATORS
from mjlab_robots.meshes import MeshMode

if TYPE_CHECKING:
  from mjlab_scene import CollisionCfg, EntityCfg

CollisionPreset = Literal["full", "full_without_self", "feet_only"]
"""Everything collides and only feet resist sliding; the same, but never with itself; or only feet collide, and only
with the ground."""

G1_DEFAULT_HEIGHT = 0.76
"""Height of the pelvis in the keyframe "knees_bent" [m]; the soles are 3 mm above 0."""

G1_DEFAULT_JOINT_POS: dict[str, float] = {
  ".*_hip_pitch_joint": -0.312,
  ".*_knee_joint": 0.669,
  ".*_ankle_pitch_joint": -0.363,
  ".*_shoulder_pitch_joint": 0.2,
  "left_shoulder_roll_joint": 0.2,
  "right_shoulder_roll_joint": -0.2,
  ".*_elbow_joint": 0.6,
}
"""Standing pose by joint pattern [rad]; joints that are not named stand at 0."""

G1_SOFT_JOINT_POS_LIMIT_FACTOR = 0.9
"""Soft limits are this share of each joint's range, about its middle."""

_FEET = r".*_foot[1-7]_collision"


def g1(*, meshes: MeshMode = "auto", collision: CollisionPreset = "full") -> EntityCfg:
  """A new config of the G1, to be changed at will.

  Args:
    meshes: See `g1_spec`.
    collision: Contact preset; "full" is what the MJCF says.

  Raises:
    ValueError: There is no such preset.
  """
  return robot_entity(
    g1_spec,
    meshes=meshes,
    height=G1_DEFAULT_HEIGHT,
    joint_pos=G1_DEFAULT_JOINT_POS,
    actuators=G1_ACTUATORS,
    soft_joint_pos_limit_factor=G1_SOFT_JOINT_POS_LIMIT_FACTOR,
    collision=collision,
    presets=_presets,
  )


def _presets() -> dict[str, tuple[CollisionCfg, ...]]:
  from mjlab_scene import CollisionCfg

  feet = CollisionCfg(
    geom_names_expr=_FEET, contype=0, conaffinity=1, condim=3, priority=1, friction=(0.6, 0.005, 0.0001)
  )
  rest = CollisionCfg(geom_names_expr=rf"(?!{_FEET}).*_collision", contype=0, conaffinity=1, condim=1)
  return {"full_without_self": (feet, rest), "feet_only": (feet,)}
