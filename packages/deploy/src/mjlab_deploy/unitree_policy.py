"""Policies of Unitree's runner: a network without metadata, and its `deploy.yaml`."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mjlab_deploy.errors import DeployError, library, read_limited, reading
from mjlab_deploy.network_metadata import NetworkMetadata, driven_joints, observations
from mjlab_deploy.other_formats import MOTORS

_MAX_BYTES = 2**20


def find_deploy_yaml(policy: Path) -> Path | None:
  """Return the `deploy.yaml` of a network: beside it, or in the folder `params` as trainings write it."""
  places = (policy.parent / "deploy.yaml", policy.parent.parent / "params" / "deploy.yaml")
  return next((place for place in places if place.is_file()), None)


def read_deploy_yaml(path: Path) -> NetworkMetadata:
  """Return the metadata of a network that a `deploy.yaml` describes.

  Raises:
    DeployError: It cannot be read, lacks something, or describes what the runner here does not do.
  """
  yaml = library("yaml", "the extra 'yaml' of mjlab-deploy")
  with reading(path, yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, AttributeError, IndexError):
    data = yaml.safe_load(read_limited(path, _MAX_BYTES))
    if missing := [key for key in _KEYS if not isinstance(data, dict) or key not in data]:
      raise DeployError(f"it has no '{missing[0]}'")
    return _metadata(data)


_KEYS = ("joint_ids_map", "step_dt", "stiffness", "damping", "default_joint_pos", "actions", "observations")


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
  stiffness, damping = ([float(data[gain][i]) for i in motors] for gain in ("stiffness", "damping"))
  return NetworkMetadata(
    joints=driven_joints([names[i] for i in motors], default, stiffness, damping),
    action_scale=tuple(_spread(action.get("scale") or 1.0, len(motors))),
    observations=observations(rows, len(motors)),
    rate=1.0 / float(data["step_dt"]),
  )


def _spread(value: Any, count: int) -> list[float]:
  """Return a list of numbers; one number stands for `count`."""
  values = value if isinstance(value, Sequence) else [value] * count
  return [float(number) for number in values]
