"""Names of the elements of a scene's spec: which exist, and which a pattern means."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import mujoco
from mjlab_core import NameMatchError, match_names, unknown

_ELEMENTS: dict[str, Callable[[mujoco.MjSpec], Iterable[Any]]] = {
  "body": lambda spec: spec.bodies,
  "joint": lambda spec: spec.joints,
  "geom": lambda spec: spec.geoms,
  "site": lambda spec: spec.sites,
  "actuator": lambda spec: spec.actuators,
  "tendon": lambda spec: spec.tendons,
  "camera": lambda spec: spec.cameras,
  "mesh": lambda spec: spec.meshes,
  "sensor": lambda spec: spec.sensors,
}

# MuJoCo's "xbody" is a body seen at its frame instead of its centre of mass; a subtree is named by its root body.
_BODY_KINDS = ("xbody", "subtree")


def names_of(spec: mujoco.MjSpec, kind: str) -> list[str]:
  """Full names of all named elements of a kind, in the order of the spec."""
  elements = _ELEMENTS["body" if kind in _BODY_KINDS else kind](spec)
  return [element.name for element in elements if element.name]


def _prefix(entity: str | None, entities: Mapping[str, Any], owner: str) -> str:
  if entity is None:
    return ""
  if entity not in entities:
    raise NameMatchError(unknown("entity", entity, list(entities), owner))
  return f"{entity}/"


def find_element(
  spec: mujoco.MjSpec, entities: Mapping[str, Any], kind: str, name: str, *, entity: str | None, owner: str
) -> str:
  """Full name of the one element called exactly `name`, within an entity where one is given.

  Raises:
    NameMatchError: there is no such entity or element; the message names the nearest.
  """
  prefix = _prefix(entity, entities, owner)
  candidates = [full.removeprefix(prefix) for full in names_of(spec, kind) if full.startswith(prefix)]
  if name not in candidates:
    raise NameMatchError(unknown(kind, name, candidates, owner))
  return prefix + name


def match_elements(
  spec: mujoco.MjSpec,
  entities: Mapping[str, Any],
  kind: str,
  patterns: str | Sequence[str],
  *,
  entity: str | None,
  exclude: str | Sequence[str] = (),
  preserve_order: bool = False,
  owner: str,
) -> list[str]:
  """Full names of the elements that the patterns match and `exclude` does not.

  Patterns are whole regular expressions. With an entity they are matched against the names of its own elements,
  without the entity's prefix; without one, against the full names of the scene.

  Raises:
    NameMatchError: unknown entity, a pattern (of `exclude` too) that matches nothing, or nothing left.
  """
  if not patterns:
    raise NameMatchError(f"{owner}: no pattern for a {kind} is given")
  prefix = _prefix(entity, entities, owner)
  candidates = [full.removeprefix(prefix) for full in names_of(spec, kind) if full.startswith(prefix)]
  _, names = match_names(patterns, candidates, what=kind, owner=owner, preserve_order=preserve_order)
  if exclude:
    dropped = set(match_names(exclude, candidates, what=f"excluded {kind}", owner=owner)[1])
    names = [name for name in names if name not in dropped]
    if not names:
      raise NameMatchError(f"{owner}: exclude {exclude!r} removes every {kind} that {patterns!r} matches")
  return [prefix + name for name in names]
