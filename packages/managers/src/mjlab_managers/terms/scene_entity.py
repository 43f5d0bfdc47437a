"""Selection of joints, bodies, geoms, sites, actuators and tendons of an entity by name."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any, ClassVar

import torch
from mjlab_core import Config, Index, Items, Limits, MjlabError, as_index, check_value, match_names, unknown
from mjlab_core.errors import as_consequence

from mjlab_managers.env import ManagerEnv

Selection = str | int | Sequence[str] | Sequence[int] | None
"""Patterns that match whole names, indices inside the entity, or None for all."""

KINDS = ("joint", "body", "geom", "site", "actuator", "tendon")


def _indices(kind: str) -> Any:
  """Return a property with the indices of selected elements, which only a resolved config has."""

  def ids(self: SceneEntityCfg) -> Index:
    return self._index(kind)

  return property(ids)


@dataclass
class SceneEntityCfg(Config):
  """Entity of the scene, and the elements of it that a term uses.

  The config of a user is unresolved. Managers pass a resolved copy to terms. In this copy, `<kind>_ids` are
  indices into the arrays of the entity, and `<kind>_names` is a tuple of the selected names in the same order. Terms
  index joint positions by `joint_pos_ids` and joint velocities by `joint_vel_ids`, also for entities with a ball joint,
  which has four columns of position and three of velocity.
  """

  name: str
  _: KW_ONLY
  joint_names: Selection = None
  body_names: Selection = None
  geom_names: Selection = None
  site_names: Selection = None
  actuator_names: Selection = None
  tendon_names: Selection = None
  preserve_order: bool = False
  """True: order of the patterns; False: order of the model."""

  _ids: ClassVar[dict[str, Index | str] | None] = None

  joint_ids = _indices("joint")
  """Selected joints, (num_selected,); refused for some joints of an entity with a ball joint."""
  joint_pos_ids = _indices("joint_pos")
  """Columns of the selected joints in positions, targets and limits."""
  joint_vel_ids = _indices("joint_vel")
  """Columns of the selected joints in velocities, accelerations and forces."""
  body_ids = _indices("body")
  """Selected bodies, (num_selected,)."""
  geom_ids = _indices("geom")
  """Selected geoms, (num_selected,)."""
  site_ids = _indices("site")
  """Selected sites, (num_selected,)."""
  actuator_ids = _indices("actuator")
  """Selected actuators, (num_selected,)."""
  tendon_ids = _indices("tendon")
  """Selected tendons, (num_selected,)."""

  @property
  def resolved(self) -> bool:
    """True for a resolved copy."""
    return self._ids is not None

  def resolve(self, scene: Any, device: torch.device | str) -> SceneEntityCfg:
    """Return a resolved copy. This config does not change.

    Raises:
      ValueError: no such entity, a pattern matches nothing, two patterns match one name, an index is out of range or
        given twice, or the selection is empty.
    """
    if self.name not in scene.entities:
      error = MjlabError(unknown("entity", self.name, list(scene.entities), owner="scene"))
      raise as_consequence(error) if self.name in getattr(scene, "missing", ()) else error
    entity = scene[self.name]
    resolved = copy.copy(self)
    # A text is the reason why there are no ids.
    ids: dict[str, Any] = {}
    for kind in KINDS:
      names = getattr(entity, f"{kind}_names", None)
      selection = getattr(self, f"{kind}_names")
      if names is None:
        continue
      picked = _select(selection, tuple(names), kind, f"entity '{self.name}'", self.preserve_order)
      ids[kind] = slice(None) if picked == list(range(len(names))) else as_index(picked, device)
      if kind == "joint":
        ids["joint_pos"] = ids["joint_vel"] = ids[kind]
        if (wide := getattr(entity, "wide_joints", ())) and ids[kind] != slice(None):
          ids["joint_pos"], ids["joint_vel"] = (as_index(columns, device) for columns in entity.joint_columns(picked))
          ids["joint"] = (
            f"joint '{wide[0]}' has several columns, so ids of some joints would select wrong ones; use joint_pos_ids "
            "for positions and joint_vel_ids for velocities."
          )
      setattr(resolved, f"{kind}_names", tuple(names[i] for i in picked))
    # Not a field: ids are not saved or compared.
    vars(resolved)["_ids"] = ids
    return resolved

  def _index(self, kind: str) -> Index:
    unresolved = (
      "not resolved. Pass it to a term through `params` (also nested in lists, dicts and dataclasses) or as a default "
      "argument, or call `resolve(scene, device)`."
    )
    index = unresolved if self._ids is None else self._ids[kind]
    if isinstance(index, str):
      raise MjlabError(f"SceneEntityCfg({self.name!r}).{kind}_ids: {index}")
    return index


def _select(selection: Any, names: tuple[str, ...], kind: str, owner: str, preserve_order: bool) -> list[int]:
  if selection is None:
    return list(range(len(names)))
  items: list[Any] = [selection] if isinstance(selection, str | int) else list(selection)
  if items and all(isinstance(item, str) for item in items):
    return match_names(items, names, what=kind, owner=owner, preserve_order=preserve_order)[0]
  distinct = Annotated[tuple[int, ...], Limits(ge=0, le=len(names) - 1), Items(unique=True)]
  check_value(f"{owner}: {kind} indices", items, distinct)
  return items if preserve_order else sorted(items)


def resolve_entities(value: Any, env: ManagerEnv) -> Any:
  """Return `value` with every SceneEntityCfg in it resolved. A container is copied only if a value in it changed."""
  if isinstance(value, SceneEntityCfg):
    return value if value.resolved else value.resolve(env.scene, env.device)
  parts: dict[Any, Any]
  if isinstance(value, dict):
    parts = value
  elif isinstance(value, list | tuple):
    parts = dict(enumerate(value))
  elif dataclasses.is_dataclass(value) and not isinstance(value, type):
    parts = {item.name: getattr(value, item.name) for item in dataclasses.fields(value)}
  else:
    return value
  resolved = {key: resolve_entities(part, env) for key, part in parts.items()}
  changed = {key: part for key, part in resolved.items() if part is not parts[key]}
  if not changed:
    return value
  if isinstance(value, dict):
    return resolved
  return type(value)(resolved.values()) if isinstance(value, list | tuple) else dataclasses.replace(value, **changed)
