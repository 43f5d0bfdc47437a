"""Parameters to fit: patterns over the catalogue of mjlab-dr, with bounds that are their priors."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from mjlab_core.constraints import require
from mjlab_core.errors import MjlabError
from mjlab_core.names import check_name
from mjlab_dr import FIELDS, Operation

ALIASES = {"armature": "dof_armature", "frictionloss": "dof_frictionloss", "viscous_damping": "dof_damping"}
"""Rows of the catalogue by their names in actuator configs."""

Range = tuple[Operation, float, float]
"""Operation on the compiled value, and bounds of its operand."""

FACTOR: Range = ("scale", 0.25, 4.0)
"""Default bounds of a factor."""

_OFFSETS: dict[str, Range] = {
  "delay": ("absolute", 0.0, 0.04),
  "encoder_bias": ("absolute", -0.1, 0.1),
  "qpos0": ("add", -0.1, 0.1),
  "body_ipos": ("add", -0.05, 0.05),
}
_INERTIA = {"alpha": 0.7, "d": 0.3, "s": 0.3, "t": 0.05}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_PATTERN = re.compile(
  r"(?P<field>[a-z_0-9.]+?)(\.(?P<axis>[a-zA-Z_0-9]+))?:(?P<pattern>.+?)"
  rf"(=(?P<lo>{_NUMBER})\.\.(?P<hi>{_NUMBER}))?(?P<shared>,shared)?"
)


@dataclass(frozen=True, kw_only=True)
class FitTerm:
  """One row of the catalogue for the elements that a pattern matches."""

  field: str
  """Name of the row."""
  pattern: str
  """Regular expression of the elements' whole names."""
  axis: str | None = None
  """Name of the axis; None for all."""
  range: Range | None = None
  """Operation and bounds; None for those of the task's randomisation, or the defaults."""
  shared: bool = False
  """One value for all elements."""

  def bounds(self, ranges: Mapping[str, Range]) -> dict[str, Range]:
    """Return operation and bounds by axis.

    Args:
      ranges: Ranges of the task's randomisation by field.
    """
    row = FIELDS[self.field]
    axes = row.axes if self.axis is None else (self.axis,)
    if self.range is not None:
      return dict.fromkeys(axes, self.range)
    if self.field == "pseudo_inertia":
      sizes = {axis: _INERTIA[re.sub(r"\d", "", axis)] for axis in axes}
      return {axis: ("add", -size, size) for axis, size in sizes.items()}
    if self.field == "geom_friction" and self.axis is None:
      axes = ("sliding",)
    if self.field in ranges:
      return dict.fromkeys(axes, ranges[self.field])
    return dict.fromkeys(axes, _OFFSETS.get(self.field, FACTOR))


def parse_term(text: str) -> FitTerm:
  """Return the term that a text describes: `FIELD[.AXIS]:PATTERN[=LO..HI][,shared]`.

  Bounds in the text are of the value itself, or of the shift for fields that are shifted, such as positions.

  Raises:
    MjlabError: The text has another form, or the bounds are inverted.
    UnknownNameError: The field or its axis does not exist.
  """
  expected = f"fit {text!r}: expected FIELD[.AXIS]:PATTERN[=LO..HI][,shared], such as armature:.*_calf_joint"
  match = require(_PATTERN.fullmatch(text), re.Match, expected)
  field, axis = match["field"], match["axis"]
  if field == "opt" and axis:
    field, axis = f"opt.{axis}", None
  field = ALIASES.get(field, field)
  check_name("field", field, [*FIELDS, *ALIASES], owner=f"fit {text!r}")
  row = FIELDS[field]
  if axis is not None:
    check_name("axis", axis, row.axes, owner=f"fit {text!r}")
  if row.integer and field != "delay":
    raise MjlabError(f"fit {text!r}: it is a choice, which cannot be fitted")
  if row.kind in ("camera", "light", "material") or field in ("geom_rgba", "opt.timestep"):
    raise MjlabError(f"fit {text!r}: it does not act on the motion of a robot")
  range_: Range | None = None
  if match["lo"] is not None:
    lo, hi = float(match["lo"]), float(match["hi"])
    if not lo < hi:
      raise MjlabError(f"fit {text!r}: bounds {lo:g}..{hi:g} must rise")
    range_ = ("add" if row.operation == "add" else "absolute", lo, hi)
  return FitTerm(field=field, axis=axis, pattern=match["pattern"], range=range_, shared=bool(match["shared"]))


@dataclass(frozen=True, kw_only=True)
class Parameter:
  """One number to fit."""

  name: str
  """Field, axis and elements: "dof_armature:FR_calf_joint"."""
  field: str
  """Row of the catalogue."""
  axis: str
  """Axis of the row; empty for a scalar."""
  elements: tuple[str, ...]
  """Names of the elements; several if they share the value."""
  operation: Operation
  """Relation of the fitted number to the compiled value."""
  defaults: tuple[float, ...]
  """Compiled value of each element."""
  start: float
  """Prior of the fitted number, where the fit begins."""
  lo: float
  """Lower bound of the fitted number."""
  hi: float
  """Upper bound of the fitted number."""

  def value(self, number: float, place: int = 0) -> float:
    """Return the physical value of the element at `place` for a fitted number; for `pseudo_inertia`, the number."""
    if self.field == "pseudo_inertia" or self.operation == "absolute":
      return number
    default = self.defaults[place]
    return default * number if self.operation == "scale" else default + number

  @property
  def half(self) -> float:
    """Half the width of the bounds."""
    return 0.5 * (self.hi - self.lo)
