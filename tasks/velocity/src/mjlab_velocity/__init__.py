"""Velocity tracking for legged robots."""

from mjlab_velocity.go1 import go1_flat, go1_flat_env

__all__ = ["go1_flat", "go1_flat_env"]
