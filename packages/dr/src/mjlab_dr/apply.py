"""A randomiser bound to the model fields of many worlds."""

from __future__ import annotations

from collections.abc import Callable, Container, Hashable, Mapping, Sequence
from itertools import accumulate, product
from typing import Protocol

import torch
from mjlab_core import MjlabError, ModelFields, as_slice, normalize, quat_from_euler_xyz, quat_mul, where_
from torch import Tensor

from mjlab_dr.binding import (
  Component,
  components_of,
  matched,
  result_problems,
  with_effect,
  with_ids,
)
from mjlab_dr.catalogue import needs_constants
from mjlab_dr.distributions import Distribution, joint_sampler
from mjlab_dr.inertia import perturb_inertia
from mjlab_dr.randomizers import FieldRandomizer


class Quantity(Protocol):
  """Values of elements outside MjModel, one column each, that a randomiser can write."""

  @property
  def names(self) -> Sequence[str]:
    """Names of the elements."""
    ...

  @property
  def default(self) -> Tensor:
    """Values to start from, (1 or num_envs, number of elements)."""
    ...

  @property
  def claims(self) -> Mapping[tuple[str, Hashable], str]:
    """Descriptions of the numbers that a write changes, by field and element or column."""
    ...

  def values(self) -> Tensor:
    """Return the present values, (num_envs, number of elements), in new memory."""
    ...

  def write(self, values: Tensor, mask: Tensor) -> None:
    """Write values, (num_envs, number of elements), into the worlds of `mask`, bool (num_envs,)."""
    ...


class RandomizeField:
  """A randomiser bound to the fields of many worlds, which writes its draws into the worlds of a mask.

  Construction resolves names, refuses unphysical results and expands the field; `apply` then runs inside a captured
  step.

  Args:
    cfg: the randomiser.
    sim: the model fields of the worlds.
    generator: source of the draws, on the device of `sim`; None is torch's global one.
    elements: id in the model, or column of `target`, of each element to match the pattern against, by name; None is
      all elements of the model with this field.
    target: for fields that MjModel does not have: the tensor (num_envs, ...) to write, in fixed memory, or a quantity,
      all elements of which are drawn.
    prefix: prefix that names of materials and textures may omit.
    earlier: fields and columns that earlier randomisers write; draws start from their results instead of the default.
    owner: name of the owner in error messages.

  Raises:
    MjlabError: the pattern matches nothing, a result may be unphysical, or a change could have no effect.
  """

  def __init__(
    self,
    cfg: FieldRandomizer,
    sim: ModelFields,
    *,
    generator: torch.Generator | None = None,
    elements: Mapping[str, int] | None = None,
    target: Tensor | Quantity | None = None,
    prefix: str = "",
    earlier: Container[tuple[str, Hashable]] = (),
    owner: str = "",
  ) -> None:
    self.cfg, self.needs_constants = cfg, needs_constants(cfg.field)
    self._form, self._sim, self._generator = cfg.row.form, sim, generator
    self._target = target
    self._quantity = None if isinstance(target, Tensor) else target
    owner = f"{owner}: {cfg.field}" if owner else cfg.field
    model = sim.mj_model
    if self._quantity is None:
      defaults = self._default_rows(cfg.shown_in).cpu().numpy()
      elements = matched(cfg, model, elements, owner)
      elements, idle = with_effect(cfg, model, elements, defaults, earlier, in_model=target is None, owner=owner)
    else:
      # A quantity checks its values itself, and takes all of them.
      elements, idle = {name: i for i, name in enumerate(self._quantity.names)}, ()
    self.element_names = tuple(elements)
    """Names of the elements that it changes."""
    self.components = components_of(cfg, model, elements, idle)
    """All numbers that it writes, in the order of its fields."""
    distributions = with_ids(cfg, model, owner, prefix)
    self.distributions = dict(zip(cfg.values, distributions, strict=True))
    """Distribution of each axis, with the ids of this model in place of names."""
    self._strength: Tensor | None = None
    self._find_columns(earlier)
    for problem in result_problems(cfg, self.components, self.default.double().cpu().numpy(), model):
      raise MjlabError(f"{owner}: {problem}")
    self._prepare_draws(distributions)

  def _find_columns(self, earlier: Container[tuple[str, Hashable]]) -> None:
    """Find the columns of each field that are written, and of the one that moves along; expand fields of the model."""
    sim, target, fields = self._sim, self._target, list(dict.fromkeys(component.field for component in self.components))
    follower = self.cfg.row.moves_with
    if target is None:
      sim.expand_model_fields((*fields, follower) if follower else fields)

    def columns(field: str, components: Sequence[Component]) -> _Columns:
      def rows() -> Tensor:
        # Looked up each time: another expansion may have replaced the array. A view, never a copy.
        return (target if isinstance(target, Tensor) else getattr(sim.model, field)).view(sim.num_envs, -1)

      flat = [column for component in components for column in component.columns]
      is_written = [(field, column) in earlier for column in flat]
      return _Columns(rows, flat, self._default_rows(field), is_written)

    self._writes: list[Quantity | _Columns]
    if self._quantity is None:
      self._writes = [columns(name, [c for c in self.components if c.field == name]) for name in fields]
    else:
      self._writes = [self._quantity]
    self._follower = columns(follower, self.components) if follower else None
    ends = list(accumulate(len(component.columns) for component in self.components))
    self._first = torch.tensor([0, *ends[:-1]], device=sim.device)
    """Index of the first column of each component among all that are written."""

  def _default_rows(self, field: str) -> Tensor:
    """Return the values of a field to start from, (1 or num_envs, number of columns)."""
    # A view, through which later values of each world are seen.
    target = self._target
    default = torch.zeros_like(target[:1]) if isinstance(target, Tensor) else self._sim.default_field(field)
    return default.view(len(default), -1)

  def _prepare_draws(self, distributions: Sequence[Distribution]) -> None:
    """Make the sampler, and the way from its draws to axes and columns."""
    cfg, device, dtype = self.cfg, self._sim.device, self._writes[0].default.dtype
    self._dtype = dtype if dtype.is_floating_point else torch.float64
    self._sample = joint_sampler(
      distributions[:1] if cfg.isotropic else distributions, device=device, dtype=self._dtype
    )
    axes = list(cfg.values)
    # Draws of all axes, in order, are used as they are.
    is_whole = axes == list(range(len(cfg.row.axes)))
    self._places = None if is_whole else torch.tensor(axes, device=device)
    self._shape = (self._sim.num_envs, 1 if cfg.shared else len(self.element_names))
    self._full = (self._sim.num_envs, len(self.element_names), len(axes))
    self._sources = None
    if self._form == "plain":
      numbers = product(self.element_names, (cfg.row.axes[axis] for axis in axes))
      places = {number: place for place, number in enumerate(numbers)}
      sources = [places[c.element, c.axis] for c in self.components for _ in c.columns]
      # A draw for each number, in order, is used as it is.
      self._sources = None if sources == list(places.values()) else torch.tensor(sources, device=device)
    if self._form == "intrinsics":
      cameras = [component.row for component in self.components if component.field == "cam_fovy"]
      heights = 0.5 * self._sim.mj_model.cam_sensorsize[cameras, 1]
      self._half_heights = torch.tensor(heights, device=device, dtype=self._dtype)

  @property
  def default(self) -> Tensor:
    """Value of each of `components` to start from, (1 or num_envs, number of components)."""
    parts = [write.default for write in self._writes]
    worlds = max(len(part) for part in parts)
    return torch.cat([part.expand(worlds, -1) for part in parts], -1)[:, self._first]

  @property
  def strength(self) -> Tensor:
    """Share of the way from the default, 0, to the draw, 1, that is written, ().

    For curricula: written in place it widens every range. Ask for it before the first step is recorded.

    Raises:
      MjlabError: the field is a choice.
    """
    if self.cfg.row.integer:
      raise MjlabError(f"{self.cfg.label}: it is a choice, which cannot be widened.")
    if self._strength is None:
      self._strength = torch.ones((), device=self._sim.device, dtype=self._dtype)
    return self._strength

  def apply(self, mask: Tensor, *, recompute: bool = True) -> None:
    """Draw for all worlds and write those of `mask`, bool (num_envs,); the others stay bit-identical.

    With `recompute` the derived fields follow at once; otherwise the caller recomputes them after several randomisers.
    """
    draw = self._sample(self._shape, self._generator).expand(self._full)
    # On a CPU a look at the mask is free, and most steps reset no world. The draw is made all the same.
    if mask.device.type == "cpu" and not mask.numpy().any():
      return
    results = self._results(draw)
    if self._follower is not None:
      moved = results[0] - self._start(self._writes[0])
      self._follower.write(self._follower.start() + moved, mask)
    for write, value in zip(self._writes, results, strict=True):
      write.write(value, mask)
    if recompute and self.needs_constants:
      self._sim.recompute_constants(mask)

  def values(self) -> Tensor:
    """Return the present values, (num_envs, number of `components`), in new memory."""
    return torch.cat([write.values() for write in self._writes], -1).to(self._dtype)[:, self._first]

  @property
  def claims(self) -> dict[tuple[str, Hashable], str]:
    """Descriptions of the numbers that it writes, by field and column or element."""
    if self._quantity is not None:
      return dict(self._quantity.claims)
    row, claims = self.cfg.row, dict[tuple[str, Hashable], str]()
    for c in self.components:
      for field in filter(None, (c.field, row.moves_with)):
        claims |= {(field, column): f"{field} of {row.kind} '{c.element}'" for column in c.columns}
    return claims

  def _start(self, write: Quantity | _Columns) -> Tensor:
    return write.start() if isinstance(write, _Columns) else write.default

  def _results(self, draw: Tensor) -> list[Tensor]:
    """Return the values to write to each field, in the order of its columns."""
    starts = [self._start(write) for write in self._writes]
    if self._form in ("plain", "servo"):
      draw = draw.flatten(1)
      draw = draw if self._sources is None else draw.index_select(1, self._sources)
      value = self._combined(starts[0], draw)
      return [value] if self._form == "plain" else [value, -value]
    by_element = [start.unflatten(1, (len(self.element_names), -1)) for start in starts]
    default = by_element[0]
    if self._form in ("direction", "intrinsics"):
      operation = self.cfg.operation
      neutral = default if operation == "absolute" else torch.full_like(default, float(operation == "scale"))
      vector = self._combined(default, self._on_all_axes(draw, neutral))
      if self._form == "direction":
        return [normalize(vector).flatten(1)]
      return [vector.flatten(1), torch.rad2deg(2.0 * torch.atan(self._half_heights / vector[..., 1]))]
    draw = draw if self._strength is None else draw * self._strength
    draw = self._on_all_axes(draw, draw.new_zeros(1, 1, len(self.cfg.row.axes)))
    if self._form == "rotation":
      turn = quat_from_euler_xyz(*draw.unbind(-1))
      return [quat_mul(turn, default.expand_as(turn)).flatten(1)]
    mass, com, inertia, quat = by_element
    return [x.flatten(1) for x in perturb_inertia(mass.squeeze(-1), com, inertia, quat, draw)]

  def _combined(self, default: Tensor, draw: Tensor) -> Tensor:
    """Return the default changed by a draw as the operation says, as far as the strength goes."""
    if self.cfg.operation == "add":
      draw = default + draw
    elif self.cfg.operation == "scale":
      draw = default * draw
    return draw if self._strength is None else torch.lerp(default.expand_as(draw), draw, self._strength)

  def _on_all_axes(self, draw: Tensor, otherwise: Tensor) -> Tensor:
    """Return draws on the axes that are drawn, and `otherwise` on the others, (num_envs, elements, all axes)."""
    if self._places is None:
      return draw
    return otherwise.to(draw.dtype).expand(*draw.shape[:2], -1).index_copy(-1, self._places, draw)


class _Columns:
  """Columns of one field, in flat rows of worlds.

  Args:
    rows: function that returns the present rows, (num_envs, ...), a view.
    columns: the columns, with repetitions where several belong to one component.
    default: rows to start from, (1 or num_envs, ...).
    is_written: True for the columns that an earlier randomiser writes.
  """

  def __init__(
    self, rows: Callable[[], Tensor], columns: Sequence[int], default: Tensor, is_written: Sequence[bool]
  ) -> None:
    self._rows, self._default_rows = rows, default
    self._all = torch.tensor(columns, device=default.device)
    self._slice = as_slice(columns, spaced=True)
    self._is_written = torch.tensor(is_written, device=default.device) if any(is_written) else None
    # Values per world change when a state of other worlds is loaded, so they are looked up every time.
    self._constant = default.index_select(1, self._all) if len(default) < len(rows()) else None

  @property
  def default(self) -> Tensor:
    """Values to start from, (1 or num_envs, number of columns)."""
    if self._constant is not None:
      return self._constant
    rows = self._default_rows
    return rows.index_select(1, self._all) if self._slice is None else rows[:, self._slice]

  def start(self) -> Tensor:
    """Return the default, or the result of an earlier randomiser, (1 or num_envs, number of columns)."""
    return self.default if self._is_written is None else torch.where(self._is_written, self.values(), self.default)

  def values(self) -> Tensor:
    """Return the present values, (num_envs, number of columns), in new memory."""
    return self._rows().index_select(1, self._all)

  def write(self, values: Tensor, mask: Tensor) -> None:
    """Write (num_envs, number of columns) into the masked rows."""
    rows = self._rows()
    if self._slice is not None:
      where_(rows[:, self._slice], mask, values)
    else:
      written = torch.where(mask[:, None], values.to(rows.dtype), self.values())
      rows.index_copy_(1, self._all, written)


def apply_all(terms: Sequence[RandomizeField], sim: ModelFields, mask: Tensor) -> None:
  """Apply several randomisers to the worlds of `mask`, bool (num_envs,), and recompute derived fields once."""
  for term in terms:
    term.apply(mask, recompute=False)
  if any(term.needs_constants for term in terms):
    sim.recompute_constants(mask)
