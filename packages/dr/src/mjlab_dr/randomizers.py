"""Randomisers: plain configs of a field, its elements and their distributions, checked when they are made."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Literal, TypedDict, Unpack, cast, get_args

from mjlab_core import ConfigError, MjlabError, check_name, unknown

from mjlab_dr.catalogue import FIELDS, written_fields
from mjlab_dr.distributions import Categorical, Distribution, Gaussian, LogUniform, Uniform
from mjlab_dr.fields import Field, Operation

DistributionName = Literal["uniform", "log_uniform", "gaussian"]
Values = tuple[float, float] | Distribution
ByAxis = Mapping[int, Values] | Mapping[str, Values]

_BY_NAME: dict[str, Callable[..., Distribution]] = {
  "uniform": Uniform,
  "log_uniform": LogUniform,
  "gaussian": Gaussian,
}


@dataclass(frozen=True, kw_only=True)
class FieldRandomizer:
  """Draw of new values of one field for the elements that a pattern selects, from the compiled default every time.

  Raises:
    MjlabError: an unknown field, operation or axis, or an impossible distribution; the message names all.
  """

  field: str
  """Name of a row of the catalogue."""

  pattern: str | tuple[str, ...]
  """Regular expressions that select elements by their whole name."""

  values: Mapping[int, Distribution]
  """Distribution of each axis that is written; the other axes keep their values."""

  operation: Operation = "absolute"
  """Effect of a draw: it replaces the default, is added to it, or multiplies it."""

  shared: bool = False
  """True if all elements of a world share one draw."""

  isotropic: bool = False
  """True if all axes of an element share one draw; their distributions must be equal."""

  every_axis: bool = False
  """True if no axes were chosen: all are drawn, and those without effect are left out rather than refused."""

  def __post_init__(self) -> None:
    if problems := list(self._problems()):
      raise ConfigError(*problems)

  def _problems(self) -> Iterator[str]:
    label, operation = self.label, self.operation
    if self.field not in FIELDS:
      yield unknown("field", self.field, FIELDS, owner="randomizer")
      return
    field = self.row
    only = "add" if field.form in ("rotation", "pseudo_inertia") else "absolute" if field.integer else operation
    if operation not in get_args(Operation):
      yield unknown("operation", operation, get_args(Operation), owner=label)
    elif operation != only:
      yield f"{label}: operation {operation!r} is not possible; use {only!r}."
    elif field.form == "intrinsics" and operation == "add":
      yield f"{label}: 'add' can make a focal length negative; use 'scale' or 'absolute'."
    if not self.pattern:
      yield f"{label}: no pattern is given."
    if not self.values:
      yield f"{label}: no axis is given values. Axes: {', '.join(field.axes)}."
    for axis, distribution in self.values.items():
      if axis not in range(len(field.axes)):
        yield f"{label}: axis {axis} does not exist; there are {len(field.axes)}, from 0."
      else:
        yield from self._axis_problems(f"{label} {field.axes[axis]}".rstrip(), distribution)
    if self.isotropic and len(set(map(repr, self.values.values()))) > 1:
      yield f"{label}: isotropic means one draw for all axes, but they have different distributions."

  def _axis_problems(self, name: str, distribution: Distribution) -> Iterator[str]:
    field = self.row
    if isinstance(distribution, type) or not hasattr(distribution, "sample"):
      yield f"{name}: {distribution!r} is neither two numbers, (lo, hi), nor a distribution."
      return
    try:
      distribution.check(name)
    except ValueError as error:
      yield str(error)
      return
    if isinstance(distribution, Categorical) and distribution.has_names and not field.integer:
      yield f"{name}: names are for what is chosen among named things, got {distribution.values}."
    if field.integer and not isinstance(distribution, Categorical):
      yield f"{name} is a choice: give a Categorical."

  @property
  def row(self) -> Field:
    """Row of the catalogue."""
    return FIELDS[self.field]

  @property
  def label(self) -> str:
    """Name in messages."""
    return f"{self.field} {self.pattern!r}"

  @property
  def patterns(self) -> tuple[str, ...]:
    """All patterns."""
    return (self.pattern,) if isinstance(self.pattern, str) else self.pattern

  @property
  def shown_in(self) -> str:
    """Field in which a draw can be read as it was made."""
    return written_fields(self.field)[0]

  @property
  def composes(self) -> bool:
    """True if it may start from the result of another randomiser."""
    field = self.row
    if field.form != "plain":
      return field.form == "pseudo_inertia"
    if field.ordered or field.integer or self.field == "body_inertia" or "timeconst" in field.axes:
      return False
    bounds = {bound for axis in self.values for bound in field.bounds(axis)}
    return bounds <= {-math.inf, math.inf, *((0.0,) if self.operation == "scale" else ())} and (
      self.operation != "absolute"
    )


def randomize_field(
  field: str,
  pattern: str | Sequence[str],
  values: Values | ByAxis,
  *,
  axes: int | str | Sequence[int | str] | None = None,
  operation: Operation | None = None,
  distribution: DistributionName = "uniform",
  shared: bool = False,
  isotropic: bool = False,
) -> FieldRandomizer:
  """Return a randomiser of any field of the catalogue.

  Args:
    field: name of the field.
    pattern: regular expressions that select elements by their whole name; options are one element, `".*"`.
    values: a pair, a `Distribution`, or a mapping from axes, by number or name, to these. A pair is (lo, hi), or
      (mean, std) for "gaussian".
    axes: the axes that unmapped `values` apply to; None is all.
    operation: effect of a draw on the compiled default; None is the default of the field.
    distribution: meaning of pairs.
    shared: one draw for all elements of a world.
    isotropic: one draw for all axes of an element.

  Raises:
    MjlabError: a name that does not exist, or an impossible range.
  """
  pattern = pattern if isinstance(pattern, str) else tuple(pattern)
  label = f"{field} {pattern!r}"
  check_name("field", field, FIELDS, "randomizer")
  check_name("distribution", distribution, _BY_NAME, label)
  names = FIELDS[field].axes
  if isinstance(values, Mapping):
    if axes is not None:
      raise MjlabError(f"{label}: give either axes or values by axis, not both.")
    pairs: list[tuple[int | str, Values]] = list(values.items())
  else:
    axes = (axes,) if isinstance(axes, int | str) else axes
    pairs = [(axis, values) for axis in (range(len(names)) if axes is None else axes)]
  by_axis: dict[int, Distribution] = {}
  for axis, value in pairs:
    number = axis if isinstance(axis, int) else names.index(check_name("axis", axis, names, label))
    # Files give lists.
    if isinstance(value, Sequence) and len(value) == 2 and all(isinstance(x, Real) for x in value):
      value = _BY_NAME[distribution](*value)
    # The randomizer refuses anything else.
    by_axis[number] = cast(Distribution, value)
  return FieldRandomizer(
    field=field,
    pattern=pattern,
    values=by_axis,
    operation=FIELDS[field].operation if operation is None else operation,
    shared=shared,
    isotropic=isotropic,
    every_axis=axes is None and not isinstance(values, Mapping),
  )


class DrawOptions(TypedDict, total=False):
  """Options of `randomize_field` that its shorthands take too."""

  operation: Operation | None
  distribution: DistributionName
  shared: bool
  isotropic: bool


def geom_friction(
  pattern: str | Sequence[str],
  values: Values | ByAxis,
  *,
  axes: int | str | Sequence[int | str] | None = None,
  **options: Unpack[DrawOptions],
) -> FieldRandomizer:
  """Return a randomiser of the friction of geoms: sliding [1] by default, or also torsional and rolling [m].

  Between two geoms in contact, MuJoCo takes the friction of the one with the higher priority, or else the larger one.
  """
  if axes is None and not isinstance(values, Mapping):
    axes = (0,)
  return randomize_field("geom_friction", pattern, values, axes=axes, **options)


def body_mass(pattern: str | Sequence[str], values: Values, **options: Unpack[DrawOptions]) -> FieldRandomizer:
  """Return a randomiser of the mass of bodies [kg]. Inertia stays; `pseudo_inertia` changes both."""
  return randomize_field("body_mass", pattern, values, **options)


def body_com_offset(
  pattern: str | Sequence[str], values: Values | ByAxis, **options: Unpack[DrawOptions]
) -> FieldRandomizer:
  """Return a randomiser that shifts the centre of mass of bodies in the body frame, axes x, y, z [m].

  Mass, and inertia about the centre of mass, stay as they are.
  """
  return randomize_field("body_ipos", pattern, values, **options)


def pseudo_inertia(
  pattern: str | Sequence[str],
  *,
  scale: float | None = None,
  alpha: Values | None = None,
  d: Values | None = None,
  s: Values | None = None,
  t: Values | None = None,
  **options: Unpack[DrawOptions],
) -> FieldRandomizer:
  """Return a randomiser of mass, centre of mass and inertia of bodies, always physical; see `perturb_inertia`.

  Args:
    pattern: regular expressions that select bodies by their whole name.
    scale: shorthand for (-scale, scale) of `alpha`, `d` and `s`, as far as these are not given.
    alpha: mass and inertia are multiplied by e^(2 alpha).
    d: stretch of each body axis by e^d, about the body's origin.
    s: shear of each plane.
    t: shift of the centre of mass along each body axis [m].
    options: `distribution`, the meaning of pairs, and `shared`, True for one draw for all bodies of a world.

  Raises:
    MjlabError: nothing is given, or an impossible range.
  """
  around = None if scale is None else Uniform(-scale, scale)
  groups = {"alpha": alpha or around, "d": d or around, "s": s or around, "t": t}
  values = {axis: value for axis in FIELDS["pseudo_inertia"].axes if (value := groups[axis.rstrip("123")]) is not None}
  return randomize_field("pseudo_inertia", pattern, values, **options)


def encoder_bias(pattern: str | Sequence[str], values: Values, **options: Unpack[DrawOptions]) -> FieldRandomizer:
  """Return a randomiser of the encoder error of joints with one coordinate, reading minus truth [rad or m]."""
  return randomize_field("encoder_bias", pattern, values, **options)
