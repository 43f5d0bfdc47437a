"""Package of a task: environment, terms, entry point and test, after one of the task families."""

from typing import Literal

from mjlab.new.package import filled

Family = Literal["velocity", "tracking", "lift", "empty"]

_PURPOSE: dict[Family, str] = {
  "velocity": "a robot follows commanded velocities.",
  "tracking": "a humanoid follows a clip.",
  "lift": "an arm lifts a block to a goal.",
  "empty": "a pole holds an angle, to be replaced part by part.",
}
_PACKAGES: dict[Family, tuple[str, ...]] = {
  "velocity": ("mjlab-sensors", "mjlab-velocity"),
  "tracking": ("mjlab-dr", "mjlab-robots", "mjlab-sim", "mjlab-tracking"),
  "lift": ("mjlab-manipulation", "mjlab-scene", "mujoco"),
  "empty": ("mjlab-actuators", "mjlab-scene", "mjlab-sim", "mjlab-terrain", "mujoco"),
}


def task_id(name: str) -> str:
  """Return the id of the task of a package: "my_walk" offers "My-Walk"."""
  return "-".join(part.capitalize() for part in name.split("_") if part)


def task_files(name: str, like: Family, robot: str) -> dict[str, str | bytes]:
  """Return the files of a package.

  Args:
    name: Name of the package.
    like: Family of the task.
    robot: Package of a robot that `new robot` wrote, for legged robots; empty: a robot of mjlab.
  """
  facts = {"name": name, "distribution": name.replace("_", "-"), "task_id": task_id(name)}
  packages = ["mjlab", "mjlab-envs", "mjlab-managers", "mjlab-rl", *_PACKAGES[like], "torch"]
  values = {}
  if like == "velocity":
    # Imports of first-party packages form a separate group.
    own = f"\nfrom {robot} import ACTION_SCALE, FEET, FOOT_BODIES, TORSO, {robot}\n"
    values["imports"] = own if robot else "from mjlab_robots import GO1_ACTION_SCALE, go1\n"
    values["robot"] = filled(f"task/robot_{'own' if robot else 'go1'}.txt", robot=robot)
    packages.append(robot.replace("_", "-") if robot else "mjlab-robots")
  listed = "".join(f'\n  "{package}",' for package in sorted(packages))
  return {
    "pyproject.toml": filled("task/pyproject.toml.txt", **facts, dependencies=f"{listed}\n"),
    "README.md": filled("task/README.md.txt", **facts, purpose=_PURPOSE[like]),
    f"src/{name}/__init__.py": filled("task/init.py.txt", **facts),
    f"src/{name}/task.py": filled(f"task/{like}.py.txt", **facts, **values),
    f"src/{name}/terms.py": filled("task/terms.py.txt"),
    f"tests/test_{name}.py": filled("task/test.py.txt", **facts),
  }
