"""Terms that only velocity tracking needs."""

from mjlab_velocity.mdp.command import UniformVelocityCommand, UniformVelocityCommandCfg, VelocityRanges
from mjlab_velocity.mdp.curricula import VelocityStage, commands_vel
from mjlab_velocity.mdp.rewards import (
  angular_momentum_l2,
  body_ang_vel_xy_l2,
  feet_air_time,
  feet_clearance,
  feet_slip,
  feet_swing_height,
  foot_air_time,
  foot_contact,
  foot_contact_forces,
  foot_height,
  soft_landing,
  track_angular_velocity,
  track_linear_velocity,
  upright,
  variable_posture,
)
from mjlab_velocity.mdp.terrain import (
  out_of_terrain_bounds,
  plane_normal,
  randomize_terrain,
  terrain_levels,
  upright_on_terrain,
)

__all__ = [
  "UniformVelocityCommand",
  "UniformVelocityCommandCfg",
  "VelocityRanges",
  "VelocityStage",
  "angular_momentum_l2",
  "body_ang_vel_xy_l2",
  "commands_vel",
  "feet_air_time",
  "feet_clearance",
  "feet_slip",
  "feet_swing_height",
  "foot_air_time",
  "foot_contact",
  "foot_contact_forces",
  "foot_height",
  "out_of_terrain_bounds",
  "plane_normal",
  "randomize_terrain",
  "soft_landing",
  "terrain_levels",
  "track_angular_velocity",
  "track_linear_velocity",
  "upright",
  "upright_on_terrain",
  "variable_posture",
]
