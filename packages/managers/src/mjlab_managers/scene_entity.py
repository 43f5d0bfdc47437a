"""Selecting joints, bodies, geoms, sites and actuators of an entity by name."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar

import torch
from mjlab_core.names import match_names, unknown

from mjlab_managers.env import SceneLike

Selection = str | int | Sequence[str] | Sequence[int] | None
"""Patterns that match whole names, indices inside the entity, or None for everything."""

Index = slice | torch.Tensor
"""What indexes a tensor: a slice where the selection is contiguous (a view), else an int64 tensor on the device."""

KINDS = ("joint", "body", "geom", "site", "actuator")


@dataclass
class SceneEntityCfg:
  """An entity of the scene, and which of its elements a term is about.

  A config as the user writes it is unresolved. The managers hand terms a resolved copy, in which `<kind>_ids` index the
  entity's arrays and `<kind>_names` are the selected names, a tuple, in the same order. Beside a ball joint, whose
  position has four columns, joints can only be selected all together.
  """

  name: str
  _: KW_ONLY
  joint_names: Selection = None
  body_names: Selection = None
  geom_names: Selection = None
  site_names: Selection = None
  actuator_names: Selection = None
  preserve_order: bool = False
  """True: in the order of the patterns; False: in the order of the model."""

  _ids: ClassVar[dict[str, Index] | None] = None

  @property
  def joint_ids(self) -> Index:
    """Selected joints, (num_selected,)."""
    return self._index("joint")

  @property
  def body_ids(self) -> Index:
    """Selected bodies, (num_selected,)."""
    return self._index("body")

  @property
  def geom_ids(self) -> Index:
    """Selected geoms, (num_selected,)."""
    return self._index("geom")

  @property
  def site_ids(self) -> Index:
    """Selected sites, (num_selected,)."""
    return self._index("site")

  @property
  def actuator_ids(self) -> Index:
    """Selected actuators, (num_selected,)."""
    return self._index("actuator")

  @property
  def resolved(self) -> bool:
    """Whether this is a copy that a manager has resolved."""
    return self._ids is not None

  def resolve(self, scene: SceneLike, device: torch.device | str) -> SceneEntityCfg:
    """A resolved copy; this config stays as it is.

    Raises:
      ValueError: no such entity, a pattern matches nothing or two match one name, an index out of range or twice, an
        empty selection, or some of several joints one of which is a ball joint.
    """
    if self.name not in scene.entities:
      raise ValueError(unknown("entity", self.name, list(scene.entities), owner="scene"))
    entity = scene[self.name]
    resolved = copy.copy(self)
    ids: dict[str, Index] = {}
    for kind in KINDS:
      names = getattr(entity, f"{kind}_names", None)
      selection = getattr(self, f"{kind}_names")
      if names is None:
        if selection is not None:
          raise ValueError(f"entity '{self.name}': has no {kind}s to select from.")
        continue
      picked = _select(selection, tuple(names), kind, f"entity '{self.name}'", self.preserve_order)
      ids[kind] = _collapse(picked, len(names), device)
      wide = getattr(entity, "wide_joints", ()) if kind == "joint" else ()
      if wide and ids[kind] != slice(None):
        chosen = ", ".join(names[i] for i in picked)
        raise ValueError(
          f"entity '{self.name}': joint '{wide[0]}' has several columns, so ids of joints would select wrong ones; "
          f"select all joints instead of {chosen}, or read theirs by `indexing.q_of_joint` in a term of your own."
        )
      setattr(resolved, f"{kind}_names", tuple(names[i] for i in picked))
    # Not a field: what a user writes, saves and compares has no ids.
    vars(resolved)["_ids"] = ids
    return resolved

  def _index(self, kind: str) -> Index:
    if self._ids is None:
      raise RuntimeError(
        f"SceneEntityCfg({self.name!r}).{kind}_ids: not resolved. Pass it to a term through `params` (also nested in "
        "lists, dicts and dataclasses) or as a default argument, or call `resolve(scene, device)`."
      )
    if kind not in self._ids:
      raise RuntimeError(f"SceneEntityCfg({self.name!r}).{kind}_ids: entity '{self.name}' has no {kind}s.")
    return self._ids[kind]


def _select(selection: Any, names: tuple[str, ...], kind: str, owner: str, preserve_order: bool) -> list[int]:
  if selection is None:
    return list(range(len(names)))
  if isinstance(selection, torch.Tensor):
    selection = selection.tolist()
  if isinstance(selection, slice):
    selection = list(range(*selection.indices(len(names))))
  items: list[Any] = [selection] if isinstance(selection, str | int) else list(selection)
  if not items:
    raise ValueError(f"{owner}: empty selection of {kind}s. Use None for all of them: {', '.join(names)}.")
  if all(isinstance(item, str) for item in items):
    return match_names(items, names, what=kind, owner=owner, preserve_order=preserve_order)[0]
  if not all(isinstance(item, int) and not isinstance(item, bool) for item in items):
    raise ValueError(f"{owner}: {kind}s are selected by patterns or by indices, got {selection!r}.")
  for item in items:
    if not 0 <= item < len(names):
      raise ValueError(f"{owner}: {kind} index {item} is outside 0..{len(names) - 1}.")
  if len(set(items)) != len(items):
    raise ValueError(f"{owner}: {kind} indices {items} name one twice.")
  return items if preserve_order else sorted(items)


def _collapse(picked: list[int], total: int, device: torch.device | str) -> Index:
  if picked == list(range(total)):
    return slice(None)
  if picked == list(range(picked[0], picked[0] + len(picked))):
    return slice(picked[0], picked[-1] + 1)
  return torch.tensor(picked, dtype=torch.int64, device=device)
