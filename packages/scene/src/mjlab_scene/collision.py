"""Contact presets: which geoms of an entity collide, and how."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
from mjlab_core.names import match_names, match_values

_VECTOR_SIZE = {"friction": 3, "solref": mujoco.mjNREF, "solimp": mujoco.mjNIMP}
_SCALARS = ("contype", "conaffinity", "condim", "priority", "margin", "gap", "solmix")
_ALLOWED = {"condim": "1, 3, 4 or 6", "solmix": "in [0, 1]"}


@dataclass(kw_only=True)
class CollisionCfg:
  """Sets contact parameters of the geoms whose names match.

  Each parameter is one value for all matched geoms or a dict from pattern to value; a geom that no pattern of a dict
  names keeps what the model says. None leaves a parameter alone. A vector shorter than MuJoCo's sets its leading
  elements only.
  """

  geom_names_expr: str | tuple[str, ...]
  """Patterns; each must match at least one geom of the entity."""
  contype: int | Mapping[str, int] = 1
  conaffinity: int | Mapping[str, int] = 1
  condim: int | Mapping[str, int] = 3
  priority: int | Mapping[str, int] = 0
  friction: tuple[float, ...] | Mapping[str, tuple[float, ...]] | None = None
  """Sliding [1], torsional [m] and rolling [m] friction."""
  solref: tuple[float, ...] | Mapping[str, tuple[float, ...]] | None = None
  solimp: tuple[float, ...] | Mapping[str, tuple[float, ...]] | None = None
  margin: float | Mapping[str, float] | None = None
  """Distance at which a contact becomes active [m]."""
  gap: float | Mapping[str, float] | None = None
  """Additional distance at which a contact is detected [m]."""
  solmix: float | Mapping[str, float] | None = None
  disable_other_geoms: bool = True
  """Geoms of the entity that none of its presets names do not collide."""


def apply_collisions(spec: mujoco.MjSpec, presets: Sequence[CollisionCfg], owner: str) -> None:
  """Write `presets` into `spec` in order; presets compose, one never disables the geoms of another.

  Raises:
    ValueError: a pattern matches no geom, or a value is not one that MuJoCo accepts.
  """
  geoms = {geom.name: geom for geom in spec.geoms}
  touched: set[str] = set()
  for preset in presets:
    _, matched = match_names(preset.geom_names_expr, list(geoms), what="geom", owner=owner)
    touched.update(matched)
    for attribute in (*_SCALARS, *_VECTOR_SIZE):
      setting = getattr(preset, attribute)
      if setting is None:
        continue
      if isinstance(setting, Mapping):
        _, names, values = match_values(setting, matched, what="geom", owner=f"{owner}, {attribute}")
      else:
        names, values = matched, [setting] * len(matched)
      for name, value in zip(names, values, strict=True):
        _set(geoms[name], attribute, value, owner)
  if any(preset.disable_other_geoms for preset in presets):
    for name, geom in geoms.items():
      if name not in touched:
        geom.contype = 0
        geom.conaffinity = 0


def _set(geom: mujoco.MjsGeom, attribute: str, value: float | Sequence[float], owner: str) -> None:
  where = f"{owner}, geom '{geom.name}': {attribute} {value!r}"
  if attribute in _VECTOR_SIZE:
    size = _VECTOR_SIZE[attribute]
    if not isinstance(value, Sequence) or not 1 <= len(value) <= size:
      raise ValueError(f"{where} must be 1 to {size} numbers")
    if attribute == "friction" and min(value) < 0:
      raise ValueError(f"{where} must not be negative")
    getattr(geom, attribute)[: len(value)] = value
    return
  if not isinstance(value, int | float):
    raise ValueError(f"{where} must be one number")
  accepted = (
    value in (1, 3, 4, 6)
    if attribute == "condim"
    else 0 <= value <= 1
    if attribute == "solmix"
    else True
    if attribute == "priority"
    else value >= 0
  )
  if not accepted:
    raise ValueError(f"{where} must be {_ALLOWED.get(attribute, 'at least 0')}")
  setattr(geom, attribute, value)
