"""Sensors of MuJoCo."""
