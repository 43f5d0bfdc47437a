"""Package of a robot: entity config, model, picture and test from a model file."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from mjlab_core import RenderingError, printable
from mjlab_scene.export import write_spec

from mjlab.new.limbs import Foot, bend_legs, colliding, find_feet, find_torso, home_pose
from mjlab.new.model_file import Base, RobotModel, pattern, read_robot_model
from mjlab.new.package import call_source, filled, source
from mjlab.new.picture import robot_picture
from mjlab.new.servos import Drives, read_drives
from mjlab.new.settling import Home, exclude_overlaps, settle

STIFFENING = (1.5, 2.25, 3.5, 5.0)
"""Factors on guessed stiffness that are tried until the robot stands."""


@dataclass(kw_only=True)
class NewRobot:
  """Robot that was read, with what was guessed about it."""

  robot: RobotModel
  """Model to write: without the actuators that servos replace, with the keyframe "home"."""
  drives: Drives
  torso: str
  feet: tuple[Foot, ...]
  home: Home

  def report(self) -> list[str]:
    """Return lines about the robot: what was read, guessed and changed."""
    base = "floating" if self.robot.is_floating else "fixed"
    mass = float(self.home.model.body_mass.sum())
    feet = ", ".join(foot.body for foot in self.feet) or "none"
    lines = [
      f"base: {base}, {mass:.3g} kg; {len(self.robot.joints)} joints, {len(self.drives.servos)} servos",
      f"torso: {printable(self.torso)}; feet: {printable(feet)} (--torso, --feet change them)",
    ]
    if not self.home.stands:
      lines.append(
        "it does not stay in its home pose on its servos alone; --home POSE and --motors may change that"
        if self.robot.is_floating
        else "it sags out of its home pose"
      )
    return [*lines, *self.robot.notes]


def read_robot(
  path: Path, *, base: Base, motors: Sequence[str], home: Sequence[str], torso: str, feet: Sequence[str]
) -> NewRobot:
  """Read a robot from a model file and settle it.

  Raises:
    MjlabError: The file cannot be read or is not a robot; one line.
    UsageError: A flag does not fit the robot.
  """
  robot = read_robot_model(path, base)
  qpos = home_pose(robot, home)
  body = find_torso(robot, torso)
  soles = find_feet(robot, qpos, feet)
  wheels = _wheels(robot, soles)
  drives = read_drives(robot, motors, wheels)
  if len(soles) > 1 and not home and not robot.spec.keys and not wheels:
    qpos = bend_legs(robot, qpos, soles)
    robot.notes.append("the file has no keyframe: the home pose is a guess with bent legs (--home changes it)")
  for one, other in exclude_overlaps(robot, qpos):
    robot.notes.append(f"no contact between {printable(one)} and {printable(other)}, which overlap in the home pose")
  _add_motion_sensors(robot)
  spec = robot.spec
  for element in [*spec.keys, *(actuator for actuator in spec.actuators if actuator.name in drives.replaced)]:
    spec.delete(element)
  drives, settled = _settled(spec, drives, qpos)
  spec.add_key(name="home", qpos=np.round(settled.qpos, 5))
  return NewRobot(robot=robot, drives=drives, torso=body, feet=soles, home=settled)


def _settled(spec: mujoco.MjSpec, drives: Drives, qpos: np.ndarray) -> tuple[Drives, Home]:
  """Return servos, stiffened where they are guessed until they bear the robot, and the pose it settles in."""
  first = settle(spec, drives.configs(), qpos)
  if not first.stands and drives.guessed:
    for factor in STIFFENING:
      stiffer = drives.stiffer(factor)
      home = settle(spec, stiffer.configs(), qpos)
      if home.stands:
        return stiffer, home
  return drives, first


def robot_files(new: NewRobot, name: str) -> dict[str, str | bytes]:
  """Return the files of the package `name`, except its model."""
  facts = {"name": name, "distribution": name.replace("_", "-"), "source": new.robot.source}
  feet, drives, model = new.feet, new.drives, new.robot.spec.copy().compile()
  solid, configs = colliding(model), drives.configs()
  values: dict[str, object] = {
    "torso": new.torso,
    "feet": tuple(foot.site for foot in feet),
    "foot_bodies": tuple(foot.body for foot in feet),
    "foot_geoms": tuple(pattern(name) for foot in feet for name in foot.geoms),
    "action_scale": {pattern(joint): round(drives.action_scale(joint), 4) for joint in drives.servos},
  }
  files: dict[str, str | bytes] = {
    f"src/{name}/__init__.py": filled("robot/init.py.txt", **facts),
    f"src/{name}/robot.py": filled(
      "robot/robot.py.txt",
      **facts,
      **{key: source(value) for key, value in values.items()},
      collision=textwrap.indent(source(tuple(pattern(model.geom(i).name) for i in solid)), "  ").lstrip(),
      imports=", ".join(sorted({type(cfg).__name__ for cfg in configs})),
      # The friction of feet has priority, unless the file gives priorities.
      priority="{}" if model.geom_priority[solid].any() else "dict.fromkeys(FOOT_GEOMS, 1)",
      actuators=textwrap.indent("".join(f"{call_source(cfg)},\n" for cfg in configs), "  "),
    ),
    f"tests/test_{name}.py": filled("robot/test.py.txt", **facts, **_test(new)),
    "pyproject.toml": filled("robot/pyproject.toml.txt", **facts),
  }
  picture = ""
  try:
    files["robot.png"] = robot_picture(new.home, new.torso, feet)
    picture = "![The robot and its guessed parts](robot.png)\n"
  except RenderingError as error:
    new.robot.notes.append(f"no picture: {printable(error, 200)}")
  report = "".join(f"- {line}\n" for line in new.report())
  files["README.md"] = filled("robot/README.md.txt", **facts, picture=picture, report=report)
  return files


def _wheels(robot: RobotModel, feet: Sequence[Foot]) -> list[str]:
  """Return the hinges without range at the bodies of feet."""
  model = robot.compiled()
  joints = [joint for foot in feet for joint in robot.spec.body(foot.body).joints]
  hinges = [joint.name for joint in joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
  return [name for name in hinges if not model.jnt_limited[model.joint(name).id]]


def _add_motion_sensors(robot: RobotModel) -> None:
  """Add the sensors that tasks of legged robots read, where the file has none of these names."""
  if not robot.is_floating:
    return
  spec, root = robot.spec, robot.spec.bodies[1]
  if all(site.name != "imu" for site in spec.sites):
    root.add_site(name="imu")
  kinds, objects = mujoco.mjtSensor, mujoco.mjtObj
  for name, kind, objtype, objname in (
    ("imu_lin_vel", kinds.mjSENS_VELOCIMETER, objects.mjOBJ_SITE, "imu"),
    ("imu_ang_vel", kinds.mjSENS_GYRO, objects.mjOBJ_SITE, "imu"),
    ("root_angmom", kinds.mjSENS_SUBTREEANGMOM, objects.mjOBJ_BODY, root.name),
  ):
    if all(sensor.name != name for sensor in spec.sensors):
      spec.add_sensor(name=name, type=kind, objtype=objtype, objname=objname)


def write_model(spec: mujoco.MjSpec, folder: Path) -> None:
  """Write robot.xml and its assets."""
  path = write_spec(spec.copy(), folder)
  path.rename(path.with_name("robot.xml"))


def _test(new: NewRobot) -> dict[str, str]:
  """Return the title, the name and the code of the test of a robot."""
  kind = "fixed" if not new.robot.is_floating else "standing" if new.home.stands else "floating"
  title, claim = {
    "fixed": ("holds its pose", "it_holds_its_home_pose"),
    "standing": ("stands", "it_stands"),
    "floating": ("is at rest", "its_home_pose_is_on_the_ground"),
  }[kind]
  return {"title": title, "claim": claim, "check": filled(f"robot/check_{kind}.py.txt").rstrip("\n")}
