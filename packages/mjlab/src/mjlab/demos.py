"""Policies that come with the package: bundles in `demo_policies`, and two checkpoints."""

from importlib.resources import files
from importlib.resources.abc import Traversable

TASKS = {
  "g1": "Mjlab-Velocity-Flat-Unitree-G1-Blind",
  "g1-rough": "Mjlab-Velocity-Rough-Unitree-G1-Blind",
  "go1": "Mjlab-Velocity-Flat-Unitree-Go1-Blind",
  "go1-rough": "Mjlab-Velocity-Rough-Unitree-Go1-Blind",
  "track": "Mjlab-Tracking-Flat-Unitree-G1-No-State-Estimation",
  "lift": "Mjlab-Lift-Cube-Yam",
  "lift-rgb": "Mjlab-Lift-Cube-Yam-Rgb-Distill",
}
"""Task of each policy that can ship, by its name. The first that ships is the one that `demo` shows unasked."""
_CHECKPOINTS = {"go1": "demo_policy", "lift": "demo_policy_lift"}


def shipped() -> dict[str, Traversable]:
  """Return the folders of the policies that ship, by name: a bundle, or a checkpoint with its manifest."""
  package = files("mjlab")
  found = {name: package / folder for name, folder in _CHECKPOINTS.items()}
  found |= {
    name: folder for name in TASKS if (folder := package / "demo_policies" / name).joinpath("bundle.json").is_file()
  }
  return {name: found[name] for name in TASKS if name in found}
