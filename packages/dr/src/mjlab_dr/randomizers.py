"""What to randomise, and how: plain configs that are checked when they are made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from mjlab_core import unknown

from mjlab_dr.catalogue import FIELDS
from mjlab_dr.distributions import Distribution, Gaussian, LogUniform, Uniform

Operation = Literal["absolute", "add", "scale"]
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

  def __post_init__(self) -> None:
    if self.field not in FIELDS:
      raise ValueError(unknown("field", self.field, FIELDS, owner="randomizer"))
    field = FIELDS[self.field]
    if self.operation not in get_args(Operation):
      raise ValueError(unknown("operation", self.operation, get_args(Operation), owner=self.label))
    if not self.values:
      raise ValueError(f"{self.label}: no axis is given values. Axes: {', '.join(field.axes)}.")
    for axis, distribution in self.values.items():
      if axis not in range(len(field.axes)):
        raise ValueError(f"{self.label}: axis {axis} does not exist; there are {len(field.axes)}, from 0.")
      name = f"{self.label} {field.axes[axis]}".rstrip()
      distribution.check(name)
      lo, hi = distribution.support()
      # A sum can only be judged against the defaults, when the elements are known.
      limit = 0.0 if self.operation == "scale" and field.minimum >= 0.0 else field.minimum
      if self.operation != "add" and lo < limit:
        raise ValueError(
          f"{name}: {self.operation} values in [{lo:g}, {hi:g}] may fall below the physical minimum {limit:g}."
          + (f" Truncate it, as in Gaussian(mean, std, lo={limit:g})." if isinstance(distribution, Gaussian) else "")
        )

  @property
  def label(self) -> str:
    """How messages call it."""
    return f"{self.field} {self.pattern!r}"

  @property
  def needs_constants(self) -> bool:
    """Whether derived fields must be recomputed after it was applied."""
    return FIELDS[self.field].needs_constants


def randomize_field(
  field: str,
  pattern: str | Sequence[str],
  values: Values | ByAxis,
  *,
  axes: Sequence[int | str] | None = None,
  operation: Operation = "absolute",
  distribution: DistributionName = "uniform",
  shared: bool = False,
) -> FieldRandomizer:
  """A randomiser of any field of the catalogue.

  Args:
    field: name of the field.
    pattern: regular expressions that select elements by their whole name.
    values: a pair, a `Distribution`, or a mapping from axes, by number or name, to these. A pair is (lo, hi), or
      (mean, std) for "gaussian".
    axes: the axes that unmapped `values` apply to; None is all.
    operation: what a draw does to the compiled default.
    distribution: how pairs are read.
    shared: one draw for all elements of a world.

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
    by_axis: dict[int | str, Values] = dict(values.items())
  else:
    by_axis = dict.fromkeys(range(len(names)) if axes is None else axes, values)
  return FieldRandomizer(
    field=field,
    pattern=pattern,
    values={
      _axis(axis, names, label): _BY_NAME[distribution](*value) if isinstance(value, tuple) else value
      for axis, value in by_axis.items()
    },
    operation=operation,
    shared=shared,
  )


def _axis(axis: int | str, names: tuple[str, ...], label: str) -> int:
  if isinstance(axis, int):
    return axis
  if axis not in names:
    raise ValueError(unknown("axis", axis, names, owner=label))
  return names.index(axis)


def geom_friction(
  pattern: str | Sequence[str],
  values: Values | ByAxis,
  *,
  axes: Sequence[int | str] | None = None,
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
  return randomize_field("body_ipos", pattern, values, operation="add", distribution=distribution, shared=shared)


def encoder_bias(
  pattern: str | Sequence[str],
  values: Values,
  *,
  distribution: DistributionName = "uniform",
  shared: bool = False,
) -> FieldRandomizer:
  """Constant error of joint encoders, reading minus truth [rad or m], for joints with one coordinate."""
  return randomize_field("encoder_bias", pattern, values, distribution=distribution, shared=shared)
