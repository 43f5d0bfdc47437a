"""Window of MuJoCo."""
