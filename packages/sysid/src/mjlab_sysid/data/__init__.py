"""Records of a robot: signals, files and windows."""
