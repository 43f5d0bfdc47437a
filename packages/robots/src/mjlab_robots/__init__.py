"""Robot models: Unitree Go1."""
