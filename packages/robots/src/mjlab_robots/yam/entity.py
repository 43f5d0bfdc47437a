"""The YAM as an entity of a scene: pose, servos, contact preset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from mjlab_robots.entity import robot_entity
from mjlab_robots.meshes import MeshMode
from mjlab_robots.yam.model import yam_spec
from mjlab_robots.yam.motors import YAM_ACTUATORS

if TYPE_CHECKING:
  from mjlab_scene import CollisionCfg, EntityCfg

CollisionPreset = Literal["full", "gripper_only"]
"""Everything collides, with itself too; or only the hand and the fingers do."""

YAM_DEFAULT_HEIGHT = 0.01
"""Height of the foot of the base [m]."""

YAM_DEFAULT_JOINT_POS: dict[str, float] = {
  "joint2": 1.047,
  "joint3": 1.05,
  "joint4": -0.9,
  "left_finger": 0.01875,
  "right_finger": -0.01875,
}
"""The pose "home", gripper half open, by joint pattern [rad, m]; joints that are not named stand at 0."""

YAM_SOFT_JOINT_POS_LIMIT_FACTOR = 0.9
"""Soft limits are this share of each joint's range, about its middle."""

_TIPS = "[lr]f_down([6-9]|10|11)_collision"


def yam(*, meshes: MeshMode = "auto", collision: CollisionPreset = "full") -> EntityCfg:
  """A new config of the YAM, to be changed at will.

  Args:
    meshes: See `yam_spec`.
    collision: Contact preset; "full" is what the MJCF says.

  Raises:
    ValueError: There is no such preset.
  """
  return robot_entity(
    yam_spec,
    meshes=meshes,
    height=YAM_DEFAULT_HEIGHT,
    joint_pos=YAM_DEFAULT_JOINT_POS,
    actuators=YAM_ACTUATORS,
    soft_joint_pos_limit_factor=YAM_SOFT_JOINT_POS_LIMIT_FACTOR,
    collision=collision,
    presets=_presets,
  )


def _presets() -> dict[str, tuple[CollisionCfg, ...]]:
  from mjlab_scene import CollisionCfg

  hand = CollisionCfg(geom_names_expr="(link6_.|[lr]f_rot.|[lr]f_down[1-5])_collision")
  return {"gripper_only": (hand, CollisionCfg(geom_names_expr=_TIPS, condim=6, priority=1))}
