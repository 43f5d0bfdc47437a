"""MuJoCo Warp behind the engine protocol."""
