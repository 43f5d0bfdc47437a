"""Randomisation without a simulation: one plain model, or tensors for any engine."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import overload

import mujoco
import numpy as np
import torch
from mjlab_core import draw_seed, make_generator
from numpy.typing import NDArray
from torch import Tensor

from mjlab_dr.apply import RandomizeField, apply_all
from mjlab_dr.catalogue import FIELDS, count, element_names
from mjlab_dr.randomizers import FieldRandomizer


@dataclass(frozen=True, kw_only=True)
class Change:
  """One number that a randomisation wrote."""

  field: str
  """Name of the field."""
  element: str
  """Name of the geom, body or joint."""
  axis: str
  """Name of the component; empty for a scalar."""
  before: float
  """Compiled default."""
  after: float
  """What was drawn."""


class Randomization:
  """The randomised state of one plain model, which remembers the defaults."""

  def __init__(self, model: mujoco.MjModel, randomizers: Sequence[FieldRandomizer], seed: int) -> None:
    self.model, self.seed = model, seed
    """The model that is written, and the seed last used."""
    self._fields = _BatchedFields(copy.copy(model), 1, torch.device("cpu"), torch.float64)
    self._generator = make_generator("cpu", seed)
    self._terms = _bind(randomizers, self._fields, self._generator)
    # MuJoCo derives this number at compile time only, unless the author gave it.
    mean = model.dof_M0.mean() if model.nv else model.stat.meaninertia
    self._follow_inertia = bool(np.isclose(model.stat.meaninertia, mean, rtol=1e-9))
    self.resample(seed)

  def resample(self, seed: int | None = None) -> None:
    """Draws everything anew from the defaults: from a seed, or going on with the stream of random numbers."""
    if seed is not None:
      self.seed = seed
      self._generator.manual_seed(seed)
    apply_all(self._terms, self._fields, torch.ones(1, dtype=torch.bool))
    self._write({name: tensor[0].numpy() for name, tensor in vars(self._fields.model).items()})

  def restore(self) -> None:
    """Gives the model its compiled values back."""
    self._write({name: self._fields.default_field(name)[0].numpy() for name in vars(self._fields.model)})

  def values(self, field: str) -> NDArray[np.float64]:
    """A randomised field as last drawn, all elements; the way to those that MjModel does not have."""
    return getattr(self._fields.model, field)[0].numpy().copy()

  def changes(self) -> list[Change]:
    """All numbers that were written, in the order of the randomisers."""
    out: list[Change] = []
    for term in self._terms:
      after, before = term.values()[0], term.default[0]
      axes = FIELDS[term.cfg.field].axes
      for i, element in enumerate(term.element_names):
        for j, axis in enumerate(term.axes):
          pair = {"before": before[i, j].item(), "after": after[i, j].item()}
          out.append(Change(field=term.cfg.field, element=element, axis=axes[axis], **pair))
    return out

  def report(self) -> str:
    """A table of what changed, from what to what."""
    rows = [("field", "element", "axis", "before", "after")]
    rows += [(c.field, c.element, c.axis, f"{c.before:.6g}", f"{c.after:.6g}") for c in self.changes()]
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)

  def _write(self, fields: dict[str, np.ndarray]) -> None:
    for name, value in fields.items():
      if name in FIELDS and FIELDS[name].in_model:
        getattr(self.model, name)[:] = value
    if any(term.needs_constants for term in self._terms):
      mujoco.mj_setConst(self.model, mujoco.MjData(self.model))
      if self._follow_inertia and self.model.nv:
        self.model.stat.meaninertia = self.model.dof_M0.mean()


@overload
def randomize(
  model: mujoco.MjModel, randomizers: Sequence[FieldRandomizer], *, seed: int | None = None
) -> Randomization: ...


@overload
def randomize(
  model: mujoco.MjModel,
  randomizers: Sequence[FieldRandomizer],
  *,
  num_worlds: int,
  device: torch.device | str = "cpu",
  dtype: torch.dtype = torch.float32,
  seed: int | None = None,
) -> dict[str, Tensor]: ...


def randomize(
  model: mujoco.MjModel,
  randomizers: Sequence[FieldRandomizer],
  *,
  num_worlds: int | None = None,
  device: torch.device | str = "cpu",
  dtype: torch.dtype = torch.float32,
  seed: int | None = None,
) -> Randomization | dict[str, Tensor]:
  """Randomises one plain model in place, or draws tensors for many worlds and leaves the model alone.

  Args:
    model: any compiled model.
    randomizers: what to randomise.
    num_worlds: None writes `model`; a number returns tensors for so many worlds.
    device: where the tensors live.
    dtype: their type.
    seed: of the draws; None takes one from the operating system.

  Returns:
    For one model a `Randomization`, which reports, draws again and restores. For many worlds the randomised and the
    derived fields by their MjModel name, (num_worlds, ...).

  Raises:
    ValueError: a pattern matches nothing, a value is written twice, or a result may be unphysical; by name.
  """
  seed = draw_seed() if seed is None else seed
  if num_worlds is None:
    return Randomization(model, randomizers, seed)
  if num_worlds < 1:
    raise ValueError(f"randomize: num_worlds must be at least 1, got {num_worlds}.")
  device = torch.device(device)
  fields = _BatchedFields(copy.copy(model), num_worlds, device, dtype)
  terms = _bind(randomizers, fields, make_generator(device, seed))
  apply_all(terms, fields, torch.ones(num_worlds, dtype=torch.bool, device=device))
  return dict(vars(fields.model))


def _bind(
  randomizers: Sequence[FieldRandomizer], fields: _BatchedFields, generator: torch.Generator
) -> list[RandomizeField]:
  terms: list[RandomizeField] = []
  writer: dict[tuple[str, int, int], FieldRandomizer] = {}
  for cfg in randomizers:
    fields.expand_model_fields((cfg.field,))
    kind = FIELDS[cfg.field].kind
    target = None if FIELDS[cfg.field].in_model else getattr(fields.model, cfg.field)
    term = RandomizeField(cfg, fields, generator=generator, target=target)
    for key in term.written():
      if key in writer:
        name = element_names(fields.mj_model, kind)[key[1]]
        raise ValueError(f"{kind} {name!r} is written by two randomizers, {writer[key].label} and {cfg.label}.")
      writer[key] = cfg
    terms.append(term)
  return terms


class _BatchedFields:
  """Model fields of many worlds as plain tensors, with MuJoCo's own `mj_setConst` for what derives from them."""

  def __init__(self, mj_model: mujoco.MjModel, num_envs: int, device: torch.device, dtype: torch.dtype) -> None:
    self.mj_model, self.num_envs, self.device, self.dtype = mj_model, num_envs, device, dtype
    self.model = SimpleNamespace()

  def default_field(self, name: str) -> Tensor:
    """The compiled value, (1, ...); zero for a field that MjModel does not have."""
    if name in FIELDS and not FIELDS[name].in_model:
      return torch.zeros(1, count(self.mj_model, FIELDS[name].kind), device=self.device, dtype=self.dtype)
    return torch.tensor(getattr(self.mj_model, name), device=self.device, dtype=self.dtype).unsqueeze(0)

  def expand_model_fields(self, names: Iterable[str]) -> None:
    """Gives these fields, and what derives from them, one value per world."""
    for name in names:
      for field in (name, *FIELDS[name].derived):
        default = self.default_field(field)
        if not hasattr(self.model, field) and default.numel() > 0:
          setattr(self.model, field, default.repeat(self.num_envs, *[1] * (default.dim() - 1)))

  def recompute_constants(self, mask: Tensor | None = None) -> None:
    """Runs `mj_setConst` on the host for the masked worlds, one after the other."""
    worlds = range(self.num_envs) if mask is None else mask.nonzero().flatten().tolist()
    fields: dict[str, Tensor] = vars(self.model)
    sources = [name for name in fields if name in FIELDS and FIELDS[name].needs_constants]
    derived = [name for name in fields if name not in FIELDS]
    host = {name: fields[name].double().cpu().numpy() for name in sources}
    found = {name: fields[name].double().cpu().numpy() for name in derived}
    scratch = copy.copy(self.mj_model)
    data = mujoco.MjData(scratch)
    for world in worlds:
      for name in sources:
        getattr(scratch, name)[:] = host[name][world]
      mujoco.mj_setConst(scratch, data)
      for name in derived:
        found[name][world] = getattr(scratch, name)
    for name in derived:
      fields[name].copy_(torch.from_numpy(found[name]))
