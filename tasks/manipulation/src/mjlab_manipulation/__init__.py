"""An arm lifts cubes to where it is told."""

from mjlab_manipulation.lift import lift_cube, lift_cube_env, lift_cube_ik, lift_cube_ik_env

__all__ = ["lift_cube", "lift_cube_env", "lift_cube_ik", "lift_cube_ik_env"]
