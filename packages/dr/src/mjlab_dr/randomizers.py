"""What to randomise, and how: plain configs that are checked when they are made."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from mjlab_core import unknown

from mjlab_dr.catalogue import FIELDS, Operation
from mjlab_dr.distributions import (
  Categorical,
  Distribution,
  Gaussian,
  LogUniform,
  Uniform,
  as_distribution,
  check_distribution,
)

DistributionName = Literal["uniform", "log_uniform", "gaussian"]
Values = tuple[float, float] | Distribution
ByAxis = Mapping[int, Values] | Mapping[str, Values]

_BY_NAME: dict[str, type[Uniform] | type[LogUniform] | type[Gaussian]] = {
  "uniform": Uniform,
  "log_uniform": LogUniform,
  "gaussian": Gaussian,
}


@dataclass(frozen=True, kw_only=True)
class FieldRandomizer:
  """Draws new values of one field for the elements that a pattern selects, from the compiled default every time.

  Raises:
    ValueError: an unknown field, operation or axis, or values outside of what is physical; the message names all.
  """

  field: str
  """Name of a row of the catalogue."""

  pattern: str | tuple[str, ...]
  """Which elements: regular expressions, each to match whole names."""

  values: Mapping[int, Distribution]
  """Distribution of each axis that is written; the other axes keep their values."""

  operation: Operation = "absolute"
  """Whether a draw replaces the default, is added to it, or multiplies it."""

  shared: bool = False
  """Whether all elements of a world get one draw instead of each its own."""

  isotropic: bool = False
  """Whether all axes of an element get one draw instead of each its own; all have the same distribution then."""

  every_axis: bool = False
  """Whether the axes are all that there are, so that one without effect is left out rather than refused."""

  def __post_init__(self) -> None:
    if self.field not in FIELDS:
      raise ValueError(unknown("field", self.field, FIELDS, owner="randomizer"))
    field = FIELDS[self.field]
    if self.operation not in get_args(Operation):
      raise ValueError(unknown("operation", self.operation, get_args(Operation), owner=self.label))
    only = "add" if field.form in ("rotation", "pseudo_inertia") else "absolute" if field.integer else self.operation
    if self.operation != only:
      raise ValueError(f"{self.label}: operation {self.operation!r} makes no sense for it; there is only {only!r}.")
    if field.form == "intrinsics" and self.operation == "add":
      raise ValueError(f"{self.label}: a sum might turn a focal length negative; scale it, or give it absolute.")
    if not self.pattern:
      raise ValueError(f"{self.label}: no pattern is given.")
    if not self.values:
      raise ValueError(f"{self.label}: no axis is given values. Axes: {', '.join(field.axes)}.")
    for axis, distribution in self.values.items():
      if axis not in range(len(field.axes)):
        raise ValueError(f"{self.label}: axis {axis} does not exist; there are {len(field.axes)}, from 0.")
      name = f"{self.label} {field.axes[axis]}".rstrip()
      check_distribution(distribution, name)
      if isinstance(distribution, Categorical) and distribution.has_names and not field.integer:
        raise ValueError(f"{name}: names are for what is chosen among named things, got {distribution.values}.")
      if field.integer and not isinstance(distribution, Categorical):
        raise ValueError(f"{name} is a choice: give a Categorical.")
      self._check_bounds(name, distribution, *field.bounds(axis))
    if self.isotropic and len(set(map(repr, self.values.values()))) > 1:
      raise ValueError(f"{self.label}: isotropic means one draw for all axes, but they have different distributions.")

  def _check_bounds(self, name: str, distribution: Distribution, minimum: float, maximum: float) -> None:
    lo, hi = distribution.support()
    strict = FIELDS[self.field].positive
    # A sum, and a product that has an upper bound, can only be judged against the defaults.
    if self.operation == "scale":
      minimum, maximum = (0.0 if minimum >= 0.0 else minimum), float("inf")
    if self.operation == "add":
      return
    hint = ""
    if isinstance(distribution, Gaussian):
      hint = f" Truncate it, as in Gaussian(mean, std, lo={minimum:g}{f', hi={maximum:g}' if maximum < 1e9 else ''})."
    values = f"{name}: {self.operation} values in [{lo:g}, {hi:g}] may"
    if lo < minimum or (strict and lo == minimum):
      what = "reach" if lo == minimum else "fall below"
      raise ValueError(f"{values} {what} the physical minimum {minimum:g}.{hint}")
    if hi > maximum:
      raise ValueError(f"{values} exceed the physical maximum {maximum:g}.{hint}")

  @property
  def label(self) -> str:
    """How messages call it."""
    return f"{self.field} {self.pattern!r}"

  @property
  def shown_in(self) -> str:
    """Of the fields that are written, the one in which a draw is read as it was made."""
    return (FIELDS[self.field].fields or (self.field,))[0]

  @property
  def composes(self) -> bool:
    """Whether it may start from what another one made, physical whatever that was."""
    field = FIELDS[self.field]
    if field.form != "plain":
      return field.form == "pseudo_inertia"
    if field.ordered or field.integer or self.field == "body_inertia" or "timeconst" in field.axes:
      return False
    bounds = {bound for axis in self.values for bound in field.bounds(axis)}
    return bounds <= {-math.inf, math.inf, *((0.0,) if self.operation == "scale" else ())} and (
      self.operation != "absolute"
    )

  @property
  def needs_constants(self) -> bool:
    """Whether derived fields must be recomputed after it was applied."""
    return FIELDS[self.field].needs_constants


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
  """A randomiser of any field of the catalogue.

  Args:
    field: name of the field.
    pattern: regular expressions that select elements by their whole name; options are one element, `".*"`.
    values: a pair, a `Distribution`, or a mapping from axes, by number or name, to these. A pair is (lo, hi), or
      (mean, std) for "gaussian".
    axes: the axes that unmapped `values` apply to; None is all.
    operation: what a draw does to the compiled default; None is what the catalogue says for the field.
    distribution: how pairs are read.
    shared: one draw for all elements of a world.
    isotropic: one draw for all axes of an element.

  Raises:
    ValueError: a name that does not exist, an impossible range, or values outside of what is physical.
  """
  pattern = pattern if isinstance(pattern, str) else tuple(pattern)
  label = f"{field} {pattern!r}"
  if field not in FIELDS:
    raise ValueError(unknown("field", field, FIELDS, owner="randomizer"))
  if distribution not in _BY_NAME:
    raise ValueError(unknown("distribution", distribution, _BY_NAME, owner=label))
  names = FIELDS[field].axes
  if isinstance(values, Mapping):
    if axes is not None:
      raise ValueError(f"{label}: give either axes or values by axis, not both.")
    pairs: list[tuple[int | str, Values]] = list(values.items())
  else:
    axes = (axes,) if isinstance(axes, int | str) else axes
    pairs = [(axis, values) for axis in (range(len(names)) if axes is None else axes)]
  by_axis: dict[int, Distribution] = {}
  for given, value in pairs:
    axis = _axis(given, names, label)
    if axis in by_axis:
      raise ValueError(f"{label}: axis {given!r} is given values twice.")
    by_axis[axis] = as_distribution(value, _BY_NAME[distribution])
  return FieldRandomizer(
    field=field,
    pattern=pattern,
    values=by_axis,
    operation=FIELDS[field].operation if operation is None else operation,
    shared=shared,
    isotropic=isotropic,
    every_axis=axes is None and not isinstance(values, Mapping),
  )


def _axis(axis: int | str, names: tuple[str, ...], label: str) -> int:
  if isinstance(axis, int):
    return axis
  if axis not in names:
    raise ValueError(unknown("axis", str(axis), names, owner=label))
  return names.index(axis)


def geom_friction(
  pattern: str | Sequence[str],
  values: Values | ByAxis,
  *,
  axes: int | str | Sequence[int | str] | None = None,
  operation: Operation = "absolute",
  distribution: DistributionName = "uniform",
  shared: bool = False,
) -> FieldRandomizer:
  """Friction of geoms: axes 0 sliding [1], 1 torsional [m], 2 rolling [m]; sliding alone unless told otherwise.

  Of two geoms in contact MuJoCo takes the one with the higher priority, or else the larger friction of both.
  """
  if axes is None and not isinstance(values, Mapping):
    axes = (0,)
  return randomize_field(
    "geom_friction", pattern, values, axes=axes, operation=operation, distribution=distribution, shared=shared
  )


def body_mass(
  pattern: str | Sequence[str],
  values: Values,
  *,
  operation: Operation = "absolute",
  distribution: DistributionName = "uniform",
  shared: bool = False,
) -> FieldRandomizer:
  """Mass of bodies [kg], with the inertia about the centre of mass as it is; `pseudo_inertia` changes both as one."""
  return randomize_field("body_mass", pattern, values, operation=operation, distribution=distribution, shared=shared)


def body_com_offset(
  pattern: str | Sequence[str],
  values: Values | ByAxis,
  *,
  distribution: DistributionName = "uniform",
  shared: bool = False,
) -> FieldRandomizer:
  """Shift of the centre of mass of bodies in the body frame, axes x, y, z [m].

  Mass, and inertia about the centre of mass, stay as they are.
  """
  return randomize_field("body_ipos", pattern, values, distribution=distribution, shared=shared)


def pseudo_inertia(
  pattern: str | Sequence[str],
  *,
  scale: float | None = None,
  alpha: Values | None = None,
  d: Values | None = None,
  s: Values | None = None,
  t: Values | None = None,
  distribution: DistributionName = "uniform",
  shared: bool = False,
) -> FieldRandomizer:
  """Mass, centre of mass and inertia of bodies at once, physically consistent whatever is drawn; see `perturb_inertia`.

  Args:
    pattern: regular expressions that select bodies by their whole name.
    scale: shorthand for (-scale, scale) of `alpha`, `d` and `s`, as far as these are not given.
    alpha: mass and inertia are multiplied by e^(2 alpha).
    d: stretch of each body axis by e^d, about the body's origin.
    s: shear of each plane.
    t: shift of the centre of mass along each body axis [m].
    distribution: how pairs are read.
    shared: one draw for all bodies of a world.

  Raises:
    ValueError: nothing is given, or an impossible range.
  """
  around = None if scale is None else Uniform(-scale, scale)
  groups = {"alpha": alpha or around, "d": d or around, "s": s or around, "t": t}
  numbers = {"alpha": ("",), "d": ("1", "2", "3"), "s": ("12", "13", "23"), "t": ("1", "2", "3")}
  values = {name + i: value for name, value in groups.items() if value is not None for i in numbers[name]}
  return randomize_field("pseudo_inertia", pattern, values, distribution=distribution, shared=shared)


def encoder_bias(
  pattern: str | Sequence[str],
  values: Values,
  *,
  distribution: DistributionName = "uniform",
  shared: bool = False,
) -> FieldRandomizer:
  """Constant error of joint encoders, reading minus truth [rad or m], for joints with one coordinate."""
  return randomize_field("encoder_bias", pattern, values, distribution=distribution, shared=shared)
