"""Feet, torso and pose of a robot, guessed from its shape."""

import io
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mjlab_core import MjlabError, UsageError
from mjlab_core.names import match_names, match_values

from mjlab.new.model_file import RobotModel, last_links, subtree

SAME_HEIGHT = 0.1
"""Feet end this close to the lowest point, as a share of the robot's height."""
SOLE = 0.03
"""Geoms of a foot that end this close to its lowest point are its sole [m]."""
STARTS = 8
"""Poses from which a guess of a home pose begins."""
LEG_SHARE = 0.85
"""Length of a leg from hip to foot in a guessed pose, as a share of the stretched leg."""


@dataclass(frozen=True, kw_only=True)
class Foot:
  """Last link of a leg."""

  body: str
  geoms: tuple[str, ...]
  """Lowest of the colliding geoms of the body and of those fixed to it."""
  site: str
  """Site in the middle of these geoms."""


def lowest(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
  """Return the height of the lowest point of a geom [m]; a plane or height field has that of its centre."""
  down, size = data.geom_xmat[geom].reshape(3, 3)[2], model.geom_size[geom]
  kind = mujoco.mjtGeom(model.geom_type[geom])
  if kind == mujoco.mjtGeom.mjGEOM_MESH:
    mesh = model.geom_dataid[geom]
    first = model.mesh_vertadr[mesh]
    reach = -float((model.mesh_vert[first : first + model.mesh_vertnum[mesh]] @ down).min())
  else:
    reach = {
      mujoco.mjtGeom.mjGEOM_SPHERE: size[0],
      mujoco.mjtGeom.mjGEOM_CAPSULE: size[0] + size[1] * abs(down[2]),
      mujoco.mjtGeom.mjGEOM_CYLINDER: size[0] * np.hypot(down[0], down[1]) + size[1] * abs(down[2]),
      mujoco.mjtGeom.mjGEOM_BOX: float(np.abs(down) @ size),
      mujoco.mjtGeom.mjGEOM_ELLIPSOID: float(np.linalg.norm(down * size)),
    }.get(kind, 0.0)
  return float(data.geom_xpos[geom, 2] - reach)


def colliding(model: mujoco.MjModel) -> list[int]:
  """Return the geoms that can touch the ground, whose bits are 1."""
  return [i for i in range(model.ngeom) if (model.geom_contype[i] | model.geom_conaffinity[i]) & 1]


def home_pose(robot: RobotModel, given: Sequence[str]) -> dict[str, float]:
  """Return the position of each hinge and slide [rad, m]: the first keyframe's, else zero or the nearest in range.

  Args:
    robot: The robot.
    given: PATTERN=POSITION of the user, which override it.

  Raises:
    UsageError: A position cannot be read, names no joint, or is out of range.
  """
  model = robot.compiled()
  data = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, data, 0) if model.nkey else mujoco.mj_resetData(model, data)
  names = [joint.name for joint in robot.joints]
  pose = {name: float(data.joint(name).qpos[0]) for name in names}
  for name in pose:
    if model.joint(name).range[0] < model.joint(name).range[1]:
      pose[name] = float(np.clip(pose[name], *model.joint(name).range))
  wanted = {}
  for text in given:
    pattern, _, value = text.rpartition("=")
    try:
      wanted[pattern] = float(value)
    except ValueError as error:
      raise UsageError(f"--home: {text!r} must be PATTERN=POSITION") from error
  _, matched, values = match_values(wanted, names, what="joint", owner="--home")
  for name, value in zip(matched, values, strict=True):
    low, high = model.joint(name).range
    if not np.isfinite(value) or (low < high and not low <= value <= high):
      raise UsageError(f"--home: {value:g} of joint '{name}' is outside [{low:g}, {high:g}]")
    pose[name] = value
  return pose


def posed(robot: RobotModel, pose: dict[str, float]) -> tuple[mujoco.MjModel, mujoco.MjData]:
  """Return the compiled robot in a pose, upright."""
  model = robot.compiled()
  data = mujoco.MjData(model)
  if model.nkey and robot.is_floating:
    mujoco.mj_resetDataKeyframe(model, data, 0)
  for name, value in pose.items():
    data.joint(name).qpos[0] = value
  mujoco.mj_forward(model, data)
  return model, data


def find_torso(robot: RobotModel, given: str) -> str:
  """Return the body named by the user, or the heaviest.

  Raises:
    UsageError: There is no such body.
  """
  model = robot.compiled()
  names = [model.body(i).name for i in range(1, model.nbody)]
  return (
    match_names(given, names, what="body", owner="--torso")[1][0]
    if given
    else names[int(np.argmax(model.body_mass[1:]))]
  )


def find_feet(robot: RobotModel, pose: dict[str, float], given: Sequence[str]) -> tuple[Foot, ...]:
  """Return the last links that reach lowest in a pose, or those named by the user; none of a fixed base.

  Raises:
    UsageError: A named body does not exist, or has nothing that collides.
    MjlabError: No geom of the robot collides.
  """
  model, data = posed(robot, pose)
  solid = colliding(model)
  if not solid:
    raise MjlabError(f"{robot.source}: no geom collides, so that the robot would fall through the ground")
  heights = {i: lowest(model, data, i) for i in solid}
  by_body: dict[str, list[int]] = {}
  for body in last_links(robot.spec) if not given else robot.spec.bodies[1:]:
    ids = {model.body(below.name).id for below in subtree(body)}
    by_body[body.name] = [i for i in solid if model.geom_bodyid[i] in ids]
  if given:
    _, names = match_names(given, list(by_body), what="body", owner="--feet")
    if empty := [name for name in names if not by_body[name]]:
      raise UsageError(f"--feet: no geom of body '{empty[0]}' collides")
  elif robot.is_floating:
    floor = min(heights.values())
    limit = floor + SAME_HEIGHT * (max(heights.values()) - floor)
    names = [name for name, geoms in by_body.items() if geoms and min(heights[i] for i in geoms) <= limit]
  else:
    names = []
  feet = []
  for name in names:
    limit = min(heights[i] for i in by_body[name]) + SOLE
    soles = tuple(model.geom(i).name for i in by_body[name] if heights[i] <= limit)
    feet.append(Foot(body=name, geoms=soles, site=_free_site(robot, name)))
  return tuple(feet)


def _free_site(robot: RobotModel, body: str) -> str:
  taken = {site.name for site in robot.spec.sites}
  name, number = f"{body}_foot", 2
  while name in taken:
    name, number = f"{body}_foot_{number}", number + 1
  return name


def add_foot_sites(robot: RobotModel, pose: dict[str, float], feet: Sequence[Foot]) -> None:
  """Add the site of each foot."""
  _, data = posed(robot, pose)
  for foot in feet:
    middle = np.mean([data.geom(name).xpos for name in foot.geoms], axis=0)
    body = data.body(foot.body)
    place = body.xmat.reshape(3, 3).T @ (middle - body.xpos)
    robot.spec.body(foot.body).add_site(name=foot.site, pos=place)


def bend_legs(robot: RobotModel, pose: dict[str, float], feet: Sequence[Foot]) -> dict[str, float]:
  """Return a pose with every foot below its hip and every leg bent, for a robot without a keyframe."""
  from mujoco.minimize import Verbosity, least_squares

  model, data = posed(robot, pose)
  joints, legs = [], []
  for foot in feet:
    body, chain = robot.spec.body(foot.body), []
    while body is not None and body.name != "world":
      own = [joint.name for joint in body.joints if joint.name in pose]
      if own:
        chain.append((body.name, own))
      body = body.parent
    hip = _hip(data, chain)
    leg = chain[: chain.index(next(link for link in chain if link[0] == hip)) + 1]
    points = [data.site(foot.site).xpos, *(data.joint(own[0]).xanchor for _, own in leg)]
    length = sum(float(np.linalg.norm(a - b)) for a, b in itertools.pairwise(points))
    joints += [name for _, own in leg for name in own if name not in joints]
    legs.append((foot, data.joint(leg[-1][1][0]).xanchor.copy(), length, data.site(foot.site).xmat[6:].copy()))
  start = np.array([pose[name] for name in joints])
  ranges = np.array([model.joint(name).range for name in joints])
  low = np.where(ranges[:, 0] < ranges[:, 1], ranges[:, 0], -np.pi)
  high = np.where(ranges[:, 0] < ranges[:, 1], ranges[:, 1], np.pi)
  low, high = low + 0.02 * (high - low), high - 0.02 * (high - low)

  def residual(points: np.ndarray) -> np.ndarray:
    rows = []
    for point in np.atleast_2d(points.T):
      for name, value in zip(joints, point, strict=True):
        data.joint(name).qpos[0] = value
      mujoco.mj_kinematics(model, data)
      row = [0.05 * (point - np.clip(start, low, high))]
      for foot, hip, length, up in legs:
        offset = data.site(foot.site).xpos - hip
        row.append(10.0 * offset[:1] / length)
        row.append(10.0 * (offset[2:] + LEG_SHARE * length) / length)
        # Flat feet stay flat; to a point foot it does not matter.
        row.append(0.5 * (data.site(foot.site).xmat[6:] - up))
      rows.append(np.concatenate(row))
    return np.array(rows).T

  # A stretched leg does not say which way it bends, so that several starts are tried.
  rng, tried = np.random.default_rng(0), []
  for _ in range(STARTS):
    begin = np.clip(start + rng.uniform(-0.6, 0.6, len(joints)), low + 1e-6, high - 1e-6)
    found, _ = least_squares(begin, residual, bounds=[low, high], verbose=Verbosity.SILENT, output=io.StringIO())
    tried.append((float(np.square(residual(found.reshape(-1, 1))).sum()), found.ravel()))
  best = min(tried, key=lambda pair: pair[0])[1]
  return pose | {name: round(float(value), 3) for name, value in zip(joints, best, strict=True)}


def _hip(data: mujoco.MjData, chain: list[tuple[str, list[str]]]) -> str:
  """Return the link of a leg whose joint is highest among those that turn or move it."""
  return max(chain, key=lambda link: (round(float(data.joint(link[1][0]).xanchor[2]), 2), chain.index(link) * -1))[0]
