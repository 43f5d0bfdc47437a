"""Policies in MuJoCo C: scene, readings, cameras, closed loop and verification."""
