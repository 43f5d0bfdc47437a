"""Metadata of networks of other projects: of mjlab 1.x and BeyondMimic in the file, of Unitree in `deploy.yaml`.

Metadata of mjlab 1.x are lists. Items stand between commas, the numbers of one item between semicolons.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjlab_deploy.description import Joint, Observation
from mjlab_deploy.errors import DeployError, check_known, library, read_limited, reading
from mjlab_deploy.formats.other_formats import MOTORS

GROUP = "actor"
"""Name of the only observation group."""
# Readings of each observation; "BODY" stands for the anchor of the clip.
_SOURCES = {
  "base_lin_vel": ("estimate/linear_velocity",),
  "base_ang_vel": ("imu/gyro",),
  "projected_gravity": ("imu/projected_gravity",),
  "joint_pos": ("joint/position",),
  "joint_pos_rel": ("joint/position",),
  "joint_vel": ("joint/velocity",),
  "joint_vel_rel": ("joint/velocity",),
  "actions": ("last_action",),
  "last_action": ("last_action",),
  "command": ("command/velocity",),
  "velocity_commands": ("command/velocity",),
}
_SOURCES_WITH_CLIP = _SOURCES | {
  "command": ("motion/joint_position", "motion/joint_velocity"),
  "motion_anchor_pos_b": ("motion/anchor_position", "estimate/BODY/position", "imu/BODY/orientation"),
  "motion_anchor_ori_b": ("motion/anchor_orientation", "imu/BODY/orientation"),
}
_WIDTHS = {"motion_anchor_pos_b": 3, "motion_anchor_ori_b": 6}
_MAX_BYTES = 2**20
_KEYS = ("joint_ids_map", "step_dt", "stiffness", "damping", "default_joint_pos", "actions", "observations")


@dataclass(frozen=True, kw_only=True)
class NetworkMetadata:
  """Robot and observations of a network."""

  joints: tuple[Joint, ...]
  action_scale: tuple[float, ...]
  observations: tuple[Observation, ...]
  rate: float | None = None
  """Rate of the policy [Hz]; None: not known."""
  bodies: tuple[str, ...] = ()
  """Bodies of the clip."""
  anchor: str = ""
  """Body of the clip that is aligned with the robot."""


def metadata_words(metadata: Mapping[str, str], key: str) -> list[str]:
  """Return the items of a list as text.

  Raises:
    DeployError: The key is missing.
  """
  check_known("metadata of the network", key, metadata)
  return [word.strip() for word in metadata[key].split(",") if word.strip()]


def metadata_rows(metadata: Mapping[str, str], key: str, count: int) -> list[list[float]]:
  """Return the `count` items of a list of numbers, which may be one item for all; an item None has no numbers.

  Raises:
    DeployError: The key is missing, a value is not a number, or there are more or fewer items.
  """
  check_known("metadata of the network", key, metadata)
  words = [word.strip() for word in metadata[key].split(",")]
  with reading(f"metadata '{key}' has a value that is not a number", ValueError):
    rows = [[] if word in ("", "None") else [float(number) for number in word.split(";")] for word in words]
    if any(math.isnan(number) for row in rows for number in row):
      raise DeployError("nan")
  if len(rows) not in (1, count):
    raise DeployError(f"metadata '{key}' has {len(rows)} values, but there are {count} items")
  return rows if len(rows) == count else rows * count


def read_metadata(metadata: Mapping[str, str], *, follows_clip: bool) -> NetworkMetadata:
  """Return the metadata of an ONNX file.

  Raises:
    DeployError: A value is missing or malformed, or an observation is not known; the message names it.
    ValueError: A joint has more or fewer numbers than one.
  """
  names, terms = (metadata_words(metadata, key) for key in ("joint_names", "observation_names"))
  bodies, anchor = metadata_words(metadata, "body_names") if follows_clip else [], metadata.get("anchor_body_name", "")
  if follows_clip:
    check_known("anchor_body_name of the metadata", anchor, bodies)
  numbers = (
    [number for (number,) in metadata_rows(metadata, key, len(names))]
    for key in ("default_joint_pos", "joint_stiffness", "joint_damping", "action_scale")
  )
  settings = (
    metadata_rows(metadata, key, len(terms)) if key in metadata else [[]] * len(terms)
    for key in ("observation_terms_scale", "observation_terms_clip", "observation_terms_history_length")
  )
  rows = zip(terms, *settings, strict=True)
  return _network(names, numbers, rows, anchor if follows_clip else None, bodies=tuple(bodies), anchor=anchor)


def _network(
  names: Sequence[str],
  numbers: Iterable[Sequence[float]],
  rows: Iterable[Sequence[Any]],
  clip_anchor: str | None = None,
  **others: Any,
) -> NetworkMetadata:
  """Return metadata for default position, kp, kd and action scale of each joint, and rows of observations."""
  default, stiffness, damping, scale = numbers
  joints = tuple(
    Joint(name=name, default_position=position, is_driven=True, stiffness=kp, damping=kd)
    for name, position, kp, kd in zip(names, default, stiffness, damping, strict=True)
  )
  observations = _observations(rows, len(names), clip_anchor)
  return NetworkMetadata(joints=joints, action_scale=tuple(scale), observations=observations, **others)


def _observations(rows: Iterable[Sequence[Any]], num_joints: int, anchor: str | None) -> tuple[Observation, ...]:
  """Return the observations of a network in the order of its input.

  Args:
    rows: Name, scale, clip and history length of each; a missing setting is an empty list.
    num_joints: Number of joints.
    anchor: Body of the clip that the policy follows; None without a clip.

  Raises:
    DeployError: An observation is not known, or its clip has not two numbers.
  """
  known = _SOURCES if anchor is None else _SOURCES_WITH_CLIP
  found, start = [], 0
  for name, scale, clip, history in rows:
    check_known("observation of the network", name, known)
    if len(clip) not in (0, 2):
      raise DeployError(f"clip of observation '{name}' has {len(clip)} numbers")
    sources = tuple(source.replace("BODY", anchor or "") for source in known[name])
    frames = max(1, int(sum(history)))
    width = frames * _WIDTHS.get(name, sum(reading_width(source, num_joints) for source in sources))
    found.append(
      Observation(
        group=GROUP,
        name=name,
        columns=(start, start + width),
        shape=(width,),
        sources=sources,
        scale=tuple(scale) or None,
        clip=(clip[0], clip[1]) if clip and all(map(math.isfinite, clip)) else None,
        history_length=frames if frames > 1 else 0,
      )
    )
    start += width
  return tuple(found)


def reading_width(name: str, num_joints: int) -> int:
  """Return the number of values of a reading, or of the last action."""
  if name.startswith(("joint/", "motion/joint_", "last_action")):
    return num_joints
  return 4 if name.endswith("orientation") else 3


def find_deploy_yaml(policy: Path) -> Path | None:
  """Return the `deploy.yaml` of a network: beside it, or in the folder `params` as trainings write it."""
  places = (policy.parent / "deploy.yaml", policy.parent.parent / "params" / "deploy.yaml")
  return next((place for place in places if place.is_file()), None)


def read_deploy_yaml(path: Path) -> NetworkMetadata:
  """Return the metadata of a network that a `deploy.yaml` describes.

  Raises:
    DeployError: It cannot be read, lacks a key, or describes an unsupported policy.
  """
  yaml = library("yaml", "the extra 'yaml' of mjlab-deploy")
  with reading(path, yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, AttributeError, IndexError):
    data = yaml.safe_load(read_limited(path, _MAX_BYTES))
    if missing := [key for key in _KEYS if not isinstance(data, dict) or key not in data]:
      raise DeployError(f"it has no '{missing[0]}'")
    return _metadata(data)


def _metadata(data: Mapping[str, Any]) -> NetworkMetadata:
  motors = [int(number) for number in data["joint_ids_map"]]
  known = {len(names): names for names in (*MOTORS, data.get("motor_names", ()))}
  if sorted(motors) != list(range(len(motors))) or len(motors) not in known:
    raise DeployError(f"joint_ids_map has {len(motors)} motors, not those of a G1 with 29, a quadruped, or motor_names")
  names = known[len(motors)]
  default = [float(value) for value in data["default_joint_pos"]]
  ((kind, action),) = data["actions"].items()
  offset = _spread(action.get("offset") or 0.0, len(motors))
  if kind != "JointPositionAction" or action.get("joint_ids") is not None or action.get("clip") is not None:
    raise DeployError(f"action {kind!s:.60} is not one of all joints without a clip")
  if not all(math.isclose(one, other, abs_tol=1e-6) for one, other in zip(offset, default, strict=True)):
    raise DeployError("the offset of its action is not the default pose")
  keys = ("scale", "clip", "history_length")
  rows = [(name, *(_spread(term.get(key) or (), 1) for key in keys)) for name, term in data["observations"].items()]
  # Gains are in the order of the motors, everything else in that of the policy.
  gains = ([float(data[gain][i]) for i in motors] for gain in ("stiffness", "damping"))
  numbers = (default, *gains, _spread(action.get("scale") or 1.0, len(motors)))
  return _network([names[i] for i in motors], numbers, rows, rate=1.0 / float(data["step_dt"]))


def _spread(value: Any, count: int) -> list[float]:
  """Return a list of numbers; one number stands for `count`."""
  values = value if isinstance(value, Sequence) else [value] * count
  return [float(number) for number in values]
