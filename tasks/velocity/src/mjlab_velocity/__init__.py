"""Velocity tracking for legged robots."""

from mjlab_velocity.blind import blind
from mjlab_velocity.evaluation import VelocityEvaluation
from mjlab_velocity.g1 import g1_flat, g1_flat_blind, g1_flat_env, g1_rough, g1_rough_blind, g1_rough_env
from mjlab_velocity.go1 import go1_flat, go1_flat_blind, go1_flat_env, go1_rough, go1_rough_blind, go1_rough_env

__all__ = [
  "VelocityEvaluation",
  "blind",
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
]
