"""Rotations, name matching, ring buffers, masked writes and seeding for GPU robot learning."""
