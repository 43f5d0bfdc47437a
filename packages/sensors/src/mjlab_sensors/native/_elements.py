"""Names of the elements of a scene's spec, and their selection by name or pattern."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
from mjlab_core import Config, MjlabError, UnknownNameError, check_fields, check_name, match_names

# MuJoCo's "xbody" is a body seen at its frame instead of its centre of mass; a subtree is named by its root body.
_LISTS = {"body": "bodies", "xbody": "bodies", "subtree": "bodies", "mesh": "meshes"}


def names_of(spec: mujoco.MjSpec, kind: str) -> list[str]:
  """Return the full names of all named elements of a kind, in the order of the spec."""
  return [element.name for element in getattr(spec, _LISTS.get(kind, f"{kind}s")) if element.name]


def names_within(
  spec: mujoco.MjSpec, entities: Mapping[str, Any], kind: str, entity: str | None, owner: str
) -> tuple[str, list[str]]:
  """Return an entity's prefix, and the names of its elements without it; without an entity, those of all elements.

  Raises:
    UnknownNameError: the entity does not exist; the message names the nearest.
  """
  prefix = "" if entity is None else check_name("entity", entity, entities, owner) + "/"
  return prefix, [name.removeprefix(prefix) for name in names_of(spec, kind) if name.startswith(prefix)]


def add_sensor(spec: mujoco.MjSpec, owner: str, name: str, **fields: Any) -> Any:
  """Add a native sensor to the spec, and return it.

  Raises:
    MjlabError: the spec has a sensor of this name.
  """
  if name in names_of(spec, "sensor"):
    raise MjlabError(f"{owner}: the scene already has a sensor element {name!r}; choose another name, or read that one")
  return spec.add_sensor(name=name, **fields)


@dataclass(kw_only=True, frozen=True)
class ElementMatch(Config):
  """Elements of the scene, by patterns."""

  pattern: str | tuple[str, ...]
  """Whole regular expressions over the names of the entity's own elements, or over full names without an entity."""
  entity: str | None = None
  """Entity that the elements belong to."""
  exclude: str | tuple[str, ...] = ()
  """Patterns, under the same rule, of elements to leave out again."""
  preserve_order: bool = False
  """Order the elements as the patterns are, instead of as they come in the model."""

  def __post_init__(self) -> None:
    check_fields(self, f"{type(self).__name__} {self.pattern!r}")

  def names_in(self, spec: mujoco.MjSpec, entities: Mapping[str, Any], kind: str, owner: str) -> tuple[str, ...]:
    """Return the full names of the elements of a kind.

    Raises:
      UnknownNameError: unknown entity, a pattern (of `exclude` too) that matches nothing, or nothing left.
    """
    prefix, candidates = names_within(spec, entities, kind, self.entity, owner)
    _, names = match_names(self.pattern, candidates, what=kind, owner=owner, preserve_order=self.preserve_order)
    _, dropped = match_names(self.exclude, candidates, what=f"excluded {kind}", owner=owner)
    if not (kept := tuple(prefix + name for name in names if name not in dropped)):
      raise UnknownNameError(f"{owner}: no {kind} is left of pattern {self.pattern!r}, exclude {self.exclude!r}")
    return kept
