"""Numbers of a model that a randomiser writes, and checks that they are physical and have an effect."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mjlab_core import Limits, MjlabError, UnknownNameError, match_names, unknown

from mjlab_dr.catalogue import FIELDS
from mjlab_dr.distributions import Categorical, Distribution
from mjlab_dr.effect import idle_elements, idle_on_axis
from mjlab_dr.fields import Field, count, element_names, rows
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
  """Its columns in the values of one world, several if degrees of freedom share it."""
  source: int
  """Index of its draw, element by element and axis by axis; -1 if it follows from several."""


@dataclass(frozen=True)
class Binding:
  """Elements and numbers of a model that a randomiser writes."""

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
  """Resolve a randomiser in a model.

  Args:
    cfg: the randomiser.
    model: the compiled model.
    names: names that the pattern is matched against; None is all of the model.
    ids: the element of the model, or the column of the target, behind each of `names`.
    is_target: True if a tensor outside the model is written.
    owner: name of the owner in messages.

  Raises:
    MjlabError: nothing matches, or nothing that matches has an effect.
  """
  field = FIELDS[cfg.field]
  in_model = not is_target or names is None
  if names is None:
    ids = range(1 if field.kind == "body" else 0, count(model, field.kind))
    names = element_names(model, field.kind)[ids.start :]
  ids = range(len(names)) if ids is None else ids
  picked, _ = match_names(cfg.pattern, names, what=field.kind, owner=owner)
  elements = [(names[i], int(ids[i])) for i in picked]
  if in_model:
    elements = _with_effect(cfg, model, elements, owner)
  if is_target:
    return bind_columns(cfg.field, elements)
  if field.form == "servo":
    components = _servo(elements)
  elif field.form != "plain":
    components = _whole(cfg.field, field, model, elements)
  else:
    components = _single(cfg, field, model, elements, owner)
  return Binding(tuple(name for name, _ in elements), tuple(components))


def bind_columns(field: str, elements: Sequence[tuple[str, int]]) -> Binding:
  """Return the binding of a quantity outside the model, with one column for each element, by name and column."""
  components = [
    Component(field=field, element=name, axis="", row=i, columns=(i,), source=source)
    for source, (name, i) in enumerate(elements)
  ]
  return Binding(tuple(name for name, _ in elements), tuple(components))


def _with_effect(
  cfg: FieldRandomizer, model: mujoco.MjModel, elements: list[tuple[str, int]], owner: str
) -> list[tuple[str, int]]:
  """Return the elements, by name and id, of which a change has an effect; each pattern must match one of them."""
  simple = {i: body for _, i in elements if (body := simple_body(cfg, model, i)) is not None}
  reasons = idle_elements(model, cfg.field, [i for _, i in elements if i not in simple])
  idle = {i: f"{body} {SIMPLE}" for i, body in simple.items()}
  for name, i in elements:
    if i in reasons:
      idle[i] = f"a change of {FIELDS[cfg.field].kind} {name!r} would do nothing, for it {reasons[i]}."
  for pattern in [cfg.pattern] if isinstance(cfg.pattern, str) else cfg.pattern:
    matched = [i for name, i in elements if re.fullmatch(pattern, name)]
    if all(i in idle for i in matched):
      raise UnknownNameError(f"{owner}: {idle[matched[0]]}{_others(matched, pattern)}")
  if simple:
    bodies = ", ".join(dict.fromkeys(simple.values()))
    warnings.warn(f"{owner}: left out, because {bodies} {SIMPLE}", stacklevel=5)
  return [(name, i) for name, i in elements if i not in idle]


SIMPLE = (
  "was compiled as simple: MuJoCo keeps its inertia matrix diagonal, whatever this field says. Scenes of mjlab compile "
  'no body so; elsewhere set simple="false" on it before compiling (`MjSpec.body(name).simple = False`).'
)


def simple_body(cfg: FieldRandomizer, model: mujoco.MjModel, i: int) -> str | None:
  """Return the body of element `i` if it was compiled as simple and the draw would not leave it so; None otherwise.

  The compiler finds bodies whose part of the inertia matrix is diagonal and constant, and both engines store no more
  than the diagonal of it. It stays diagonal while the centre of mass is the origin of the body, the principal axes are
  its axes, and its several degrees of freedom act along these and through the origin.
  """
  form = FIELDS[cfg.field].form
  if cfg.field in ("jnt_pos", "jnt_axis"):
    body = int(model.jnt_bodyid[i])
    # The matrix of a single degree of freedom is its diagonal.
    stays = model.body_dofnum[body] == 1
  else:
    body = i
    # What scales or stretches a body moves no centre of mass that is the origin.
    drawn = {FIELDS[cfg.field].axes[axis] for axis in cfg.values}
    stays = cfg.field not in ("body_ipos", "body_iquat") and form != "pseudo_inertia"
    stays = stays or (form == "pseudo_inertia" and drawn <= {"alpha", "d1", "d2", "d3"})
  if stays or FIELDS[cfg.field].kind not in ("body", "joint") or not model.body_simple[body]:
    return None
  return f"body {element_names(model, 'body')[body]!r}"


def _single(
  cfg: FieldRandomizer, field: Field, model: mujoco.MjModel, elements: list[tuple[str, int]], owner: str
) -> list[Component]:
  """Return a component for every axis of every element that has an effect."""
  axes, ids = list(cfg.values), [i for _, i in elements]
  idle = {axis: idle_on_axis(model, cfg.field, ids, axis) for axis in axes}
  dead = [axis for axis in axes if len(idle[axis]) == len(ids)]
  if dead and (not cfg.every_axis or len(dead) == len(axes)):
    what = f"{'' if cfg.every_axis else f'{field.axes[dead[0]]} of '}{field.kind} {elements[0][0]!r}"
    raise MjlabError(f"{owner}: a change of {what} would do nothing, for it {idle[dead[0]][ids[0]]}.")
  components: list[Component] = []
  for e, (name, i) in enumerate(elements):
    at = rows(model, field, i)
    for j, axis in enumerate(axes):
      if i not in idle[axis]:
        where, source = tuple(row * field.width + axis for row in at), e * len(axes) + j
        components.append(
          Component(field=cfg.field, element=name, axis=field.axes[axis], row=at[0], columns=where, source=source)
        )
  return components


def _servo(elements: list[tuple[str, int]]) -> list[Component]:
  """Return gain and feedback of position actuators."""
  return [
    Component(field=written, element=element, axis="kp", row=i, columns=(i * FIELDS[written].width + k,), source=e)
    for written, k in (("actuator_gainprm", 0), ("actuator_biasprm", 1))
    for e, (element, i) in enumerate(elements)
  ]


def _whole(name: str, field: Field, model: mujoco.MjModel, elements: list[tuple[str, int]]) -> list[Component]:
  """Return all components of every element, which are written together."""
  return [
    Component(field=written, element=element, axis=axis, row=i, columns=(i * len(axes) + k,), source=-1)
    for written in field.fields or (name,)
    for axes in [_COMPONENTS.get(FIELDS[written].form, FIELDS[written].axes)]
    for element, i in elements
    for k, axis in enumerate(axes)
  ]


def with_ids(cfg: FieldRandomizer, model: mujoco.MjModel, owner: str, prefix: str) -> list[Distribution]:
  """Return the distributions of a randomiser, with ids in place of names, which may lack `prefix`.

  Raises:
    MjlabError: a name that does not exist, or a number that is no id.
  """
  field = FIELDS[cfg.field]
  if not field.integer:
    return list(cfg.values.values())
  known = element_names(model, field.names) if field.names else []

  def find(name: str) -> int:
    for candidate in (name, prefix + name):
      if candidate in known:
        return known.index(candidate)
    raise UnknownNameError(unknown(field.names or "value", name, known, owner=owner))

  out: list[Distribution] = []
  for distribution in cfg.values.values():
    assert isinstance(distribution, Categorical)
    chosen = distribution.named(find)
    limits = Limits(ge=0, le=len(known) - 1) if field.names else Limits()
    if any(value != int(value) for value in chosen.values) or limits.problem(chosen.values):
      raise MjlabError(
        f"{owner}: {chosen.values} must be whole numbers{f' below {len(known)}' if field.names else ''}."
      )
    out.append(chosen)
  return out


def result_problems(
  cfg: FieldRandomizer, binding: Binding, defaults: np.ndarray, model: mujoco.MjModel
) -> Iterator[str]:
  """Yield why a possible result is not physical, with the element, the result, and the admissible values.

  `defaults` has a row for each world, or one for all, and a number for each component.
  """
  field = FIELDS[cfg.field]
  if cfg.operation == "scale":
    yield from _zero_multiples(cfg, binding, defaults)
  if field.form == "direction" and cfg.operation == "absolute":
    yield from _zero_lengths(cfg, binding, defaults)
  if field.form in ("plain", "servo") and not field.integer:
    yield from _unphysical(cfg, binding, defaults, model)


def _unphysical(cfg: FieldRandomizer, binding: Binding, defaults: np.ndarray, model: mujoco.MjModel) -> Iterator[str]:
  """Yield results outside of the bounds of their axis, or impossible beside those of other axes."""
  field, distributions = FIELDS[cfg.field], list(cfg.values.values())
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
    what = f"{field.kind} {component.element!r} may get {component.axis or cfg.field}"
    if lo < minimum or (field.positive and lo == minimum and not is_kept):
      yield f"{what} {lo:g}, below the physical minimum {minimum:g}."
    if hi > maximum:
      yield f"{what} {hi:g}, above the physical maximum {maximum:g}."
  if not (field.ordered or cfg.field in ("body_inertia", "actuator_delay") or "timeconst" in field.axes):
    return
  row_of = {component.element: component.row for component in binding.components}
  for element, span in spans.items():
    compiled = np.asarray(getattr(model, cfg.field)).reshape(-1, field.width)[row_of[element]].tolist()
    both = {axis: (x, x) for axis, x in zip(field.axes, compiled, strict=True)} | span
    for problem in _impossible_together(cfg, both, model, row_of[element]):
      yield f"{field.kind} {element!r} may get {problem}"


def _impossible_together(cfg: FieldRandomizer, spans: Spans, model: mujoco.MjModel, row: int) -> Iterator[str]:
  """Yield why the numbers of one element do not fit together."""
  field = FIELDS[cfg.field]
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


def _zero_multiples(cfg: FieldRandomizer, binding: Binding, defaults: np.ndarray) -> Iterator[str]:
  """Yield patterns, and axes given by themselves, of which all defaults to be multiplied are zero."""
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
        yield f"a change of {what} would do nothing, for it is zero, as is every multiple.{_others(matched, pattern)}"


def _others(matched: Sequence[object], pattern: str) -> str:
  return f" Nor would one of the {len(matched) - 1} others that match {pattern!r}." if len(matched) > 1 else ""


def _zero_lengths(cfg: FieldRandomizer, binding: Binding, defaults: np.ndarray) -> Iterator[str]:
  """Yield elements whose direction becomes zero for every draw."""
  field = FIELDS[cfg.field]
  is_zero = {field.axes[axis]: not any(values.support()) for axis, values in cfg.values.items()}
  for name in binding.elements:
    columns = [i for i, component in enumerate(binding.components) if component.element == name]
    if all(is_zero.get(binding.components[i].axis, not defaults[:, i].any()) for i in columns):
      yield f"{field.kind} {name!r} may get {cfg.field} of length zero."


Spans = dict[str, tuple[float, float]]
"""Lowest and highest value by axis."""
