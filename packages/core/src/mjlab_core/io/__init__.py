"""Files: atomic writes, guarded reads and arrays."""
