"""Velocity tracking for legged robots."""

from mjlab_velocity.evaluation import VelocityEvaluation
from mjlab_velocity.g1 import g1_flat, g1_flat_blind, g1_flat_env, g1_rough, g1_rough_blind, g1_rough_env
from mjlab_velocity.legged import LeggedRobot, agent, flat_env, play_flat
from mjlab_velocity.quadruped import (
  go1_flat,
  go1_flat_blind,
  go1_flat_env,
  go1_rough,
  go1_rough_blind,
  go1_rough_env,
  go2_flat,
  go2_flat_blind,
  go2_flat_env,
  go2_rough,
  go2_rough_blind,
  go2_rough_env,
)
from mjlab_velocity.rough import ground_contact, play_rough, rough_env, rough_terrain, self_collision
from mjlab_velocity.sim_to_real import blind, sim_to_real

__all__ = [
  "LeggedRobot",
  "VelocityEvaluation",
  "agent",
  "blind",
  "flat_env",
  "g1_flat",
  "g1_flat_blind",
  "g1_flat_env",
  "g1_rough",
  "g1_rough_blind",
  "g1_rough_env",
  "go1_flat",
  "go1_flat_blind",
  "go1_flat_env",
  "go1_rough",
  "go1_rough_blind",
  "go1_rough_env",
  "go2_flat",
  "go2_flat_blind",
  "go2_flat_env",
  "go2_rough",
  "go2_rough_blind",
  "go2_rough_env",
  "ground_contact",
  "play_flat",
  "play_rough",
  "rough_env",
  "rough_terrain",
  "self_collision",
  "sim_to_real",
]
