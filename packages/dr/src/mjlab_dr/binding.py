"""Which numbers of a model a randomiser writes, and whether all that may come out is physical and counts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mjlab_core import NameMatchError, match_names, unknown

from mjlab_dr.catalogue import FIELDS, Field, count, element_names, rows
from mjlab_dr.distributions import Categorical, Distribution
from mjlab_dr.effect import why_axis_idle, why_element_idle
from mjlab_dr.randomizers import FieldRandomizer

_COMPONENTS = {"rotation": ("w", "x", "y", "z")}


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
  """Where it is among the values of one world, more than once where degrees of freedom share it."""
  source: int
  """Which draw it comes from, element by element and axis by axis; -1 if it follows from several."""


@dataclass(frozen=True)
class Binding:
  """A randomiser's place in a model."""

  elements: tuple[str, ...]
  """Names of the elements that it changes."""
  components: tuple[Component, ...]
  """All that it writes, in the order of its fields."""


def bind(
  cfg: FieldRandomizer,
  model: mujoco.MjModel,
  names: Sequence[str] | None,
  ids: Sequence[int] | None,
  *,
  is_target: bool,
  owner: str,
) -> Binding:
  """Resolves a randomiser in a model.

  Args:
    cfg: the randomiser.
    model: the compiled model.
    names: names that the pattern is matched against; None is all of the model.
    ids: the element of the model, or the column of the target, behind each of `names`.
    is_target: whether what is written is outside of the model.
    owner: whose randomiser it is, as messages begin.

  Raises:
    ValueError: nothing matches, or nothing that matches counts.
  """
  field = FIELDS[cfg.field]
  in_model = not is_target or names is None
  if names is None:
    of_model = element_names(model, field.kind)
    ids = range(1 if field.kind == "body" else 0, count(model, field.kind))
    names = [of_model[i] for i in ids]
  elif ids is None:
    ids = range(len(names))
  picked, _ = match_names(cfg.pattern, names, what=field.kind, owner=owner)
  idle = {i: why for i in picked if in_model and (why := why_element_idle(model, cfg.field, int(ids[i])))}
  for pattern in [cfg.pattern] if isinstance(cfg.pattern, str) else cfg.pattern:
    matched = [i for i in picked if re.fullmatch(pattern, names[i])]
    if all(i in idle for i in matched):
      raise NameMatchError(
        f"{owner}: a change of {field.kind} {names[matched[0]]!r} would do nothing, for it {idle[matched[0]]}."
        + (f" Nor would one of the {len(matched) - 1} others that match {pattern!r}." if len(matched) > 1 else "")
      )
  elements = [(names[i], int(ids[i])) for i in picked if i not in idle]
  if is_target:
    return Binding(
      tuple(name for name, _ in elements),
      tuple(
        Component(field=cfg.field, element=name, axis="", row=i, columns=(i,), source=e)
        for e, (name, i) in enumerate(elements)
      ),
    )
  if field.form == "servo":
    components = _servo(elements)
  elif field.form != "plain":
    components = _whole(cfg.field, field, model, elements)
  else:
    components = _single(cfg, field, model, elements, owner)
  return Binding(tuple(name for name, _ in elements), tuple(components))


def _single(
  cfg: FieldRandomizer, field: Field, model: mujoco.MjModel, elements: list[tuple[str, int]], owner: str
) -> list[Component]:
  """A component for every axis of every element that counts."""
  components: list[Component] = []
  axes = list(cfg.values)
  for j, axis in enumerate(axes):
    reasons = [why_axis_idle(model, cfg.field, i, axis) for _, i in elements]
    if all(reasons) and not cfg.every_axis:
      which = f"{field.axes[axis]} of {field.kind} {elements[0][0]!r}"
      raise ValueError(f"{owner}: a change of {which} would do nothing, for it {reasons[0]}.")
    for e, ((name, i), reason) in enumerate(zip(elements, reasons, strict=True)):
      if not reason:
        at = rows(model, field, i)
        where = tuple(row * field.width + axis for row in at)
        source = e * len(axes) + j
        components.append(
          Component(field=cfg.field, element=name, axis=field.axes[axis], row=at[0], columns=where, source=source)
        )
  if not components:
    reason = why_axis_idle(model, cfg.field, elements[0][1], axes[0])
    raise ValueError(f"{owner}: a change of {field.kind} {elements[0][0]!r} would do nothing, for it {reason}.")
  return sorted(components, key=lambda component: component.source)


def _servo(elements: list[tuple[str, int]]) -> list[Component]:
  """Gain and feedback of position actuators."""
  return [
    Component(field=written, element=element, axis="kp", row=i, columns=(i * FIELDS[written].width + k,), source=e)
    for written, k in (("actuator_gainprm", 0), ("actuator_biasprm", 1))
    for e, (element, i) in enumerate(elements)
  ]


def _whole(name: str, field: Field, model: mujoco.MjModel, elements: list[tuple[str, int]]) -> list[Component]:
  """All components of every element, where they are written together."""
  return [
    Component(field=written, element=element, axis=axis, row=i, columns=(i * len(axes) + k,), source=-1)
    for written in field.fields or (name,)
    for axes in [_COMPONENTS.get(FIELDS[written].form, FIELDS[written].axes)]
    for element, i in elements
    for k, axis in enumerate(axes)
  ]


def with_ids(cfg: FieldRandomizer, model: mujoco.MjModel, owner: str, prefix: str) -> list[Distribution]:
  """The distributions of a randomiser, with ids in place of names, which may lack `prefix`.

  Raises:
    ValueError: a name that does not exist, or a number that is no id.
  """
  field = FIELDS[cfg.field]
  if not field.integer:
    return list(cfg.values.values())
  known = element_names(model, field.names) if field.names else ["0", "1"]

  def find(name: str) -> int:
    for candidate in (name, prefix + name):
      if candidate in known:
        return known.index(candidate)
    raise ValueError(unknown(field.names or "value", name, known, owner=owner))

  out: list[Distribution] = []
  for distribution in cfg.values.values():
    assert isinstance(distribution, Categorical)
    chosen = distribution.named(find)
    for value in chosen.values:
      if value not in range(len(known)):
        raise ValueError(f"{owner}: {value!r} is no {field.names or 'choice'}; there are {len(known)}, from 0.")
    out.append(chosen)
  return out


def check_results(
  cfg: FieldRandomizer, binding: Binding, defaults: np.ndarray, model: mujoco.MjModel, owner: str
) -> None:
  """Checks everything that may come out against what is physical; `defaults` has a row for each
  world, or one for all, and a number for each component.

  Raises:
    ValueError: naming the element, what it may get, and what is allowed.
  """
  field = FIELDS[cfg.field]
  if cfg.operation == "scale":
    _check_multiples(cfg, binding, defaults, owner)
  if field.form == "direction" and cfg.operation == "absolute":
    _check_length(cfg, binding, defaults, owner)
  # What scales or stretches a body leaves its centre of mass where it is, if that is the origin.
  drawn = {field.axes[axis] for axis in cfg.values}
  if cfg.field in ("body_ipos", "body_iquat") or (
    field.form == "pseudo_inertia" and not drawn <= {"alpha", "d1", "d2", "d3"}
  ):
    _check_simple(binding, model, owner)
  if field.form not in ("plain", "servo") or field.integer:
    return
  distributions = list(cfg.values.values())
  # Lowest and highest of each axis of each element, drawn or not.
  spans: dict[str, Spans] = {}
  for i, component in enumerate(binding.components):
    if component.field != cfg.shown_in:
      continue
    minimum, maximum = field.bounds(field.axes.index(component.axis))
    # Worlds without the element have it out of bounds, so that nothing meets it.
    start = defaults[defaults[:, i] >= minimum, i]
    if not len(start):
      continue
    lo, hi = distributions[component.source % len(distributions)].support()
    if cfg.operation == "add":
      lo, hi = start.min() + lo, start.max() + hi
    elif cfg.operation == "scale":
      products = np.outer((start.min(), start.max()), (lo, hi))
      lo, hi = products.min(), products.max()
    spans.setdefault(component.element, {})[component.axis] = float(lo), float(hi)
    # A scaled zero stays one, as compiled.
    is_kept = cfg.operation == "scale" and start.min() == 0.0
    what = f"{owner}: {field.kind} {component.element!r} may get {component.axis or cfg.field}"
    if lo < minimum or (field.positive and lo == minimum and not is_kept):
      raise ValueError(f"{what} {lo:g}, below the physical minimum {minimum:g}.")
    if hi > maximum:
      raise ValueError(f"{what} {hi:g}, above the physical maximum {maximum:g}.")
  if not (field.ordered or cfg.field in ("body_inertia", "actuator_delay") or "timeconst" in field.axes):
    return
  row_of = {component.element: component.row for component in binding.components}
  for element, span in spans.items():
    what = f"{owner}: {field.kind} {element!r}"
    compiled = np.asarray(getattr(model, cfg.field)).reshape(-1, field.width)[row_of[element]].tolist()
    both = {axis: (x, x) for axis, x in zip(field.axes, compiled, strict=True)} | span
    if field.ordered and not cfg.isotropic:
      _check_order(what, both)
    elif cfg.field == "body_inertia" and not (cfg.isotropic and cfg.operation == "scale"):
      _check_triangle(what, both)
    elif "timeconst" in field.axes:
      _check_signs(what, both)
    elif cfg.field == "actuator_delay":
      _check_delay(what, both[""][1], model, row_of[element])


def _check_multiples(cfg: FieldRandomizer, binding: Binding, defaults: np.ndarray, owner: str) -> None:
  """Refuses patterns, and axes that were asked for by themselves, of which all that is multiplied is zero."""
  field = FIELDS[cfg.field]
  is_zero = (defaults == 0.0).all(0)
  drawn = [field.axes[axis] for axis in cfg.values]
  groups = [drawn] if cfg.every_axis else [[axis] for axis in drawn]
  for pattern in [cfg.pattern] if isinstance(cfg.pattern, str) else cfg.pattern:
    matched = [name for name in binding.elements if re.fullmatch(pattern, name)]
    for axes in groups:
      zeros = [
        zero
        for component, zero in zip(binding.components, is_zero, strict=True)
        if component.field == cfg.shown_in and component.axis in axes and component.element in matched
      ]
      if zeros and all(zeros):
        which = "" if cfg.every_axis else axes[0]
        what = f"{which} of {field.kind} {matched[0]!r}".removeprefix(" of ")
        raise ValueError(
          f"{owner}: a change of {what} would do nothing, for it is zero, as is every multiple."
          + (f" Nor would one of the {len(matched) - 1} others that match {pattern!r}." if len(matched) > 1 else "")
        )


def _check_length(cfg: FieldRandomizer, binding: Binding, defaults: np.ndarray, owner: str) -> None:
  """Refuses directions that become zero whatever is drawn."""
  field = FIELDS[cfg.field]
  is_zero = {field.axes[axis]: not any(values.support()) for axis, values in cfg.values.items()}
  for name in binding.elements:
    columns = [i for i, component in enumerate(binding.components) if component.element == name]
    if all(is_zero.get(binding.components[i].axis, not defaults[:, i].any()) for i in columns):
      raise ValueError(f"{owner}: {field.kind} {name!r} may get {cfg.field} of length zero.")


Spans = dict[str, tuple[float, float]]
"""Lowest and highest value by axis."""


def _check_order(what: str, spans: Spans) -> None:
  if spans["lower"][1] > spans["upper"][0]:
    raise ValueError(
      f"{what} may get a lower bound of {spans['lower'][1]:g} with an upper bound of {spans['upper'][0]:g}. "
      "Narrow the ranges, or move both by one draw with isotropic=True."
    )


def _check_triangle(what: str, spans: Spans) -> None:
  for axis in spans:
    others = sum(spans[other][0] for other in spans if other != axis)
    if spans[axis][1] > others * (1.0 + 1e-9):
      raise ValueError(
        f"{what} may get {axis} {spans[axis][1]:g} where the other two moments sum to {others:g}, which no body has. "
        "Narrow the ranges, scale all with isotropic=True, or use pseudo_inertia."
      )


def _check_signs(what: str, spans: Spans) -> None:
  if not (all(lo > 0.0 for lo, _ in spans.values()) or all(hi < 0.0 for _, hi in spans.values())):
    listed = ", ".join(f"{axis} in [{lo:g}, {hi:g}]" for axis, (lo, hi) in spans.items())
    raise ValueError(f"{what} may get {listed}; both must be positive, or both negative.")


def _check_delay(what: str, delay: float, model: mujoco.MjModel, actuator: int) -> None:
  longest = float(model.actuator_history[actuator, 0]) * model.opt.timestep
  if delay > longest * (1.0 + 1e-9):
    raise ValueError(
      f"{what} may get a delay of {delay:g} s, but its buffer was compiled for {longest:g} s. Raise its nsample."
    )


def _check_simple(binding: Binding, model: mujoco.MjModel, owner: str) -> None:
  for component in binding.components:
    if model.body_simple[component.row]:
      raise ValueError(
        f"{owner}: body {component.element!r} was compiled as simple, with its centre of mass fixed at its origin. "
        'Set simple="false" on it before compiling (`MjSpec.body(name).simple = False`).'
      )
