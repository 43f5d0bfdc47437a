"""Velocity tracking for legged robots."""
