"""Randomisation without a simulation: one plain model, or tensors for any engine."""

from __future__ import annotations

import copy
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from types import MappingProxyType, SimpleNamespace
from typing import overload

import mujoco
import numpy as np
import torch
from mjlab_core import MjlabError, PositiveCount, check_name, check_value, draw_seed, make_generator
from mjlab_core.io.tables import table
from mjlab_core.mujoco.model_fields import followers
from torch import Tensor

from mjlab_dr.apply import RandomizeField, apply_all
from mjlab_dr.catalogue import FIELDS, followers_of
from mjlab_dr.fields import element_names
from mjlab_dr.randomizers import FieldRandomizer


@dataclass(frozen=True, kw_only=True)
class Change:
  """One number that a randomisation wrote."""

  field: str
  """Name of the field."""
  element: str
  """Name of the body, joint, geom, ..."""
  axis: str
  """Name of the component; empty for a scalar."""
  before: float
  """Compiled default."""
  after: float
  """Value that was drawn."""


class RandomizedTensors(dict[str, Tensor]):
  """Randomised and derived fields of many worlds by their MjModel name, (num_worlds, ...), in fixed memory."""

  def __init__(self, randomizers: Sequence[FieldRandomizer], fields: _BatchedFields, seed: int) -> None:
    self._fields, self._generator = fields, make_generator(fields.device, seed)
    self._terms = _bind(randomizers, fields, self._generator)
    self.resample()
    super().__init__(vars(fields.model))

  def resample(self, mask: Tensor | None = None, *, seed: int | None = None) -> None:
    """Draw again, from the defaults and in place, for the worlds of `mask`, bool (num_worlds,), or for all."""
    if seed is not None:
      self._generator.manual_seed(seed)
    everyone = torch.ones(self._fields.num_envs, dtype=torch.bool, device=self._fields.device)
    apply_all(self._terms, self._fields, everyone if mask is None else mask)


class Randomization:
  """Randomised state of one plain model, with its defaults."""

  def __init__(self, model: mujoco.MjModel, randomizers: Sequence[FieldRandomizer], seed: int) -> None:
    self.model, self.seed = model, seed
    """The model that is written, and the seed last used."""
    self._fields = _BatchedFields(copy.copy(model), 1, torch.device("cpu"), torch.float64)
    self._tensors = RandomizedTensors(randomizers, self._fields, seed)
    self._terms = self._tensors._terms
    # MuJoCo derives this number at compile time only, unless the author gave it.
    mean = model.dof_M0.mean() if model.nv else model.stat.meaninertia
    self._follow_inertia = bool(np.isclose(model.stat.meaninertia, mean, rtol=1e-9))
    self._write(self._tensors)

  def resample(self, seed: int | None = None) -> None:
    """Draw everything again from the defaults: from a seed, or from the running stream of random numbers."""
    self.seed = self.seed if seed is None else seed
    self._tensors.resample(seed=seed)
    self._write(self._tensors)

  def restore(self) -> None:
    """Restore the compiled values of the model."""
    self._write({name: self._fields.default_field(name) for name in self._fields.written})

  def changes(self) -> list[Change]:
    """Return all numbers that were written, each once, in the order of the randomisers."""
    found: dict[tuple[str, tuple[int, ...]], Change] = {}
    for term in self._terms:
      after, before = term.values()[0].tolist(), term.default[0].tolist()
      for c, old, new in zip(term.components, before, after, strict=True):
        change = Change(field=c.field, element=c.element, axis=c.axis, before=float(old), after=float(new))
        found.setdefault((c.field, c.columns), change)
    return list(found.values())

  def report(self) -> str:
    """Return a table of the changes, with values before and after."""
    rows = [(c.field, c.element, c.axis, f"{c.before:.6g}", f"{c.after:.6g}") for c in self.changes()]
    return table(("field", "element", "axis", "before", "after"), rows)

  def _write(self, tensors: Mapping[str, Tensor]) -> None:
    for name in self._fields.written:
      _put(self.model, name, tensors[name][0].numpy())
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
  tensors: Mapping[str, Tensor],
  seed: int | None = None,
) -> RandomizedTensors: ...


@overload
def randomize(
  model: mujoco.MjModel,
  randomizers: Sequence[FieldRandomizer],
  *,
  num_worlds: int,
  device: torch.device | str = "cpu",
  dtype: torch.dtype = torch.float32,
  seed: int | None = None,
) -> RandomizedTensors: ...


def randomize(
  model: mujoco.MjModel,
  randomizers: Sequence[FieldRandomizer],
  *,
  num_worlds: int | None = None,
  tensors: Mapping[str, Tensor] | None = None,
  device: torch.device | str = "cpu",
  dtype: torch.dtype = torch.float32,
  seed: int | None = None,
) -> Randomization | RandomizedTensors:
  """Randomise one plain model in place, or draw tensors for many worlds and leave the model alone.

  Args:
    model: any compiled model.
    randomizers: randomisers in their order. If two write the same number, the second one starts from the result of
      the first one, or is refused if that might become unphysical.
    num_worlds: None writes `model`; a number returns tensors for so many worlds.
    tensors: your own fields by their MjModel name, (num_worlds, ...), which are written in place; missing ones are
      made like them.
    device: device of the tensors.
    dtype: their type.
    seed: of the draws; None takes one from the operating system.

  Returns:
    For one model a `Randomization`, which reports, draws again and restores. For many worlds a dict of the randomised
    and the derived fields by their MjModel name, (num_worlds, ...), which draws again for those of a mask.

  Raises:
    MjlabError: a pattern matches nothing, a value is written twice, or a result may be unphysical; by name.
  """
  seed = draw_seed() if seed is None else seed
  if tensors is not None:
    known = {*FIELDS, *(name for field in FIELDS for name in followers_of(field))}
    for name in tensors:
      check_name("field", name, sorted(known), "randomize: tensors")
    first = next(iter(tensors.values()))
    num_worlds, device = len(first), first.device
    dtype = next((x.dtype for x in tensors.values() if x.is_floating_point()), dtype)
  if num_worlds is None:
    return Randomization(model, randomizers, seed)
  check_value("randomize: num_worlds", num_worlds, PositiveCount)
  fields = _BatchedFields(copy.copy(model), num_worlds, torch.device(device), dtype, tensors or {})
  return RandomizedTensors(randomizers, fields, seed)


def _bind(
  randomizers: Sequence[FieldRandomizer], fields: _BatchedFields, generator: torch.Generator
) -> list[RandomizeField]:
  terms: list[RandomizeField] = []
  writers: dict[tuple[str, Hashable], str] = {}
  for cfg in randomizers:
    if cfg.row.kind == "target":
      raise MjlabError(f"{cfg.label}: it belongs to actuator models, which a model alone does not have.")
    terms.append(RandomizeField(cfg, fields, generator=generator, earlier=writers))
    for number, description in terms[-1].claims.items():
      if number in writers and not cfg.composes:
        raise MjlabError(
          f"{description} is written by two randomizers, {writers[number]} and {cfg.label}, and the second one would "
          "undo the first. Only scales, shifts of unbounded numbers and pseudo-inertias can be combined."
        )
      writers.setdefault(number, cfg.label)
  return terms


def _put(model: mujoco.MjModel, name: str, value: np.ndarray) -> None:
  owner, _, attribute = name.rpartition(".")
  setattr(model.opt if owner else model, attribute, value)


class _BatchedFields:
  """Model fields of many worlds as plain tensors, with MuJoCo's own `mj_setConst` for what derives from them."""

  def __init__(
    self,
    mj_model: mujoco.MjModel,
    num_envs: int,
    device: torch.device,
    dtype: torch.dtype,
    tensors: Mapping[str, Tensor] = MappingProxyType({}),
  ) -> None:
    self.mj_model, self.num_envs, self.device, self.dtype = mj_model, num_envs, device, dtype
    self.model = SimpleNamespace()
    self._given = tensors
    self.written: dict[str, None] = {}
    """Fields of MjModel that randomisers write; the other tensors are derived from them."""

  def default_field(self, name: str) -> Tensor:
    """Return the compiled value, (1, ...); zero for a field that MjModel does not have."""
    if name in FIELDS and not FIELDS[name].in_model:
      return torch.zeros(1, len(element_names(self.mj_model, FIELDS[name].kind)), device=self.device, dtype=self.dtype)
    value = torch.tensor(np.asarray(attrgetter(name)(self.mj_model)), device=self.device)
    return (value.to(self.dtype) if value.is_floating_point() else value).unsqueeze(0)

  def expand_model_fields(self, names: Iterable[str]) -> None:
    """Give these fields, and those that derive from them, one value per world."""
    for name in names:
      if FIELDS[name].in_model:
        self.written[name] = None
      for field in (name, *followers(name)):
        default = self.default_field(field)
        if not hasattr(self.model, field) and default.numel() > 0:
          setattr(self.model, field, self._given_or_new(field, default))

  def _given_or_new(self, name: str, default: Tensor) -> Tensor:
    new = default.repeat(self.num_envs, *[1] * (default.dim() - 1))
    given = self._given.get(name, new)
    if (given.shape, given.dtype, given.device) != (new.shape, new.dtype, new.device) or not given.is_contiguous():
      is_, must = (f"{tuple(x.shape)}, {x.dtype} on {x.device}" for x in (given, new))
      raise MjlabError(f"randomize: tensor '{name}' is {is_}; it must be {must}, and contiguous.")
    return given

  def recompute_constants(self, mask: Tensor | None = None) -> None:
    """Run `mj_setConst` on the host for the masked worlds, one after the other."""
    worlds = range(self.num_envs) if mask is None else mask.nonzero().flatten().tolist()
    fields: dict[str, Tensor] = vars(self.model)
    derived = [name for source in self.written for name in followers(source) if name in fields]
    # On a CPU these share the memory of the tensors.
    host = {name: tensor.cpu().numpy() for name, tensor in fields.items()}
    scratch = copy.copy(self.mj_model)
    data = mujoco.MjData(scratch)
    for world in worlds:
      for name in self.written:
        _put(scratch, name, host[name][world])
      mujoco.mj_setConst(scratch, data)
      for name in derived:
        host[name][world] = getattr(scratch, name)
    for name in derived:
      fields[name].copy_(torch.from_numpy(host[name]))
