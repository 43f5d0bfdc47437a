"""Files of a run: manifest, checkpoints, the names in them, and the state of a process."""
