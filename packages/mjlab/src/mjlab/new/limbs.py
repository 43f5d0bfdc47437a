"""Feet, torso and pose of a robot, guessed from its shape."""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mjlab_core import MjlabError, UsageError
from mjlab_core.names import match_names

from mjlab.new.model_file import JOINT_KINDS, RobotModel, last_links

SAME_HEIGHT = 0.1
"""Feet end this close to the lowest point, as a share of the robot's height."""
SOLE = 0.03
"""Geoms of a foot that end this close to its lowest point are its sole [m]."""
STARTS = 8
"""Poses from which a guess of a home pose begins."""
LEG_SHARE = 0.85
"""Length of a leg from hip to foot in a guessed pose, as a share of the stretched leg."""
_FAR = 1e3
_PLANE = mujoco.mjtGeom.mjGEOM_PLANE


@dataclass(frozen=True, kw_only=True)
class Foot:
  """Last link of a leg."""

  body: str
  geoms: tuple[str, ...]
  """Lowest of the colliding geoms of the body and of those fixed to it."""
  site: str
  """Site in the middle of these geoms."""


def colliding(model: mujoco.MjModel) -> list[int]:
  """Return the geoms that can touch the ground: those whose contact bits match 1."""
  bits = (model.geom_contype | model.geom_conaffinity) & 1
  return np.flatnonzero(bits & (model.geom_type != _PLANE)).tolist()


def heights(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, float]:
  """Return the height of the lowest point of each geom that can touch the ground, a plane of the model [m]."""
  ground = int(np.argmax(model.geom_type == _PLANE))
  return {model.geom(i).name: mujoco.mj_geomDistance(model, data, ground, i, _FAR, None) for i in colliding(model)}


def within_limits(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
  """Return a configuration with each hinge and slide in its range."""
  qpos = qpos.copy()
  for i in np.flatnonzero(model.jnt_limited):
    if mujoco.mjtJoint(model.jnt_type[i]) in JOINT_KINDS:
      at = model.jnt_qposadr[i]
      qpos[at] = np.clip(qpos[at], *model.jnt_range[i])
  return qpos


def home_pose(robot: RobotModel, given: Sequence[str]) -> np.ndarray:
  """Return the configuration of the first keyframe, else that of the model, with hinges and slides in their ranges.

  Args:
    robot: The robot.
    given: PATTERN=POSITION of the user, which override it.

  Raises:
    UsageError: A position cannot be read, names no joint, or is out of range.
  """
  model = robot.compiled()
  qpos = within_limits(model, model.key_qpos[0] if model.nkey else model.qpos0)
  for name, (value,) in robot.numbers(given, "--home", "PATTERN=POSITION").items():
    joint = model.joint(name)
    low, high = joint.range
    if low < high and not low <= value <= high:
      raise UsageError(f"--home: {value:g} of joint '{name}' is outside [{low:g}, {high:g}]")
    qpos[joint.qposadr] = value
  return qpos


def posed(robot: RobotModel, qpos: np.ndarray) -> tuple[mujoco.MjModel, mujoco.MjData]:
  """Return the compiled robot in a configuration."""
  model = robot.compiled()
  data = mujoco.MjData(model)
  data.qpos[:] = qpos
  mujoco.mj_forward(model, data)
  return model, data


def find_torso(robot: RobotModel, given: str) -> str:
  """Return the body that the user names, or the heaviest.

  Raises:
    UsageError: There is no such body.
  """
  model = robot.compiled()
  if not given:
    return model.body(int(np.argmax(model.body_mass))).name
  return match_names(given, [body.name for body in robot.spec.bodies[1:]], what="body", owner="--torso")[1][0]


def find_feet(robot: RobotModel, qpos: np.ndarray, given: Sequence[str]) -> tuple[Foot, ...]:
  """Return the last links that reach lowest, or those named by the user, each with a new site; none of a fixed base.

  Raises:
    UsageError: A named body does not exist, or has nothing that collides.
    MjlabError: No geom of the robot collides.
  """
  model, data = posed(robot, qpos)
  lowest = heights(model, data)
  if not lowest:
    raise MjlabError(f"{robot.source}: no geom collides, so that the robot would fall through the ground")
  bodies = robot.spec.bodies[1:] if given else last_links(robot.spec)
  by_body = {
    body.name: {geom.name: lowest[geom.name] for geom in body.find_all("geom") if geom.name in lowest}
    for body in bodies
  }
  names: list[str] = []
  if given:
    _, names = match_names(given, list(by_body), what="body", owner="--feet")
    if empty := [name for name in names if not by_body[name]]:
      raise UsageError(f"--feet: no geom of body '{empty[0]}' collides")
  elif robot.is_floating:
    floor = min(lowest.values())
    limit = floor + SAME_HEIGHT * (max(lowest.values()) - floor)
    names = [name for name, geoms in by_body.items() if any(height <= limit for height in geoms.values())]
  return tuple(_foot(robot, data, name, by_body[name]) for name in names)


def _foot(robot: RobotModel, data: mujoco.MjData, name: str, lowest: dict[str, float]) -> Foot:
  """Return a foot, and add its site unless the robot has one of that name."""
  soles = tuple(geom for geom, height in lowest.items() if height <= min(lowest.values()) + SOLE)
  site, body = f"{name}_foot", data.body(name)
  if all(other.name != site for other in robot.spec.sites):
    middle = np.mean([data.geom(geom).xpos for geom in soles], axis=0)
    robot.spec.body(name).add_site(name=site, pos=body.xmat.reshape(3, 3).T @ (middle - body.xpos))
  return Foot(body=name, geoms=soles, site=site)


def bend_legs(robot: RobotModel, qpos: np.ndarray, feet: Sequence[Foot]) -> np.ndarray:
  """Return a configuration with bent legs and the feet around the point below the centre of mass.

  It is a guess for a robot without a keyframe.
  """
  from mujoco.minimize import Verbosity, least_squares

  model, data = posed(robot, qpos)
  joints = [model.joint(joint.name) for joint in robot.joints]
  at = np.array([joint.qposadr[0] for joint in joints])
  ranges = np.array([joint.range if joint.range[0] < joint.range[1] else (-np.pi, np.pi) for joint in joints])
  low, high = (ranges @ [[0.98, 0.02], [0.02, 0.98]]).T
  sites = [data.site(foot.site) for foot in feet]
  places, normals = (np.array([getattr(site, name)[-3:] for site in sites]) for name in ("xpos", "xmat"))
  legs = [_leg(model, data, foot) for foot in feet]
  length = np.mean([length for _, length in legs])
  # Horizontally from the centre of mass.
  targets = places - places.mean(0)
  targets[:, 2] = [hip - LEG_SHARE * length for hip, length in legs]
  start = np.clip(qpos[at], low, high)

  def residual(points: np.ndarray) -> np.ndarray:
    columns = []
    for point in np.atleast_2d(points.T):
      data.qpos[at] = point
      mujoco.mj_kinematics(model, data)
      mujoco.mj_comPos(model, data)
      moved = np.array([site.xpos for site in sites]) - targets
      moved[:, :2] -= data.subtree_com[1, :2]
      # Flat feet stay flat; to a point foot it does not matter.
      turned = np.array([site.xmat[-3:] for site in sites]) - normals
      columns.append(np.concatenate([0.05 * (point - start), 10.0 * moved.ravel() / length, 0.5 * turned.ravel()]))
    return np.stack(columns, axis=1)

  # A stretched leg can bend both ways, so several starts are tried.
  rng, tried = np.random.default_rng(0), []
  for _ in range(STARTS):
    begin = np.clip(start + rng.uniform(-0.6, 0.6, len(at)), low, high)
    found, _ = least_squares(begin, residual, bounds=[low, high], verbose=Verbosity.SILENT, output=io.StringIO())
    tried.append(found.ravel())
  bent = qpos.copy()
  bent[at] = np.round(min(tried, key=lambda point: float(np.square(residual(point)).sum())), 3)
  return bent


def _leg(model: mujoco.MjModel, data: mujoco.MjData, foot: Foot) -> tuple[float, float]:
  """Return the height of a leg's hip, its highest link, and the length of the stretched leg below it [m]."""
  points, body = [data.site(foot.site).xpos], model.body(foot.body).id
  while model.body_parentid[body] > 0:
    points.append(data.xpos[body])
    body = model.body_parentid[body]
  hip = int(np.argmax(np.round(points, 2)[:, 2]))
  return points[hip][2], float(np.linalg.norm(np.diff(points[: hip + 1], axis=0), axis=1).sum())
