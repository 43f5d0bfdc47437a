"""Contact presets: the geoms of an entity that collide, and their contact parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import mujoco
from mjlab_core import Config, Items, Limits, NonNegative, check_fields, match_names, match_values_full

Bits = Annotated[int, Limits(ge=0)]
Condim = Annotated[int, Limits(ge=1, le=6)]
Share = Annotated[float, Limits(ge=0, le=1)]
Friction = Annotated[tuple[NonNegative, ...], Items(le=3)]
Solref = Annotated[tuple[float, ...], Items(le=mujoco.mjNREF)]
Solimp = Annotated[tuple[float, ...], Items(le=mujoco.mjNIMP)]


@dataclass(kw_only=True)
class CollisionCfg(Config):
  """Contact parameters of the geoms whose names match.

  Each parameter is one value for all matched geoms, or a dict from pattern to value; geoms that no pattern matches keep
  the value of the model. None leaves a parameter unchanged. A vector shorter than MuJoCo's sets its leading elements.
  """

  geom_names_expr: str | tuple[str, ...]
  """Patterns; each must match at least one geom of the entity."""
  contype: Bits | Mapping[str, Bits] = 1
  conaffinity: Bits | Mapping[str, Bits] = 1
  condim: Condim | Mapping[str, Condim] = 3
  priority: int | Mapping[str, int] = 0
  friction: Friction | Mapping[str, Friction] | None = None
  """Sliding [1], torsional [m] and rolling [m] friction."""
  solref: Solref | Mapping[str, Solref] | None = None
  solimp: Solimp | Mapping[str, Solimp] | None = None
  margin: NonNegative | Mapping[str, NonNegative] | None = None
  """Distance at which a contact becomes active [m]."""
  gap: NonNegative | Mapping[str, NonNegative] | None = None
  """Additional distance at which a contact is detected [m]."""
  solmix: Share | Mapping[str, Share] | None = None
  disable_other_geoms: bool = True
  """True: geoms of the entity that no preset names do not collide."""


_PARAMETERS = "contype conaffinity condim priority margin gap solmix friction solref solimp".split()


def apply_collisions(spec: mujoco.MjSpec, presets: Sequence[CollisionCfg], owner: str) -> None:
  """Write `presets` into `spec` in order; presets compose, and none disables the geoms of another.

  Raises:
    MjlabError: A pattern matches no geom, or MuJoCo does not accept a value.
  """
  geoms = {geom.name: geom for geom in spec.geoms}
  touched: set[str] = set()
  for preset in presets:
    check_fields(preset, f"{owner}, CollisionCfg {preset.geom_names_expr!r}")
    _, matched = match_names(preset.geom_names_expr, list(geoms), what="geom", owner=owner)
    touched.update(matched)
    for name in _PARAMETERS:
      values = match_values_full(getattr(preset, name), matched, what="geom", owner=f"{owner}, {name}", default=None)
      for geom, value in zip(matched, values, strict=True):
        if isinstance(value, Sequence):
          getattr(geoms[geom], name)[: len(value)] = value
        elif value is not None:
          setattr(geoms[geom], name, value)
  if any(preset.disable_other_geoms for preset in presets):
    for name, geom in geoms.items():
      if name not in touched:
        geom.contype = 0
        geom.conaffinity = 0
