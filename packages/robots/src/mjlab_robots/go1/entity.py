"""The Go1 as an entity of a scene: pose, servos, contact preset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from mjlab_robots.entity import robot_entity
from mjlab_robots.go1.model import go1_spec
from mjlab_robots.go1.motors import GO1_ACTUATORS
from mjlab_robots.meshes import MeshMode

if TYPE_CHECKING:
  from mjlab_scene import CollisionCfg, EntityCfg

CollisionPreset = Literal["full", "feet_only"]
"""Everything collides and only feet resist sliding; or only feet collide, and only with the ground."""

GO1_DEFAULT_HEIGHT = 0.278
"""Height of the trunk in the keyframe "stand" [m]; the feet reach 16.5 mm below 0, so a reset must lift the robot."""

GO1_DEFAULT_JOINT_POS: dict[str, float] = {
  ".*R_hip_joint": 0.1,
  ".*L_hip_joint": -0.1,
  ".*_thigh_joint": 0.9,
  ".*_calf_joint": -1.8,
}
"""Standing pose by joint pattern [rad]."""

GO1_SOFT_JOINT_POS_LIMIT_FACTOR = 0.9
"""Soft limits are this share of each joint's range, about its middle."""


def go1(*, meshes: MeshMode = "auto", collision: CollisionPreset = "full") -> EntityCfg:
  """A new config of the Go1, to be changed at will.

  Args:
    meshes: See `go1_spec`.
    collision: Contact preset; "full" is what the MJCF says.

  Raises:
    ValueError: There is no such preset.
  """
  return robot_entity(
    go1_spec,
    meshes=meshes,
    height=GO1_DEFAULT_HEIGHT,
    joint_pos=GO1_DEFAULT_JOINT_POS,
    actuators=GO1_ACTUATORS,
    soft_joint_pos_limit_factor=GO1_SOFT_JOINT_POS_LIMIT_FACTOR,
    collision=collision,
    presets=_presets,
  )


def _presets() -> dict[str, tuple[CollisionCfg, ...]]:
  from mjlab_scene import CollisionCfg

  feet = CollisionCfg(
    geom_names_expr=(".*_foot_collision",),
    contype=0,
    conaffinity=1,
    condim=3,
    priority=1,
    friction=(0.6, 0.005, 0.0001),
    solref=(0.02, 1.0),
    # A foot sinks over its own radius before it is as stiff as it gets.
    solimp=(0.9, 0.95, 0.023, 0.5, 2.0),
    disable_other_geoms=True,
  )
  return {"feet_only": (feet,)}
