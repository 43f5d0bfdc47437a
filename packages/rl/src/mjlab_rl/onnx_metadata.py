"""Comparison of an exported network's metadata with the environment that it is to act in.

The keys and formats are those of mjlab 1.x: lists are joined by commas, nested lists by semicolons, numbers have three
decimals. Keys that are missing in the file are not compared.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec
from mjlab_core import MjlabError, match_names, match_values_full, printable
from mjlab_core.errors import FileError

# Half of the last of three decimals, and a little.
_ABSOLUTE, _RELATIVE = 6e-4, 1e-4


def metadata_differences(metadata: Mapping[str, str], env: Any, groups: Sequence[str]) -> Iterator[str]:
  """Yield a line for each part of the metadata that differs from the environment.

  Args:
    metadata: Metadata of the file.
    env: Environment. Parts that it does not have, such as an action manager with terms, are not compared.
    groups: Observation groups that the policy sees.

  Raises:
    FileError: A value has another form than its key says.
  """
  yield from _observation_differences(metadata, env, groups)
  if (commands := getattr(env, "command_manager", None)) is not None:
    yield from _name_differences(metadata, "command_names", list(commands.active_terms))
  terms = _action_terms(env)
  if not terms:
    return
  entity = env.scene[terms[0].cfg.entity]
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
  columns = [joints.index(name) for name in saved if name in joints]
  pose = entity.data.default_joint_pos.flatten().tolist()
  yield from _number_differences(metadata, "default_joint_pos", saved, [pose[column] for column in columns])
  for key, gain in (("joint_stiffness", "stiffness"), ("joint_damping", "damping")):
    yield from _number_differences(metadata, key, saved, configured(entity, gain, saved))
  if all(hasattr(term, "scale") for term in terms):
    scale = [value for term in terms for value in term.scale.expand(1, len(term.target_names)).flatten().tolist()]
    yield from _number_differences(metadata, "action_scale", targets, scale)


def _observation_differences(metadata: Mapping[str, str], env: Any, groups: Sequence[str]) -> Iterator[str]:
  layout_of = getattr(getattr(env, "observation_manager", None), "layout", None)
  if layout_of is None:
    return
  layouts = [layout for group in groups for layout in layout_of(group)]
  names = [layout.name for layout in layouts]
  differences = list(_name_differences(metadata, "observation_names", names))
  yield from differences
  if differences:
    return
  flat = [len(layout.shape) == len(layout.frame_shape) for layout in layouts]
  for key, values in (
    ("observation_terms_scale", [1.0 if layout.scale is None else layout.scale for layout in layouts]),
    ("observation_terms_history_length", [layout.history_length for layout in layouts]),
    ("observation_terms_flatten_history_dim", flat),
    ("observation_terms_clip", [layout.clip for layout in layouts]),
  ):
    if key not in metadata:
      continue
    saved = _values(metadata, key)
    if len(saved) != len(names):
      yield f"{key}: {len(saved)} values in the file for {len(names)} observation terms"
      continue
    for name, theirs, ours, layout in zip(names, saved, values, layouts, strict=True):
      if key.endswith("flatten_history_dim") and layout.history_length < 2:
        continue
      if key.endswith("history_length"):
        # A history of one is none.
        theirs, ours = [max(value or 0.0, 1.0) for value in theirs], max(ours, 1)
      if not _close(theirs, ours, none=1.0 if key.endswith("scale") else None):
        yield f"{key}: '{name}' has {_shown(theirs)} in the file and {_shown(ours)} here"


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
  metadata: Mapping[str, str], key: str, names: Sequence[str], ours: Sequence[float | None]
) -> Iterator[str]:
  if key not in metadata:
    return
  saved = _values(metadata, key)
  if len(saved) == 1:
    saved = saved * len(names)
  if len(saved) != len(names) or len(ours) != len(names):
    yield f"{key}: {len(saved)} values in the file for {len(names)} joints"
    return
  for name, theirs, value in zip(names, saved, ours, strict=True):
    if value is not None and not _close(theirs, value):
      yield f"{key}: '{name}' has {_shown(theirs)} in the file and {_shown(value)} here"


def _names(metadata: Mapping[str, str], key: str) -> list[str] | None:
  if key not in metadata:
    return None
  return [name.strip() for name in metadata[key].split(",") if name.strip()]


def _values(metadata: Mapping[str, str], key: str) -> list[list[float | None]]:
  """Return the items of a list, each as a list of numbers."""
  text = metadata[key].strip()
  items = text.split(";") if ";" in text else text.split(",")
  words = {"none": None, "": None, "true": 1.0, "false": 0.0}
  try:
    return [
      [words[w] if (w := word.strip(" ()[]").lower()) in words else msgspec.convert(w, float, strict=False)
       for word in item.split(",")]
      for item in items
    ]  # fmt: skip
  except msgspec.ValidationError as error:
    raise FileError(f"metadata {key!r} has a value that is not a number: {printable(text, 80)}") from error


def _close(theirs: Sequence[float | None], ours: Any, none: float | None = None) -> bool:
  values = list(ours) if isinstance(ours, (tuple, list)) else [ours]
  saved = [none if value is None else value for value in theirs]
  if len(saved) == 1 and len(values) > 1:
    saved = saved * len(values)
  elif len(values) == 1 and len(saved) > 1:
    values = values * len(saved)
  return len(saved) == len(values) and all(
    a == b or (a is not None and b is not None and abs(a - b) <= _ABSOLUTE + _RELATIVE * abs(b))
    for a, b in zip(saved, values, strict=True)
  )


def _listed(names: Sequence[str]) -> str:
  shown = ", ".join(printable(name, 60) for name in names[:4])
  return shown + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _shown(values: Any) -> str:
  if isinstance(values, (tuple, list)):
    return ", ".join(map(_shown, values))
  return f"{values:.4g}" if isinstance(values, (int, float)) else str(values)
