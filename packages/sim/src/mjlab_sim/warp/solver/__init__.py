"""Fused Newton solver, and solvers of Warp's tiles."""
