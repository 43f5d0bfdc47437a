"""Modules of mjlab 1.x that are separate packages now; importing one raises an error with its new name."""

from collections.abc import Sequence
from typing import Any

MOVED = {
  "mjlab.actuator": "mjlab_actuators",
  "mjlab.asset_zoo": "mjlab_robots",
  "mjlab.entity": "mjlab_scene",
  "mjlab.envs": "mjlab_envs",
  "mjlab.envs.mdp": "mjlab_envs.mdp",
  "mjlab.envs.mdp.dr": "mjlab_dr",
  "mjlab.managers": "mjlab_managers",
  "mjlab.rl": "mjlab_rl",
  "mjlab.scene": "mjlab_scene",
  "mjlab.scripts": "mjlab.cli",
  "mjlab.sensor": "mjlab_sensors",
  "mjlab.sim": "mjlab_sim",
  "mjlab.tasks": "mjlab.registry",
  "mjlab.tasks.cartpole": "mjlab_cartpole",
  "mjlab.tasks.manipulation": "mjlab_manipulation",
  "mjlab.tasks.tracking": "mjlab_tracking",
  "mjlab.tasks.velocity": "mjlab_velocity",
  "mjlab.terrains": "mjlab_terrain",
  "mjlab.utils": "mjlab_core",
  "mjlab.viewer": "mjlab_viewer",
}
"""New names by former names."""


class MovedModules:
  """Finder for modules that no other finder has found."""

  @staticmethod
  def find_spec(fullname: str, path: Sequence[str] | None, target: Any = None) -> None:
    """Name the new places of all modules in a package that moved; Python imports it before them."""
    del path, target
    within = [f"{old} is now {new}" for old, new in MOVED.items() if f"{old}.".startswith(f"{fullname}.")]
    if within:
      raise ModuleNotFoundError(
        f"No module named {fullname!r}: {', '.join(within)}. See docs/migration.md.", name=fullname
      )
