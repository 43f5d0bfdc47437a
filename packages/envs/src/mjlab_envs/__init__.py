"""The manager-based environment and its generic term library."""
