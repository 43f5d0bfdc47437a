"""Package of a robot: entity config, model, picture and test from a model file."""

import dataclasses
import os
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from mjlab_core import MjlabError, RenderingError, printable
from mjlab_scene.export import write_spec

from mjlab.new.limbs import Foot, add_foot_sites, bend_legs, colliding, find_feet, find_torso, home_pose
from mjlab.new.model_file import Base, RobotModel, read_robot_model, without_actuators
from mjlab.new.package import filled, source
from mjlab.new.picture import robot_picture
from mjlab.new.servos import Drives, read_drives
from mjlab.new.settling import Attitude, Home, attitude, exclude_overlaps, settle

STIFFENING = (1.5, 2.25, 3.5, 5.0)
"""Factors on guessed stiffness that are tried until the robot stands."""


@dataclasses.dataclass(kw_only=True)
class NewRobot:
  """Robot that was read, with what was guessed about it."""

  robot: RobotModel
  spec: mujoco.MjSpec
  """The model to write: without the actuators that servos replace, with the keyframe "home"."""
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
    MjlabError: The file cannot be read or is no robot; one line.
    UsageError: A flag does not fit the robot.
  """
  robot = read_robot_model(path, base)
  pose = home_pose(robot, home)
  body = find_torso(robot, torso)
  soles = find_feet(robot, pose, feet)
  wheels = _wheels(robot, soles)
  drives = read_drives(robot, motors, wheels)
  add_foot_sites(robot, pose, soles)
  if len(soles) > 1 and not home and not robot.spec.keys and not wheels:
    pose = bend_legs(robot, pose, soles)
    robot.notes.append("the file has no keyframe: the home pose is a guess with bent legs (--home changes it)")
  for one, other in exclude_overlaps(robot.spec, pose):
    robot.notes.append(f"no contact between {printable(one)} and {printable(other)}, which overlap in the home pose")
  _add_motion_sensors(robot)
  spec = without_actuators(robot.spec, set(drives.replaced))
  drives, settled = _settled(spec, drives, pose, attitude(robot.spec))
  _add_keyframe(spec, settled)
  return NewRobot(robot=robot, spec=spec, drives=drives, torso=body, feet=soles, home=settled)


def _settled(spec: mujoco.MjSpec, drives: Drives, pose: dict[str, float], rot: Attitude) -> tuple[Drives, Home]:
  """Return servos, stiffened where they are guessed until they bear the robot, and the pose it settles in."""
  first = settle(spec, drives.configs(), pose, rot)
  if first.stands or not any(servo.is_guess for servo in drives.servos):
    return drives, first
  for factor in STIFFENING:
    stiffer = drives.stiffer(factor)
    home = settle(spec, stiffer.configs(), pose, rot)
    if home.stands:
      return stiffer, home
  return drives, first


def robot_files(new: NewRobot, name: str) -> dict[str, str | bytes]:
  """Return the files of the package `name`."""
  files: dict[str, str | bytes] = {f"src/{name}/{path}": content for path, content in _model_files(new.spec).items()}
  try:
    files["robot.png"] = robot_picture(new.home, new.torso, new.feet)
  except RenderingError as error:
    new.robot.notes.append(f"no picture: {printable(error, 200)}")
  facts = {"name": name, "distribution": name.replace("_", "-"), "source": new.robot.source}
  feet, model = new.feet, new.spec.copy().compile()
  kinds = sorted({type(cfg).__name__ for cfg in new.drives.configs()})
  files[f"src/{name}/__init__.py"] = filled("robot/init.py.txt", **facts)
  files[f"src/{name}/robot.py"] = filled(
    "robot/robot.py.txt",
    **facts,
    imports=", ".join(kinds),
    torso=source(new.torso),
    feet=source(tuple(foot.site for foot in feet), lead=7),
    foot_bodies=source(tuple(foot.body for foot in feet), lead=14),
    foot_geoms=source(tuple(_pattern(name) for foot in feet for name in foot.geoms), lead=13),
    collision=_collision(model, colliding(model), {name for foot in feet for name in foot.geoms}),
    actuators="".join(f"  {_actuator_source(cfg)},\n" for cfg in new.drives.configs()),
    action_scale=source({_pattern(servo.joint): round(servo.action_scale, 4) for servo in new.drives.servos}, lead=15),
  )
  files[f"tests/test_{name}.py"] = filled("robot/test.py.txt", **facts, **_test(new))
  files["pyproject.toml"] = filled("robot/pyproject.toml.txt", **facts)
  picture = "![The robot and its guessed parts](robot.png)\n" if "robot.png" in files else ""
  report = "".join(f"- {line}\n" for line in new.report())
  files["README.md"] = filled("robot/README.md.txt", **facts, picture=picture, report=report)
  return files


def _wheels(robot: RobotModel, feet: Sequence[Foot]) -> list[str]:
  model = robot.compiled()
  found = []
  for foot in feet:
    for joint in robot.spec.body(foot.body).joints:
      i = model.joint(joint.name).id
      if joint.type == mujoco.mjtJoint.mjJNT_HINGE and not model.jnt_limited[i]:
        found.append(joint.name)
  return found


def _add_motion_sensors(robot: RobotModel) -> None:
  """Add the sensors that tasks of legged robots read, where the file has none of these names."""
  if not robot.is_floating:
    return
  spec, root = robot.spec, robot.spec.bodies[1]
  taken = {sensor.name for sensor in spec.sensors}
  site = next((site.name for site in spec.sites if site.name == "imu"), None)
  if site is None:
    root.add_site(name="imu")
  kinds = {"imu_lin_vel": mujoco.mjtSensor.mjSENS_VELOCIMETER, "imu_ang_vel": mujoco.mjtSensor.mjSENS_GYRO}
  for name, kind in kinds.items():
    if name not in taken:
      spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="imu")
  if "root_angmom" not in taken:
    kind = mujoco.mjtSensor.mjSENS_SUBTREEANGMOM
    spec.add_sensor(name="root_angmom", type=kind, objtype=mujoco.mjtObj.mjOBJ_BODY, objname=root.name)


def _add_keyframe(spec: mujoco.MjSpec, home: Home) -> None:
  model = spec.copy().compile()
  qpos = model.qpos0.copy()
  for i in range(model.njnt):
    at, name = model.jnt_qposadr[i], model.joint(i).name
    if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE:
      qpos[at : at + 7] = home.root
    elif name in home.joint_pos:
      qpos[at] = home.joint_pos[name]
  spec.add_key(name="home", qpos=np.round(qpos, 5))


def _model_files(spec: mujoco.MjSpec) -> dict[str, bytes]:
  """Return the MJCF and its assets by path below "model"."""
  with tempfile.TemporaryDirectory() as folder:
    try:
      written = write_spec(spec.copy(), Path(folder) / "model").parent
    except (ValueError, OSError) as error:
      raise MjlabError(f"the model cannot be written: {' '.join(str(error).split())}") from error
    os.rename(written / "scene.xml", written / "robot.xml")
    return {
      path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(written.rglob("*")) if path.is_file()
    }


def _pattern(name: str) -> str:
  return name if re.fullmatch(r"[\w/ -]*", name) else re.escape(name)


def _collision(model: mujoco.MjModel, geoms: list[int], soles: set[str]) -> str:
  """Return the arguments of the collision set: what the file says, and feet whose friction counts."""
  names = tuple(_pattern(model.geom(i).name) for i in geoms)
  lines = [f"geom_names_expr={source(names, 2, 16)}"]
  for field in ("contype", "conaffinity", "condim", "priority"):
    values = {model.geom(i).name: int(getattr(model, f"geom_{field}")[i]) for i in geoms}
    if field == "priority" and not any(values.values()):
      # A dict leaves other geoms as the model has them.
      lines.append("priority=dict.fromkeys(FOOT_GEOMS, 1)" if soles else "priority=0")
      continue
    is_one = len(set(values.values())) == 1
    lines.append(f"{field}={next(iter(values.values())) if is_one else _by_value(values)}")
  return "".join(f"  {line},\n" for line in lines)


def _by_value(values: dict[str, int]) -> str:
  return source({_pattern(name): value for name, value in values.items()}, 2, 12)


def _actuator_source(cfg: object) -> str:
  """Return the call that makes an actuator config, with the fields that differ from their defaults."""
  fields = []
  for field in dataclasses.fields(cfg):  # type: ignore
    value = getattr(cfg, field.name)
    if field.default is dataclasses.MISSING or value != field.default:
      if field.name == "target_names_expr":
        value = tuple(_pattern(re.sub(r"\\(.)", r"\1", name)) for name in value)
      fields.append(f"{field.name}={source(value, 4, len(field.name) + 1)}")
  flat = f"{type(cfg).__name__}({', '.join(fields)})"
  if len(flat) <= 114 and "\n" not in flat:
    return flat
  lines = "".join(f"    {field},\n" for field in fields)
  return f"{type(cfg).__name__}(\n{lines}  )"


def _test(new: NewRobot) -> dict[str, str]:
  """Return the title, the name and the code of the test of a robot."""
  kind = "fixed" if not new.robot.is_floating else "standing" if new.home.stands else "floating"
  title, claim = {
    "fixed": ("holds its pose", "it_holds_its_home_pose"),
    "standing": ("stands", "it_stands"),
    "floating": ("is at rest", "its_home_pose_is_on_the_ground"),
  }[kind]
  return {"title": title, "claim": claim, "check": filled(f"robot/check_{kind}.py.txt").rstrip("\n")}
