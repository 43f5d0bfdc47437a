"""Metadata of the networks of others, as mjlab 1.x and BeyondMimic write it."""

import math
from collections.abc import Mapping

from mjlab_deploy.description import Joint, Observation
from mjlab_deploy.errors import DeployError, check_known

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


def read_joints(metadata: Mapping[str, str]) -> tuple[Joint, ...]:
  """Return the joints of a network with their gains and default positions.

  Raises:
    DeployError: A value is missing or malformed; the message names it.
  """
  names = words(metadata, "joint_names")
  rows = [numbers(metadata, key, len(names)) for key in ("default_joint_pos", "joint_stiffness", "joint_damping")]
  return tuple(
    Joint(name=name, default_position=default, is_driven=True, stiffness=kp, damping=kd)
    for name, default, kp, kd in zip(names, *rows, strict=True)
  )


def read_observations(metadata: Mapping[str, str], num_joints: int, *, follows_clip: bool) -> tuple[Observation, ...]:
  """Return the observations of a network in the order of its input.

  Raises:
    DeployError: A value is missing or malformed, or an observation is not known; the message names it.
  """
  known, anchor = _SOURCES_WITH_CLIP if follows_clip else _SOURCES, metadata.get("anchor_body_name", "")
  names = words(metadata, "observation_names")
  settings = []
  for key, separator in (("scale", ";"), ("clip", ";"), ("history_length", ",")):
    parts = metadata.get(f"observation_terms_{key}", "").split(separator)
    parts = parts if len(parts) == len(names) else [""] * len(names)
    settings.append([_parsed(f"observation_terms_{key}", part) for part in parts])
  found, start = [], 0
  for name, scale, clip, history in zip(names, *settings, strict=True):
    check_known("observation of the network", name, known)
    if len(clip) not in (0, 2):
      raise DeployError(f"metadata 'observation_terms_clip' of '{name}' has {len(clip)} numbers")
    sources = tuple(source.replace("BODY", anchor) for source in known[name])
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


def words(metadata: Mapping[str, str], key: str) -> list[str]:
  """Return a list of the metadata.

  Raises:
    DeployError: It is missing.
  """
  check_known("metadata of the network", key, metadata)
  return [word.strip() for word in metadata[key].split(",")]


def reading_width(name: str, num_joints: int) -> int:
  """Return the number of values of a reading, or of the last action."""
  if name.startswith(("joint/", "motion/joint_", "last_action")):
    return num_joints
  return 4 if name.endswith("orientation") else 3


def numbers(metadata: Mapping[str, str], key: str, count: int) -> list[float]:
  """Return one number for each of `count` joints.

  Raises:
    DeployError: They are missing or malformed; the message names the key.
  """
  values = _parsed(key, ",".join(words(metadata, key)))
  if len(values) not in (1, count):
    raise DeployError(f"metadata '{key}' has {len(values)} numbers for {count} joints")
  return values if len(values) == count else values * count


def _parsed(key: str, text: str) -> list[float]:
  text = text.strip(" ()[]")
  try:
    values = [float(word) for word in text.split(",")] if text not in ("", "None") else []
  except ValueError:
    values = [math.nan]
  if any(map(math.isnan, values)):
    raise DeployError(f"metadata '{key}' has a value that is not a number: {text[:80]}")
  return values
