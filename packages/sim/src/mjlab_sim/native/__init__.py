"""MuJoCo batch engine behind the engine protocol."""
