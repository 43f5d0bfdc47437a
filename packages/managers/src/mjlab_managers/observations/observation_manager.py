"""Observations: the inputs of policy and critic."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from typing import Any, cast

import torch
from mjlab_core import ConfigError, MjlabError, check_name, where_
from mjlab_core.config import write_locked
from mjlab_core.io.tables import table

from mjlab_managers.env import ManagerEnv
from mjlab_managers.manager import ManagerBase
from mjlab_managers.observations.deployment import Reading, TermSource
from mjlab_managers.observations.observation_cfg import ObservationGroupCfg, ObservationTermCfg
from mjlab_managers.observations.observation_memory import Memory
from mjlab_managers.observations.observation_processing import Processing, TermLayout
from mjlab_managers.terms.binding import Term, cfg_problems, same
from mjlab_managers.terms.term import ManagerTermBase
from mjlab_managers.vector_manager import nan_if_zero

Observation = torch.Tensor | dict[str, torch.Tensor]


class ObservationManager(ManagerBase[Any]):
  """Manager that evaluates every distinct term once and processes all groups as columns of one frame.

  Noise, clip, scale and the NaN check work on the whole frame. Delays and histories work on their columns. The result
  is one block of memory, and `buffers` are views of it.
  """

  cfg_type = ObservationTermCfg
  live_fields = frozenset({"noise", "clip", "scale"})

  def __init__(
    self, cfgs: Mapping[str, ObservationGroupCfg | None], env: ManagerEnv, *, problems: list[str] | None = None
  ) -> None:
    self._groups: dict[str, ObservationGroupCfg] = {}
    self._slots: dict[str, TermLayout] = {}
    super().__init__(cast(Any, cfgs), env, problems=problems)

  # Build.

  @classmethod
  def check(cls, cfgs: Mapping[str, Any]) -> list[str]:
    groups = {group: cfg for group, cfg in cfgs.items() if cfg is not None}
    problems = [
      f"{cls.__name__}: group '{name}': {line}" for name, cfg in groups.items() for line in _group_problems(cfg)
    ]
    return problems + super().check(dict(_paths(groups)))

  @classmethod
  def _cfg_problems(cls, cfg: Any) -> list[str]:
    problems = super()._cfg_problems(cfg)
    if not problems and cfg.delay_min_lag > cfg.delay_max_lag:
      problems.append(f"needs delay_min_lag <= delay_max_lag, got {cfg.delay_min_lag} and {cfg.delay_max_lag}.")
    return problems

  def _term_cfgs(self, cfgs: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    for name, cfg in cfgs.items():
      if cfg is not None:
        with self._noting(name, "group"):
          if problems := _group_problems(cfg):
            raise ConfigError(*problems)
          group = copy.copy(cfg)
          group.terms = {}
          self._groups[name] = self._locked(name, group, frozenset({"corrupt", "nan_policy"}))
    return _paths({name: cfgs[name] for name in self._groups})

  def _mistake(self, term: Term) -> str:
    def fits(value: torch.Tensor) -> bool:
      return value.is_floating_point() and value.dim() >= 2 and value.shape[0] == self.num_envs

    value = self._tried(term)
    if misfit := self._misfit(value, f"float ({self.num_envs}, ...) with at least two dimensions", fits):
      return misfit
    shape = tuple(value.shape[1:])
    if term.name not in self._slots:
      self._slots[term.name] = self._slot(term, shape)
    elif shape != (before := self._slots[term.name].frame_shape):
      return f"returned {before} for each world before, and {shape} now."
    return ""

  def _slot(self, term: Term, shape: tuple[int, ...]) -> TermLayout:
    group, _, name = term.name.partition("/")
    group_cfg, cfg = self._groups[group], self._cfgs[term.name]
    given: Any = cfg if group_cfg.history_length is None else group_cfg
    history, flatten = given.history_length, given.flatten_history_dim
    width, out_shape = math.prod(shape), shape
    if history > 0:
      out_shape = (history * width,) if flatten else (history, *shape)
    earlier = list(self._slots.values())
    frame = earlier[-1].frame.stop if earlier else 0
    out = earlier[-1].out.stop if earlier else 0
    column = earlier[-1].columns.stop if earlier and earlier[-1].group == group else 0
    out_width = math.prod(out_shape)
    return TermLayout(
      group=group,
      name=name,
      group_cfg=group_cfg,
      cfg=cfg,
      term=term,
      frame_shape=shape,
      history_length=history,
      shape=out_shape,
      columns=slice(column, column + out_width),
      frame=slice(frame, frame + width),
      out=slice(out, out + out_width),
    )

  def _make(self) -> None:
    slots = list(self._slots.values())
    self._by_group = {name: [slot for slot in slots if slot.group == name] for name in self._groups}
    for name, group in self._groups.items():
      members = self._by_group[name]
      write_locked(group, terms={slot.name: slot.cfg for slot in members})
      self._problems += [
        f"term '{slot.path}': shape {slot.shape} cannot be concatenated; flatten it, or set concatenate_terms=False on "
        f"group '{name}'."
        for slot in members
        if group.concatenate_terms and len(slot.shape) > 1 and len(members) > 1
      ]
    self._frame = torch.zeros(self.num_envs, slots[-1].frame.stop if slots else 0, device=self.device)
    self._clean = torch.zeros_like(self._frame)
    self._out = self.state((slots[-1].out.stop if slots else 0,))
    self._processing = Processing(self._slots, self.env, self._noting)
    self._memory = Memory(slots, self.env)
    self._share()
    self.buffers: dict[str, Observation] = self._views(self._out)
    """Observation of each group, float32 (N, D) or a dict of terms; always the same memory."""

  def _share(self) -> None:
    """Share one evaluation among terms with the same function and parameters. Class terms are never shared."""
    self._evaluated: dict[str, Term] = {}
    for path, slot in self._slots.items():
      twins = (term for term in self._evaluated.values() if _are_equal(term, slot.term))
      self._evaluated[path] = next(twins, slot.term)
    self._distinct = list(dict.fromkeys(self._evaluated.values()))

  def _views(self, memory: torch.Tensor) -> dict[str, Observation]:
    """Return the observation of each group in a memory of all columns."""
    views: dict[str, Observation] = {}
    for group, slots in self._by_group.items():
      terms = {slot.name: memory[:, slot.out].unflatten(1, slot.shape) for slot in slots}
      if not self._groups[group].concatenate_terms:
        views[group] = terms
      elif len(slots) == 1:
        views[group] = terms[slots[0].name]
      elif slots:
        views[group] = memory[:, slots[0].out.start : slots[-1].out.stop]
    return views

  # Interface for users.

  @property
  def active_groups(self) -> list[str]:
    """Names of the groups in order."""
    return list(self._by_group)

  @property
  def active_terms(self) -> dict[str, list[str]]:
    """Names of the terms of each group in order."""
    return {group: [slot.name for slot in slots] for group, slots in self._by_group.items()}

  @property
  def group_obs_dim(self) -> dict[str, tuple[int, ...] | list[tuple[int, ...]]]:
    """Shape of the observation of one world by group; a list of shapes if terms are not concatenated."""
    return {
      group: tuple(view.shape[1:]) if isinstance(view, torch.Tensor) else self.group_obs_term_dim[group]
      for group, view in self.buffers.items()
    }

  @property
  def group_obs_concatenate(self) -> dict[str, bool]:
    """`concatenate_terms` of each group."""
    return {group: self._groups[group].concatenate_terms for group in self.active_groups}

  @property
  def group_obs_term_dim(self) -> dict[str, list[tuple[int, ...]]]:
    """Shapes of the terms of one world by group."""
    return {group: [slot.shape for slot in slots] for group, slots in self._by_group.items()}

  def layout(self, group: str) -> list[TermLayout]:
    """Return the columns and the processing of each term of a group."""
    return self._lookup(self._by_group, group)

  def source(self, group: str, name: str) -> TermSource:
    """Return the computation of a term from readings outside the simulation.

    Raises:
      UnknownNameError: no such group or term.
      MjlabError: the term declares no source.
    """
    term, cfg = self.term(f"{group}/{name}"), self.get_term_cfg(group, name)
    if cfg.source is not None:
      return TermSource(readings=(Reading(name=cfg.source, read=term),))
    describe = getattr(term.func, "source", None)
    if describe is None:
      raise MjlabError(
        f"{self.label}: term '{group}/{name}' declares no source, so a robot cannot compute it. Leave it out of the "
        "policy's observations, decorate its function with `sourced`, or set ObservationTermCfg.source to the name of "
        "a reading that is its value."
      )
    return describe() if isinstance(term.func, ManagerTermBase) else describe(self.env, **term.given)

  def get_term_cfg(self, group: str, name: str | None = None, /) -> Any:
    """Return the config of a term, or of a group if no term is named.

    Noise, clip and scale of a term, and `corrupt` and `nan_policy` of a group, may be assigned. Other fields are fixed
    at build. `set_params("group/term", ...)` changes parameters.

    Raises:
      UnknownNameError: no such group or term.
    """
    cfg = self._lookup(self._groups, group)
    if name is None:
      return cfg
    return cfg.terms[check_name("term", name, cfg.terms, f"{self.label}: group '{group}'")]

  def set_params(self, name: str, /, **params: Any) -> None:
    """Change parameters of the term `name`, "group/term"; see `ManagerBase.set_params`."""
    super().set_params(name, **params)
    self._share_again(name)

  def scalar(self, name: str, parameter: str, /) -> torch.Tensor:
    """Return a scalar parameter of the term `name`, "group/term"; see `ManagerBase.scalar`."""
    is_first = not self.term(name).is_written
    scalar = super().scalar(name, parameter)
    if is_first:
      self._share_again(name)
    return scalar

  def _share_again(self, name: str) -> None:
    before = self._distinct
    self._share()
    if self._distinct != before:
      self.env.request_recapture(f"{self.label}: '{name}' has other parameters than its equals in other groups")

  # Interface for the environment.

  def compute(self, fresh: torch.Tensor | None = None, advance: torch.Tensor | None = None) -> dict[str, Observation]:
    """Evaluate all terms, and advance delays and histories by one frame.

    Args:
      fresh: worlds that were just reset, bool (N,). The new frame fills their delays and histories.
      advance: worlds to observe, bool (N,), all of them fresh; None for all worlds. The observations, delays and
        histories of other worlds stay bit-identical.

    Returns:
      `buffers`.
    """
    if not self._slots:
      return self.buffers
    before = None if advance is None else self._stateful_terms.state_dict()
    values = dict(zip(self._distinct, self.evaluate(self._distinct), strict=True))
    torch.cat([values[term].flatten(1) for term in self._evaluated.values()], dim=1, out=self._frame)
    if advance is not None and before is not None:
      self._stateful_terms.restore(before, ~advance)
    clean = self._out if self._memory.is_empty and advance is None else self._clean
    self._processing.apply(self._frame, clean, advance)
    final = self._memory.advance(clean, fresh, advance)
    if advance is not None:
      where_(self._out, advance, final)
    elif final is not self._out:
      self._out.copy_(final)
    return self.buffers

  @cached_property
  def _terminal(self) -> torch.Tensor:
    return torch.zeros_like(self._out)

  @cached_property
  def terminal_buffers(self) -> dict[str, Observation]:
    """Last observations of ended episodes by group, written by `keep_terminal`; always the same memory."""
    return self._views(self._terminal)

  def keep_terminal(self, mask: torch.Tensor) -> None:
    """Write the observations of the worlds in `mask`, bool (N,), to `terminal_buffers`.

    Only the random generator advances; all other state is restored.
    """
    if not self._slots:
      return
    state = self.state_dict()
    self.compute()
    where_(self._terminal, mask, self._out)
    self.restore(state)

  def nan_warnings(self, log: Mapping[str, float]) -> list[str]:
    """Return one line for each term with NaN or infinite entries in `log`, of groups with nan_policy "warn"."""
    prefix = "Nonfinite/observation/"
    return [
      f"observation '{slot.path}': {log[prefix + slot.path]:.0f} entries were NaN or infinite and became 0"
      for slot in self._slots.values()
      if slot.group_cfg.nan_policy == "warn" and prefix + slot.path in log
    ]

  def reset(self, mask: torch.Tensor) -> None:
    """Draw the episode noise of the worlds in `mask`, bool (N,), and reset class terms there.

    `compute` fills the delays and histories of the worlds that it gets as `fresh`.
    """
    self._processing.redraw(mask)
    super().reset(mask)

  def sync(self) -> None:
    """Read replaced noise, clip, scale and NaN policies from the configs, on the host before each step."""
    if not self._processing.is_current():
      processing = Processing(self._slots, self.env, self._noting, before=self._processing)
      self._report()
      self._processing = processing
      self.env.request_recapture(f"{self.label}: noise, clip, scale or NaN policy changed")

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return `Nonfinite/observation/<group>/<term>`, counts of NaN or infinite entries; NaN if there were none."""
    if not self._slots:
      return super().log_tensors()
    counts = [self._processing.nonfinite[slot.frame].sum() for slot in self._slots.values()]
    return [f"Nonfinite/observation/{path}" for path in self._slots], nan_if_zero(torch.stack(counts))

  def clear_log(self) -> None:
    self._processing.nonfinite.zero_()

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    row = self._out[env_idx].tolist()
    return [(path, row[slot.out]) for path, slot in self._slots.items()]

  def describe(self) -> str:
    rows = []
    for slot in self._slots.values():
      noise = "" if slot.noise is None else type(slot.noise).__name__
      lag = f"{slot.cfg.delay_min_lag} to {slot.cfg.delay_max_lag}" if slot.cfg.delay_max_lag else ""
      optional = ["" if value is None else value for value in (slot.clip, slot.scale)]
      rows.append((slot.group, slot.name, slot.shape, noise, *optional, lag, slot.history_length or ""))
    columns = ("group", "term", "shape", "noise", "clip", "scale", "delay", "history")
    return table(columns, rows, title="Observations")


def _group_problems(cfg: Any) -> list[str]:
  """Return the mistakes in a group, apart from those in its terms."""
  problems = cfg_problems(cfg, ObservationGroupCfg)
  if not problems and not any(term is not None for term in cfg.terms.values()):
    problems.append("has no terms. Give it some, or set the group itself to None to leave it out.")
  return problems


def _paths(groups: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
  """Yield "group/term" and config of the terms of all groups."""
  for group, cfg in groups.items():
    if isinstance(getattr(cfg, "terms", None), Mapping):
      yield from ((f"{group}/{name}", term) for name, term in cfg.terms.items() if term is not None)


def _are_equal(a: Term, b: Term) -> bool:
  is_fixed = not (isinstance(a.func, ManagerTermBase) or a.is_written or b.is_written)
  return is_fixed and same(a.func, b.func) and same(a.given, b.given)
