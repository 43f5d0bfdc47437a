"""Numbers of a model that a randomiser writes, and checks that they are physical and have an effect."""

from __future__ import annotations

import re
import warnings
from collections.abc import Container, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np
from mjlab_core import MjlabError, UnknownNameError, match_names, unknown

from mjlab_dr.catalogue import FIELDS, written_fields
from mjlab_dr.distributions import Categorical, Distribution, Gaussian
from mjlab_dr.effect import SIMPLE, idle
from mjlab_dr.fields import element_names, rows
from mjlab_dr.randomizers import FieldRandomizer

Elements = Mapping[str, int]
"""Ids of elements in the model, or columns in a quantity outside of it, by name."""
Spans = dict[str, tuple[float, float]]
"""Lowest and highest value by axis."""


@dataclass(frozen=True, kw_only=True)
class Component:
  """One number that a randomiser writes."""

  field: str
  """Name of the field."""
  element: str
  """Name of its element."""
  axis: str
  """Name of the component; empty for a scalar."""
  row: int
  """Its element's row in the field, the first of several."""
  columns: tuple[int, ...]
  """Its columns in the values of one world, several if degrees of freedom share it."""


def matched(cfg: FieldRandomizer, model: mujoco.MjModel, known: Elements | None, owner: str) -> Elements:
  """Return the elements among the known ones, by default all of the model, that the pattern of a randomiser matches.

  Raises:
    MjlabError: nothing matches; the message begins with `owner`.
  """
  kind = cfg.row.kind
  if known is None:
    # The world does not move.
    known = {name: i for i, name in enumerate(element_names(model, kind)) if (kind, i) != ("body", 0)}
  _, names = match_names(cfg.pattern, list(known), what=kind, owner=owner)
  return {name: known[name] for name in names}


def with_effect(
  cfg: FieldRandomizer,
  model: mujoco.MjModel,
  elements: Elements,
  defaults: np.ndarray,
  earlier: Container[tuple[str, Hashable]],
  *,
  in_model: bool,
  owner: str,
) -> tuple[Elements, Container[tuple[int, int]]]:
  """Return the elements of which a change has an effect, and the numbers, by id and axis, of which it has none.

  Args:
    cfg: the randomiser.
    model: the compiled model.
    elements: the elements that its pattern matches.
    defaults: values of the field to start from, (1 or num_envs, number of columns).
    earlier: fields and columns that earlier randomisers write.
    in_model: True if MjModel has the field.
    owner: name of the owner in messages.

  Raises:
    MjlabError: a change of a chosen axis, or of every axis, has no effect in all elements that a pattern matches.
  """
  field, axes, ids = cfg.row, list(cfg.values), list(elements.values())
  reasons = idle(model, cfg.field, ids, axes) if in_model else {}
  if cfg.operation == "scale":
    for i, axis in product(ids, axes):
      columns = [row * field.width + axis for row in rows(model, field, i)]
      is_written = any((cfg.shown_in, column) in earlier for column in columns)
      if not (is_written or defaults[:, columns].any()):
        reasons.setdefault((i, axis), "is zero, as is every multiple")
  for pattern in cfg.patterns:
    matches = [(name, i) for name, i in elements.items() if re.fullmatch(pattern, name)]
    for group in [axes] if cfg.every_axis else [[axis] for axis in axes]:
      if all(number in reasons for number in product([i for _, i in matches], group)):
        (name, i), axis = matches[0], group[0]
        which = f"{field.axes[axis]} of " if field.axes[axis] and not cfg.every_axis else ""
        what = f"a change of {which}{field.kind} {name!r} would do nothing, for it {reasons[i, axis]}."
        others = f" Nor would one of the {len(matches) - 1} others that match {pattern!r}." if len(matches) > 1 else ""
        raise UnknownNameError(f"{owner}: {what}{others}")
  if simple := {name for name, i in elements.items() for axis in axes if SIMPLE in reasons.get((i, axis), "")}:
    warnings.warn(f"{owner}: {', '.join(map(repr, sorted(simple)))} left out: {SIMPLE}", stacklevel=4)
  # The inertia of a body is written as a whole.
  is_out = any if field.form == "pseudo_inertia" else all
  kept = {name: i for name, i in elements.items() if not is_out((i, axis) in reasons for axis in axes)}
  return kept, reasons


def components_of(
  cfg: FieldRandomizer, model: mujoco.MjModel, elements: Elements, idle_numbers: Container[tuple[int, int]]
) -> tuple[Component, ...]:
  """Return all numbers that a randomiser writes, in the order of its fields; those without effect are left out."""
  field = cfg.row
  # Column in a row and name of the numbers that are written in each field.
  numbers: dict[str, list[tuple[int, str]]]
  if field.form == "plain":
    numbers = {cfg.field: [(axis, field.axes[axis]) for axis in cfg.values]}
  elif field.form == "servo":
    numbers = {"actuator_gainprm": [(0, "kp")], "actuator_biasprm": [(1, "kp")]}
  else:
    written = {name: FIELDS[name] for name in written_fields(cfg.field)}
    numbers = {name: list(enumerate("wxyz" if row.form == "rotation" else row.axes)) for name, row in written.items()}
  return tuple(
    Component(
      field=name,
      element=element,
      axis=axis,
      row=at[0],
      columns=tuple(row * FIELDS[name].width + column for row in at),
    )
    for name, of_field in numbers.items()
    for element, i in elements.items()
    for at in [rows(model, field, i)]
    for column, axis in of_field
    if field.form != "plain" or (i, column) not in idle_numbers
  )


def with_ids(cfg: FieldRandomizer, model: mujoco.MjModel, owner: str, prefix: str) -> list[Distribution]:
  """Return the distributions of a randomiser, with ids in place of names. Names may omit `prefix`.

  Raises:
    MjlabError: a name that does not exist, or a number that is not an id.
  """
  field = cfg.row
  known = element_names(model, field.names) if field.names else []

  def find(name: str) -> int:
    for candidate in (name, prefix + name):
      if candidate in known:
        return known.index(candidate)
    raise UnknownNameError(unknown(field.names or "value", name, known, owner=owner))

  out: list[Distribution] = []
  for distribution in cfg.values.values():
    if isinstance(distribution, Categorical) and field.integer:
      distribution = distribution.named(find)
      lo, hi = distribution.support()
      if any(x != int(x) for x in distribution.values) or (field.names and not 0 <= lo <= hi < len(known)):
        limit = f" below {len(known)}" if field.names else ""
        raise MjlabError(f"{owner}: {distribution.values} must be whole numbers{limit}.")
    out.append(distribution)
  return out


def result_problems(
  cfg: FieldRandomizer, components: Sequence[Component], defaults: np.ndarray, model: mujoco.MjModel
) -> Iterator[str]:
  """Yield results outside of the bounds of their axis, or impossible beside those of other axes.

  `defaults` has a row for each world, or one for all, and a number for each component.
  """
  field = cfg.row
  drawn = {field.axes[axis]: (distribution, *field.bounds(axis)) for axis, distribution in cfg.values.items()}
  spans: dict[tuple[str, int], Spans] = {}
  for component, start in zip(components, defaults.T, strict=True):
    if component.field != cfg.shown_in or component.axis not in drawn:
      continue
    distribution, minimum, maximum = drawn[component.axis]
    # Worlds without the element have it out of bounds, so that nothing meets it.
    start = start[start >= minimum, None]
    if not len(start):
      continue
    results = np.array(distribution.support())
    if cfg.operation == "add":
      results = start + results
    elif cfg.operation == "scale":
      results = start * results
    lo, hi = float(results.min()), float(results.max())
    spans.setdefault((component.element, component.row), {})[component.axis] = lo, hi
    # A scaled zero stays one, as compiled.
    is_kept = cfg.operation == "scale" and start.min() == 0.0
    what = f"{field.kind} {component.element!r} may get {component.axis or cfg.field}"
    hint = " Truncate the Gaussian with lo and hi." if isinstance(distribution, Gaussian) else ""
    if lo < minimum or (field.positive and lo == minimum and not is_kept):
      yield f"{what} {lo:g}, {'at' if lo == minimum else 'below'} the physical minimum {minimum:g}.{hint}"
    if hi > maximum:
      yield f"{what} {hi:g}, above the physical maximum {maximum:g}.{hint}"
  if not (field.ordered or cfg.field in ("body_inertia", "actuator_delay") or "timeconst" in field.axes):
    return
  for (element, row), span in spans.items():
    compiled = getattr(model, cfg.field).reshape(-1, field.width)[row].tolist()
    both = {axis: (x, x) for axis, x in zip(field.axes, compiled, strict=True)} | span
    for problem in _impossible_together(cfg, both, model, row):
      yield f"{field.kind} {element!r} may get {problem}"


def _impossible_together(cfg: FieldRandomizer, spans: Spans, model: mujoco.MjModel, row: int) -> Iterator[str]:
  """Yield why the numbers of one element do not fit together."""
  field = cfg.row
  if field.ordered and not cfg.isotropic and spans["lower"][1] > spans["upper"][0]:
    yield (
      f"a lower bound of {spans['lower'][1]:g} with an upper bound of {spans['upper'][0]:g}. "
      "Narrow the ranges, or move both by one draw with isotropic=True."
    )
  if cfg.field == "body_inertia" and not (cfg.isotropic and cfg.operation == "scale"):
    for axis, (_, hi) in spans.items():
      others = sum(spans[other][0] for other in spans if other != axis)
      if hi > others * (1.0 + 1e-9):
        yield (
          f"{axis} {hi:g} where the other two moments sum to {others:g}, which no body has. "
          "Narrow the ranges, scale all with isotropic=True, or use pseudo_inertia."
        )
  if "timeconst" in field.axes and len({*np.sign([bound for span in spans.values() for bound in span])} | {0.0}) != 2:
    listed = ", ".join(f"{axis} in [{lo:g}, {hi:g}]" for axis, (lo, hi) in spans.items())
    yield f"{listed}; both must be positive, or both negative."
  if cfg.field == "actuator_delay":
    longest, delay = float(model.actuator_history[row, 0]) * model.opt.timestep, spans[""][1]
    if delay > longest * (1.0 + 1e-9):
      yield f"a delay of {delay:g} s, but its buffer was compiled for {longest:g} s. Raise its nsample."
