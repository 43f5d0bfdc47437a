"""Robot models for mjlab: MJCFs for physics, servo gains and poses in Python, optional meshes."""

from mjlab_robots.g1 import (
  G1_ACTION_SCALE,
  G1_ACTUATORS,
  G1_DEFAULT_HEIGHT,
  G1_DEFAULT_JOINT_POS,
  g1,
  g1_spec,
)
from mjlab_robots.go1 import (
  GO1_ACTION_SCALE,
  GO1_ACTUATORS,
  GO1_DEFAULT_HEIGHT,
  GO1_DEFAULT_JOINT_POS,
  go1,
  go1_spec,
)
from mjlab_robots.go2 import (
  GO2_ACTION_SCALE,
  GO2_ACTUATORS,
  GO2_DEFAULT_HEIGHT,
  GO2_DEFAULT_JOINT_POS,
  go2,
  go2_spec,
)
from mjlab_robots.meshes import MeshMode, download_meshes, find_meshes
from mjlab_robots.model import SOFT_JOINT_POS_LIMIT_FACTOR
from mjlab_robots.motors import Motor
from mjlab_robots.yam import (
  YAM_ACTION_SCALE,
  YAM_ACTUATORS,
  YAM_DEFAULT_HEIGHT,
  YAM_DEFAULT_JOINT_POS,
  yam,
  yam_spec,
)

__all__ = [
  "G1_ACTION_SCALE",
  "G1_ACTUATORS",
  "G1_DEFAULT_HEIGHT",
  "G1_DEFAULT_JOINT_POS",
  "GO1_ACTION_SCALE",
  "GO1_ACTUATORS",
  "GO1_DEFAULT_HEIGHT",
  "GO1_DEFAULT_JOINT_POS",
  "GO2_ACTION_SCALE",
  "GO2_ACTUATORS",
  "GO2_DEFAULT_HEIGHT",
  "GO2_DEFAULT_JOINT_POS",
  "SOFT_JOINT_POS_LIMIT_FACTOR",
  "YAM_ACTION_SCALE",
  "YAM_ACTUATORS",
  "YAM_DEFAULT_HEIGHT",
  "YAM_DEFAULT_JOINT_POS",
  "MeshMode",
  "Motor",
  "download_meshes",
  "find_meshes",
  "g1",
  "g1_spec",
  "go1",
  "go1_spec",
  "go2",
  "go2_spec",
  "yam",
  "yam_spec",
]
