"""Names of the elements of a scene's spec, and their selection by name or pattern."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import mujoco
from mjlab_core import MjlabError, UnknownNameError, check_name, match_names

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
  """Return the full names of all named elements of a kind, in the order of the spec."""
  elements = _ELEMENTS["body" if kind in _BODY_KINDS else kind](spec)
  return [element.name for element in elements if element.name]


def _prefix(entity: str | None, entities: Mapping[str, Any], owner: str) -> str:
  return "" if entity is None else check_name("entity", entity, entities, owner) + "/"


def add_sensor(spec: mujoco.MjSpec, owner: str, name: str, **fields: Any) -> Any:
  """Add a native sensor to the spec, and return it.

  Raises:
    MjlabError: the spec has a sensor of this name.
  """
  if name in names_of(spec, "sensor"):
    raise MjlabError(f"{owner}: the scene already has a sensor element {name!r}; choose another name, or read that one")
  return spec.add_sensor(name=name, **fields)


def find_element(
  spec: mujoco.MjSpec, entities: Mapping[str, Any], kind: str, name: str, *, entity: str | None, owner: str
) -> str:
  """Return the full name of the element called exactly `name`, within an entity if one is given.

  Raises:
    UnknownNameError: the entity or element does not exist; the message names the nearest.
  """
  prefix = _prefix(entity, entities, owner)
  candidates = [full.removeprefix(prefix) for full in names_of(spec, kind) if full.startswith(prefix)]
  return prefix + check_name(kind, name, candidates, owner)


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
  """Return the full names of the elements that the patterns match and `exclude` does not.

  Patterns are whole regular expressions. With an entity they are matched against the names of its own elements,
  without the entity's prefix; without one, against the full names of the scene.

  Raises:
    UnknownNameError: unknown entity, a pattern (of `exclude` too) that matches nothing, or nothing left.
  """
  prefix = _prefix(entity, entities, owner)
  candidates = [full.removeprefix(prefix) for full in names_of(spec, kind) if full.startswith(prefix)]
  _, names = match_names(patterns, candidates, what=kind, owner=owner, preserve_order=preserve_order)
  if exclude:
    dropped = set(match_names(exclude, candidates, what=f"excluded {kind}", owner=owner)[1])
    names = [name for name in names if name not in dropped]
  if not names:
    raise UnknownNameError(f"{owner}: no {kind} is left of pattern {patterns!r}, exclude {exclude!r}")
  return [prefix + name for name in names]
