"""Comparison of an exported network's metadata with its environment.

The keys and formats are those of mjlab 1.x, which `mjlab_deploy.formats.network_metadata` reads; numbers have three
decimals. Keys that are missing in the file are not compared.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
from mjlab_core import printable
from mjlab_deploy.formats.network_metadata import metadata_rows, metadata_words

from mjlab_rl.bundles.bundle_policy import configured

# A little more than half of the last of three decimals.
_ABSOLUTE, _RELATIVE = 6e-4, 1e-4
_UNCLIPPED = (-math.inf, math.inf)


def metadata_differences(metadata: Mapping[str, str], env: Any, groups: Sequence[str]) -> Iterator[str]:
  """Yield a line for each part of the metadata that differs from the environment.

  Args:
    metadata: Metadata of the file.
    env: Environment. Parts that it does not have, such as an action manager with terms, are not compared.
    groups: Observation groups that the policy sees.

  Raises:
    DeployError: A value is malformed.
  """
  if (layout_of := getattr(getattr(env, "observation_manager", None), "layout", None)) is not None:
    yield from _observation_differences(metadata, [layout for group in groups for layout in layout_of(group)])
  if (commands := getattr(env, "command_manager", None)) is not None:
    yield from _name_differences(metadata, "command_names", list(commands.active_terms))
  if terms := _action_terms(env):
    yield from _joint_differences(metadata, env.scene[terms[0].cfg.entity], terms)


def _observation_differences(metadata: Mapping[str, str], layouts: Sequence[Any]) -> Iterator[str]:
  names = [layout.name for layout in layouts]
  if differences := list(_name_differences(metadata, "observation_names", names)):
    yield from differences
    return
  # Flattening is compared only where there is a history.
  flattened = [len(item.shape) == len(item.frame_shape) if item.history_length > 1 else None for item in layouts]
  lengths = [max(layout.history_length, 1) for layout in layouts]
  for key, ours, absent in (
    ("scale", [1.0 if layout.scale is None else layout.scale for layout in layouts], [1.0]),
    ("history_length", lengths, [1.0]),
    ("flatten_history_dim", flattened, [1.0]),
    ("clip", [layout.clip or _UNCLIPPED for layout in layouts], _UNCLIPPED),
  ):
    yield from _number_differences(metadata, f"observation_terms_{key}", names, ours, absent)


def _joint_differences(metadata: Mapping[str, str], entity: Any, terms: Sequence[Any]) -> Iterator[str]:
  joints = list(entity.joint_names)
  targets: list[str] = [name for term in terms for name in term.target_names]
  saved = metadata_words(metadata, "joint_names") if "joint_names" in metadata else joints
  # The file lists all joints, or those that are driven.
  expected = targets if len(saved) == len(targets) != len(joints) else joints
  yield from _name_differences(metadata, "joint_names", expected)
  if (order := [name for name in saved if name in targets]) != targets and set(order) == set(targets):
    yield f"joint_names: the actions are in another order here: {', '.join(targets)}"
  if saved != expected:
    return
  pose = dict(zip(joints, entity.data.default_joint_pos.flatten().tolist(), strict=True))
  yield from _number_differences(metadata, "default_joint_pos", saved, [pose[name] for name in saved])
  for gain in ("stiffness", "damping"):
    yield from _number_differences(metadata, f"joint_{gain}", saved, configured(entity, gain, saved))
  if all(hasattr(term, "scale") for term in terms):
    scale = [value for term in terms for value in term.scale.expand(1, len(term.target_names)).flatten().tolist()]
    yield from _number_differences(metadata, "action_scale", targets, scale)


def _action_terms(env: Any) -> list[Any]:
  """Return the action terms if each drives joints of one entity."""
  manager = getattr(env, "action_manager", None)
  terms = [manager.get_term(name) for name in getattr(manager, "active_terms", ())] if manager is not None else []
  is_driving = all(hasattr(term, "target_names") and hasattr(getattr(term, "cfg", None), "entity") for term in terms)
  return terms if is_driving and len({term.cfg.entity for term in terms}) == 1 else []


def _name_differences(metadata: Mapping[str, str], key: str, ours: list[str]) -> Iterator[str]:
  theirs = metadata_words(metadata, key) if key in metadata else ours
  differs = (i for i, (one, other) in enumerate(zip_longest(theirs, ours)) if one != other)
  if (i := next(differs, None)) is not None:
    yield f"{key}: {_listed(theirs[i:])} in the file and {_listed(ours[i:])} here, from position {i}"


def _number_differences(
  metadata: Mapping[str, str],
  key: str,
  names: Sequence[str],
  ours: Sequence[Any],
  absent: Sequence[float] = (),
) -> Iterator[str]:
  """Yield a line for each number, or row of numbers, that differs; None in `ours` is not compared.

  `absent` takes the place of None in the file.
  """
  saved = metadata_rows(metadata, key, len(names)) if key in metadata else ()
  for name, theirs, value in zip(names, saved, ours, strict=False):
    # A history of 0 frames is the present frame.
    theirs = np.maximum(theirs, 1.0) if key.endswith("history_length") else np.array(theirs or absent)
    row = np.atleast_1d(value)
    is_comparable = len(theirs) == len(row) or 1 in (len(theirs), len(row))
    if value is not None and not (is_comparable and np.allclose(theirs, row.astype(float), _RELATIVE, _ABSOLUTE)):
      yield f"{key}: '{name}' has {_shown(theirs)} in the file and {_shown(row)} here"


def _listed(names: Sequence[str]) -> str:
  shown = ", ".join(printable(name, 60) for name in names[:4]) or "nothing"
  return shown + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _shown(values: Iterable[float]) -> str:
  return ", ".join(f"{value:.4g}" for value in values)
