"""Entities, terrain and sensors composed into one MuJoCo scene."""
