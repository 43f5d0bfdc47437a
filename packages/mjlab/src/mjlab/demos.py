"""Policies that come with the package: bundles in `demo_policies`."""

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


def shipped() -> dict[str, Traversable]:
  """Return the folders of the bundles that ship, by name."""
  folder = files("mjlab") / "demo_policies"
  return {name: folder / name for name in TASKS if (folder / name / "bundle.json").is_file()}
