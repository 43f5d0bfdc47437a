"""A randomiser bound to the model fields of many worlds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import mujoco
import numpy as np
import torch
from mjlab_core import match_names, where_
from torch import Tensor

from mjlab_dr.catalogue import FIELDS, candidates, element_names
from mjlab_dr.distributions import joint_sampler
from mjlab_dr.randomizers import FieldRandomizer


class ModelFields(Protocol):
  """What randomisers ask of a simulation of `num_envs` worlds."""

  @property
  def num_envs(self) -> int:
    """Number of worlds."""
    ...

  @property
  def device(self) -> torch.device:
    """Where the fields live."""
    ...

  @property
  def mj_model(self) -> mujoco.MjModel:
    """The compiled model; never written."""
    ...

  @property
  def model(self) -> Any:
    """Fields of MjModel as attributes: tensors (num_envs, ...) once expanded, in fixed memory."""
    ...

  def expand_model_fields(self, names: Iterable[str], /) -> None:
    """Gives these fields, and what derives from them, one value per world."""
    ...

  def default_field(self, name: str, /) -> Tensor:
    """The compiled value of a field, (1, ...)."""
    ...

  def recompute_constants(self, mask: Tensor | None = None, /) -> None:
    """Recomputes the derived fields of the masked worlds, bool (num_envs,)."""
    ...


class RandomizeField:
  """Writes draws of one randomiser into the worlds of a mask.

  Construction resolves names, checks the outcome against what is physical and expands the field; `apply` then runs
  inside a captured step.

  Args:
    cfg: the randomiser.
    sim: where the fields are.
    generator: source of the draws, on the device of `sim`; None is torch's global one.
    names: names that the pattern is matched against; None is all of the model that the field makes sense for.
    ids: the element of the model, or the column of `target`, behind each of `names`; None counts from 0.
    target: for fields that MjModel does not have, the tensor (num_envs, ...) to be written, in fixed memory.
    owner: whose randomiser it is, as error messages should say it.

  Raises:
    ValueError: the pattern matches nothing, a result may be unphysical, or a change could have no effect.
  """

  def __init__(
    self,
    cfg: FieldRandomizer,
    sim: ModelFields,
    *,
    generator: torch.Generator | None = None,
    names: Sequence[str] | None = None,
    ids: Sequence[int] | None = None,
    target: Tensor | None = None,
    owner: str = "",
  ) -> None:
    self.cfg, self.needs_constants = cfg, cfg.needs_constants
    self._field = FIELDS[cfg.field]
    self._sim, self._generator, self._target = sim, generator, target
    owner = f"{owner}: {cfg.field}" if owner else cfg.field
    if self._field.in_model == (target is not None):
      raise ValueError(f"{owner}: a target is for fields outside of MjModel, and only for those.")
    model, kind = sim.mj_model, self._field.kind
    if names is None:
      of_model = element_names(model, kind)
      ids = candidates(model, kind)
      names = [of_model[i] for i in ids]
    elif ids is None:
      ids = range(len(names))
    picked, self.element_names = match_names(cfg.pattern, names, what=kind, owner=owner)
    self.element_ids = [int(ids[i]) for i in picked]
    self.axes = list(cfg.values)
    self._check_effect(model, owner)

    width = len(self._field.axes)
    columns = np.add.outer(np.array(self.element_ids) * width, self.axes).ravel()
    if target is None:
      sim.expand_model_fields((cfg.field,))
      dtype = getattr(sim.model, cfg.field).dtype
      default = sim.default_field(cfg.field).reshape(1, -1)[:, columns.tolist()]
    else:
      dtype, default = target.dtype, target.new_zeros(1, len(columns))
    self.default = default.reshape(1, len(picked), len(self.axes)).to(dtype)
    """Compiled values of what it writes, (1, number of elements, number of written axes)."""
    self._check_result(owner)
    self._columns = _columns(columns, sim.device)
    self._sample = joint_sampler(list(cfg.values.values()), device=sim.device, dtype=dtype)
    self._shape = (sim.num_envs, 1 if cfg.shared else len(picked))

  def apply(self, mask: Tensor, *, recompute: bool = True) -> None:
    """Draws for all worlds and writes those of `mask`, bool (num_envs,); the others stay bit-identical.

    With `recompute` the derived fields follow at once; without, the caller does that after several randomisers.
    """
    draw = self._sample(self._shape, self._generator)
    operation = self.cfg.operation
    if operation == "add":
      draw = self.default + draw
    elif operation == "scale":
      draw = self.default * draw
    value = draw.expand(-1, *self.default.shape[1:]).flatten(1)
    flat = self._flat()
    if isinstance(self._columns, slice):
      where_(flat[:, self._columns], mask, value)
    else:
      flat.index_copy_(1, self._columns, torch.where(mask[:, None], value, flat.index_select(1, self._columns)))
    if recompute and self.needs_constants:
      self._sim.recompute_constants(mask)

  def values(self) -> Tensor:
    """What the worlds have now, (num_envs, number of elements, number of written axes), in new memory."""
    flat = self._flat()
    columns = self._columns
    now = flat[:, columns].clone() if isinstance(columns, slice) else flat.index_select(1, columns)
    return now.unflatten(1, self.default.shape[1:])

  def written(self) -> set[tuple[str, int, int]]:
    """(field, element, axis) of everything that it writes."""
    return {(self.cfg.field, element, axis) for element in self.element_ids for axis in self.axes}

  def _flat(self) -> Tensor:
    # Asked for each time, for an expansion by somebody else may have replaced the array. A view, never a copy.
    tensor = getattr(self._sim.model, self.cfg.field) if self._target is None else self._target
    return tensor.view(self._sim.num_envs, -1)

  def _check_result(self, owner: str) -> None:
    default = self.default[0]
    if self.cfg.operation == "absolute":
      return
    for j, (axis, distribution) in enumerate(self.cfg.values.items()):
      lo = distribution.support()[0]
      least = default[:, j] + lo if self.cfg.operation == "add" else default[:, j] * lo
      worst = int(least.argmin())
      if least[worst] < self._field.minimum:
        raise ValueError(
          f"{owner}: {self._field.kind} {self.element_names[worst]!r} may get {self._field.axes[axis]} "
          f"{least[worst].item():g}, below the physical minimum {self._field.minimum:g}."
        )

  def _check_effect(self, model: mujoco.MjModel, owner: str) -> None:
    if self._field.breaks_simple:
      for name, element in zip(self.element_names, self.element_ids, strict=True):
        if model.body_simple[element]:
          raise ValueError(
            f"{owner}: body {name!r} was compiled as simple, with its centre of mass fixed at its origin. "
            'Set simple="false" on it before compiling (`MjSpec.body(name).simple = False`).'
          )
    if self.cfg.field == "geom_friction":
      condim = max([*model.geom_condim, *model.pair_dim], default=1)
      needed = {0: 3, 1: 4, 2: 6}
      for axis in self.axes:
        if condim < needed[axis]:
          raise ValueError(
            f"{owner}: {self._field.axes[axis]} friction has no effect, for no contact can have condim "
            f"{needed[axis]}: the largest in the model is {condim}."
          )


def apply_all(terms: Sequence[RandomizeField], sim: ModelFields, mask: Tensor) -> None:
  """Applies several randomisers to the worlds of `mask`, bool (num_envs,), and recomputes derived fields once."""
  for term in terms:
    term.apply(mask, recompute=False)
  if any(term.needs_constants for term in terms):
    sim.recompute_constants(mask)


def _columns(columns: np.ndarray, device: torch.device) -> slice | Tensor:
  """A slice, which is a view to write through, if the columns are evenly spaced; else an index tensor."""
  steps = np.diff(columns)
  if len(columns) == 1 or (steps[0] > 0 and (steps == steps[0]).all()):
    step = int(steps[0]) if len(steps) else 1
    return slice(int(columns[0]), int(columns[-1]) + 1, step)
  return torch.tensor(columns, device=device)
