"""Terrain for any MuJoCo model: adds itself to an MjSpec. NumPy and MuJoCo only."""
