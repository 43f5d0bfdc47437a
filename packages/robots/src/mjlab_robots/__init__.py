"""Robot models for mjlab: physics in an MJCF of ours, servo gains and poses in Python, meshes where they are found."""

from mjlab_robots.go1 import (
  GO1_ACTION_SCALE,
  GO1_ACTUATORS,
  GO1_DEFAULT_HEIGHT,
  GO1_DEFAULT_JOINT_POS,
  GO1_SOFT_JOINT_POS_LIMIT_FACTOR,
  go1,
  go1_spec,
)
from mjlab_robots.meshes import MeshesNotFoundError, MeshMode, find_meshes

__all__ = [
  "GO1_ACTION_SCALE",
  "GO1_ACTUATORS",
  "GO1_DEFAULT_HEIGHT",
  "GO1_DEFAULT_JOINT_POS",
  "GO1_SOFT_JOINT_POS_LIMIT_FACTOR",
  "MeshMode",
  "MeshesNotFoundError",
  "find_meshes",
  "go1",
  "go1_spec",
]
