"""Comparison of an exported network's metadata with its environment.

The keys and formats are those of mjlab 1.x: lists are joined by commas, nested lists by semicolons, numbers have three
decimals. Keys that are missing in the file are not compared.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from mjlab_core import MjlabError, match_names, match_values_full, printable
from mjlab_core.errors import FileError

# A little more than half of the last of three decimals.
_ABSOLUTE, _RELATIVE = 6e-4, 1e-4
_UNCLIPPED = (-math.inf, math.inf)
_WORDS = {"true": 1.0, "false": 0.0}


def metadata_differences(metadata: Mapping[str, str], env: Any, groups: Sequence[str]) -> Iterator[str]:
  """Yield a line for each part of the metadata that differs from the environment.

  Args:
    metadata: Metadata of the file.
    env: Environment. Parts that it does not have, such as an action manager with terms, are not compared.
    groups: Observation groups that the policy sees.

  Raises:
    FileError: A value is malformed.
  """
  yield from _observation_differences(metadata, env, groups)
  if (commands := getattr(env, "command_manager", None)) is not None:
    yield from _name_differences(metadata, "command_names", list(commands.active_terms))
  if terms := _action_terms(env):
    yield from _joint_differences(metadata, env.scene[terms[0].cfg.entity], terms)


def _observation_differences(metadata: Mapping[str, str], env: Any, groups: Sequence[str]) -> Iterator[str]:
  layout_of = getattr(getattr(env, "observation_manager", None), "layout", None)
  if layout_of is None:
    return
  layouts = [layout for group in groups for layout in layout_of(group)]
  names = [layout.name for layout in layouts]
  if differences := list(_name_differences(metadata, "observation_names", names)):
    yield from differences
    return
  # Flattening is compared only where there is a history.
  expected = {
    "scale": [1.0 if layout.scale is None else layout.scale for layout in layouts],
    "history_length": [max(layout.history_length, 1) for layout in layouts],
    "flatten_history_dim": [
      len(layout.shape) == len(layout.frame_shape) if layout.history_length > 1 else None for layout in layouts
    ],
    "clip": [_UNCLIPPED if layout.clip is None else layout.clip for layout in layouts],
  }
  for key, ours in expected.items():
    yield from _number_differences(metadata, f"observation_terms_{key}", names, ours)


def _joint_differences(metadata: Mapping[str, str], entity: Any, terms: Sequence[Any]) -> Iterator[str]:
  joints = list(entity.joint_names)
  targets: list[str] = [name for term in terms for name in term.target_names]
  saved = _names(metadata, "joint_names") or joints
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


def configured(entity: Any, gain: str, joints: Sequence[str]) -> list[float | None]:
  """Return the configured gain or limit of each joint; None where its actuator has none."""
  found: dict[str, float] = {}
  for cfg in entity.cfg.articulation.actuators if entity.cfg.articulation is not None else ():
    if (values := getattr(cfg, gain, None)) is None or cfg.transmission_type != "joint":
      continue
    names = match_names(cfg.target_names_expr, entity.joint_names, what="joint")[1]
    try:
      found |= dict(zip(names, match_values_full(values, names, what="joint"), strict=True))
    except MjlabError:
      continue
  return [found.get(joint) for joint in joints]


def _name_differences(metadata: Mapping[str, str], key: str, ours: list[str]) -> Iterator[str]:
  theirs = _names(metadata, key)
  if theirs is None or theirs == ours:
    return
  missing, added = [name for name in theirs if name not in ours], [name for name in ours if name not in theirs]
  if missing or added:
    parts = [f"{_listed(missing)} only in the file" if missing else "", f"{_listed(added)} only here" if added else ""]
    yield f"{key}: {', '.join(part for part in parts if part)}"
  else:
    i = next((i for i, (a, b) in enumerate(zip(theirs, ours, strict=False)) if a != b), min(len(theirs), len(ours)))
    yield f"{key}: another order, from position {i}: {_listed(theirs[i:])} in the file and {_listed(ours[i:])} here"


def _number_differences(
  metadata: Mapping[str, str], key: str, names: Sequence[str], ours: Sequence[Any]
) -> Iterator[str]:
  """Yield a line for each number, or row of numbers, that differs; None in `ours` is not compared."""
  if key not in metadata:
    return
  saved = _rows(metadata, key)
  kind = "observation terms" if key.startswith("observation") else "joints"
  if len(saved) == 1 and kind == "joints":
    saved = saved * len(names)
  if len(saved) != len(names):
    yield f"{key}: {len(saved)} values in the file for {len(names)} {kind}"
    return
  for name, theirs, value in zip(names, saved, ours, strict=True):
    row = np.atleast_1d(value)
    is_comparable = len(theirs) == len(row) or 1 in (len(theirs), len(row))
    if value is not None and not (is_comparable and np.allclose(theirs, row.astype(float), _RELATIVE, _ABSOLUTE)):
      yield f"{key}: '{name}' has {_shown(theirs)} in the file and {_shown(row)} here"


def _names(metadata: Mapping[str, str], key: str) -> list[str] | None:
  if key not in metadata:
    return None
  return [name.strip() for name in metadata[key].split(",") if name.strip()]


def _rows(metadata: Mapping[str, str], key: str) -> list[Sequence[float]]:
  """Return the items of a list, each as a list of numbers."""
  text = metadata[key].strip()
  absent = _UNCLIPPED if key.endswith("clip") else (1.0,)
  found: list[Sequence[float]] = []
  try:
    for item in text.split(";" if ";" in text else ","):
      words = [word.strip(" ()[]").lower() for word in item.split(",")]
      is_absent = words in (["none"], [""])
      found.append(absent if is_absent else [_WORDS[word] if word in _WORDS else float(word) for word in words])
  except ValueError as error:
    raise FileError(f"metadata {key!r} has a value that is not a number: {printable(text, 80)}") from error
  # A history of 0 frames is the present frame.
  return [np.maximum(row, 1.0).tolist() for row in found] if key.endswith("history_length") else found


def _listed(names: Sequence[str]) -> str:
  shown = ", ".join(printable(name, 60) for name in names[:4])
  return shown + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _shown(values: Iterable[float]) -> str:
  return ", ".join(f"{value:.4g}" for value in values)
