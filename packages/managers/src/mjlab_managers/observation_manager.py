"""Observations: the inputs of policy and critic."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import torch
from mjlab_core import MjlabError, Stateful, check_name, where_
from mjlab_core.tables import table

from mjlab_managers.binding import Term, copy_cfg
from mjlab_managers.deployment import Reading, TermSource
from mjlab_managers.manager import ManagerBase
from mjlab_managers.observation_cfg import ObservationGroupCfg, ObservationTermCfg, TermLayout
from mjlab_managers.observation_checks import group_problems, group_term_problems, processing_problems
from mjlab_managers.observation_memory import Memory
from mjlab_managers.observation_processing import Processing
from mjlab_managers.observation_slots import Slot, place_columns, twin_of
from mjlab_managers.term import ManagerTermBase
from mjlab_managers.vector_manager import nan_if_zero

Observation = torch.Tensor | dict[str, torch.Tensor]

_LIVE = frozenset({"noise", "clip", "scale"})


class ObservationManager(ManagerBase[ObservationGroupCfg]):
  """Manager that evaluates every distinct term once and processes all groups as columns of one frame.

  Noise, clip, scale and the NaN check work on the whole frame. Delays and histories work on their columns. The result
  is one block of memory, and `buffers` are views of it.
  """

  cfg_type = ObservationGroupCfg
  live_fields = frozenset({"corrupt", "nan_policy"})

  def _make(self) -> None:
    slots: list[Slot] = []
    for group, cfg in self._cfgs.items():
      for name, term_cfg in cfg.terms.items():
        assert term_cfg is not None
        slot = self._make_slot(group, name, term_cfg, slots)
        if slot is not None:
          slots.append(slot)
      self._check_shapes(group, [slot for slot in slots if slot.group == group])
    self._slots = [slot for slot in slots if not self._note(processing_problems(slot))]
    self._raise_problems()

    place_columns(self._slots)
    frame_width = self._slots[-1].frame.stop if self._slots else 0
    out_width = self._slots[-1].out.stop if self._slots else 0
    self._frame = torch.zeros(self.num_envs, frame_width, device=self.device)
    self._clean = torch.zeros_like(self._frame)
    self._out = self.state((out_width,))
    # Processing compares configs by identity, so they are made read-only first.
    self._seal()
    self._processing = Processing(self._slots, frame_width, self.env)
    self._note(self._processing.problems)
    self._memory = Memory(self._slots, frame_width, self.env)
    self._share()
    self.buffers: dict[str, Observation] = {group: self._view(group, self._out) for group in self.active_groups}
    """Observation of each group, float32 (N, D) or a dict of terms; always the same memory."""

  # Build.

  @classmethod
  def _cfg_problems(cls, name: str, cfg: ObservationGroupCfg) -> Iterator[str]:
    yield from group_problems(name, cfg)
    if isinstance(cfg, ObservationGroupCfg) and isinstance(cfg.terms, Mapping):
      for term, term_cfg in cfg.terms.items():
        yield from group_term_problems(f"{name}/{term}", term_cfg)

  def _read(self, name: str, cfg: ObservationGroupCfg) -> None:
    """Keep a copy of a group, without the terms that have mistakes."""
    if self._note(group_problems(name, cfg)):
      self._broken.add(name)
      return
    group = copy_cfg(cfg)
    for term, term_cfg in cfg.terms.items():
      if term_cfg is None or self._note(group_term_problems(f"{name}/{term}", term_cfg)):
        del group.terms[term]
    self._cfgs[name] = group

  def _note(self, problems: Iterator[str] | list[str]) -> bool:
    """Note mistakes, and return True if there are any."""
    found = list(problems)
    for problem in found:
      self._problem(problem)
    return bool(found)

  def _make_slot(self, group: str, name: str, cfg: ObservationTermCfg, earlier: list[Slot]) -> Slot | None:
    path, group_cfg = f"{group}/{name}", self._cfgs[group]
    own = self._bind(path, cfg)
    if own is None:
      return None
    history, flatten = cfg.history_length, cfg.flatten_history_dim
    if group_cfg.history_length is not None:
      history, flatten = group_cfg.history_length, group_cfg.flatten_history_dim
    twin = twin_of(own, earlier)
    shape = self._shape_of(own) if twin is None else twin.shape
    if shape is None:
      self._drop(path)
      return None
    return Slot(group, name, group_cfg, cfg, own, own, shape, history, flatten)

  def _shape_of(self, term: Term) -> tuple[int, ...] | None:
    """Return the shape of the value of one world, or None with the mistake noted."""
    with self._trial(term.name, term.func) as trial:
      trial.value = term.try_call(rebuilt=trial.rebuilt)
      if isinstance(term.func, ManagerTermBase):
        term.func.reset(torch.ones(self.num_envs, dtype=torch.bool, device=self.device))

    def fits(value: torch.Tensor) -> bool:
      return value.is_floating_point() and value.dim() >= 2 and value.shape[0] == self.num_envs

    what = f"float ({self.num_envs}, ...) with at least two dimensions"
    if trial.failed or not self._check_tensor(term.name, trial.value, what, fits):
      return None
    return tuple(trial.value.shape[1:])

  def _check_shapes(self, group: str, slots: list[Slot]) -> None:
    if self._cfgs[group].concatenate_terms and len(slots) > 1:
      for slot in slots:
        if len(slot.out_shape) > 1:
          self._problem(
            f"term '{slot.path}': shape {slot.out_shape} cannot be concatenated; flatten it, or set "
            f"concatenate_terms=False on group '{group}'."
          )

  def _share(self) -> None:
    """Share one evaluation among equal terms."""
    for index, slot in enumerate(self._slots):
      twin = twin_of(slot.own, self._slots[:index])
      slot.term = slot.own if twin is None else twin.term
    self._terms = list(dict.fromkeys(slot.term for slot in self._slots))

  def _check_again(self, term: Term) -> bool:
    shape = self._shape_of(term)
    before = next(slot.shape for slot in self._slots if slot.own is term)
    if shape is not None and shape != before:
      self._problem(f"term '{term.name}': returned {before} for each world before, and {shape} now.")
    return shape == before

  def _lock(self, name: str, cfg: Any, live: frozenset[str]) -> None:
    for term, term_cfg in cfg.terms.items():
      super()._lock(f"{name}/{term}", term_cfg, _LIVE)
    super()._lock(name, cfg, live)

  def _view(self, group: str, memory: torch.Tensor) -> Observation:
    slots = self._group_slots(group)
    if not self._cfgs[group].concatenate_terms:
      return {slot.name: memory[:, slot.out].unflatten(1, slot.out_shape) for slot in slots}
    columns = memory[:, slots[0].out.start : slots[-1].out.stop]
    return columns.unflatten(1, slots[0].out_shape) if len(slots) == 1 else columns

  # Interface for users.

  @property
  def active_groups(self) -> list[str]:
    """Names of the groups in order."""
    return list(dict.fromkeys(slot.group for slot in self._slots))

  @property
  def active_terms(self) -> dict[str, list[str]]:
    """Names of the terms of each group in order."""
    return {group: [slot.name for slot in self._group_slots(group)] for group in self.active_groups}

  @property
  def group_obs_dim(self) -> dict[str, tuple[int, ...] | list[tuple[int, ...]]]:
    """Shape of the observation of one world by group; a list of shapes if terms are not concatenated."""
    return {
      group: tuple(view.shape[1:]) if isinstance(view, torch.Tensor) else [tuple(v.shape[1:]) for v in view.values()]
      for group, view in self.buffers.items()
    }

  @property
  def group_obs_term_dim(self) -> dict[str, list[tuple[int, ...]]]:
    """Shapes of the terms of one world by group."""
    return {group: [slot.out_shape for slot in self._group_slots(group)] for group in self.active_groups}

  @property
  def group_obs_concatenate(self) -> dict[str, bool]:
    """`concatenate_terms` of each group."""
    return {group: self._cfgs[group].concatenate_terms for group in self.active_groups}

  @property
  def nonfinite_counts(self) -> dict[str, torch.Tensor]:
    """Entries that were NaN or infinite since `clear_log` by "group/term", int64, 0-d."""
    return {slot.path: self._processing.nonfinite[slot.frame].sum() for slot in self._slots}

  def layout(self, group: str) -> list[TermLayout]:
    """Return the columns and the processing of each term of a group."""
    self._lookup({name: name for name in self.active_groups}, group)
    slots = self._group_slots(group)
    start = slots[0].out.start
    return [
      TermLayout(
        name=slot.name,
        columns=slice(slot.out.start - start, slot.out.stop - start),
        shape=slot.out_shape,
        frame_shape=slot.shape,
        history_length=slot.history,
        clip=slot.cfg.clip,
        scale=slot.cfg.scale,
      )
      for slot in slots
    ]

  def source(self, group: str, name: str) -> TermSource:
    """Return the computation of a term from readings outside the simulation.

    Raises:
      UnknownNameError: no such group or term.
      MjlabError: the term declares no source.
    """
    cfg = self.get_term_cfg(group, name)
    term = next(slot.own for slot in self._group_slots(group) if slot.name == name)
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
    cfg = self._lookup(self._cfgs, group)
    if name is None:
      return cfg
    return cfg.terms[check_name("term", name, cfg.terms, f"{self.label}: group '{group}'")]

  def set_params(self, name: str, /, **params: Any) -> None:
    """Change parameters of the term `name`, "group/term"; see `ManagerBase.set_params`."""
    super().set_params(name, **params)
    before = self._terms
    self._share()
    if self._terms != before:
      self.env.request_recapture(f"{self.label}: '{name}' has other parameters than its equals in other groups")

  def get(self) -> dict[str, Observation]:
    """Return the observations of the last `compute`."""
    return self.buffers

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
    torch.cat(self._evaluate(advance), dim=1, out=self._frame)
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
    return {group: self._view(group, self._terminal) for group in self.active_groups}

  def keep_terminal(self, mask: torch.Tensor) -> None:
    """Write the observations of the worlds in `mask`, bool (N,), to `terminal_buffers`.

    Only the random generator advances; all other state is restored.
    """
    if not self._slots:
      return
    state, counts = self.state_dict(), self._processing.nonfinite.clone()
    self.compute()
    where_(self._terminal, mask, self._out)
    self.restore(state)
    self._processing.nonfinite.copy_(counts)

  def nan_warnings(self, log: Mapping[str, float]) -> list[str]:
    """Return one line for each term with NaN or infinite entries in `log`, of groups with nan_policy "warn"."""
    prefix = "Nonfinite/observation/"
    return [
      f"observation '{slot.path}': {log[prefix + slot.path]:.0f} entries were NaN or infinite and became 0"
      for slot in self._slots
      if slot.group_cfg.nan_policy == "warn" and prefix + slot.path in log
    ]

  def _evaluate(self, advance: torch.Tensor | None) -> list[torch.Tensor]:
    values = self.evaluate(self._terms) if advance is None else [self._observe(term, advance) for term in self._terms]
    raw = {term: value.flatten(1) for term, value in zip(self._terms, values, strict=True)}
    return [raw[slot.term] for slot in self._slots]

  def _observe(self, term: Term, advance: torch.Tensor) -> torch.Tensor:
    """Return the value of a term, whose state advances in the worlds of `advance` only."""
    func: Any = term.func
    before = func.state_dict() if isinstance(func, Stateful) else None
    value = term()
    if before is not None:
      func.restore(before, ~advance)
    return value

  def reset(self, mask: torch.Tensor) -> None:
    """Draw the episode noise of the worlds in `mask`, bool (N,), and reset class terms there.

    `compute` fills the delays and histories of the worlds that it gets as `fresh`.
    """
    self._processing.redraw(mask)
    super().reset(mask)

  def sync(self) -> None:
    """Read replaced noise, clip, scale and NaN policies from the configs, on the host before each step."""
    if not self._processing.is_current():
      self._note(self._processing.compile())
      self._raise_problems()
      self.env.request_recapture(f"{self.label}: noise, clip, scale or NaN policy changed")

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return `Nonfinite/observation/<group>/<term>`, counts of NaN or infinite entries; NaN if there were none."""
    names = [f"Nonfinite/observation/{slot.path}" for slot in self._slots]
    if not names:
      return super().log_tensors()
    return names, nan_if_zero(torch.stack(list(self.nonfinite_counts.values())))

  def clear_log(self) -> None:
    self._processing.nonfinite.zero_()

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    row = self._out[env_idx].tolist()
    return [(slot.path, row[slot.out]) for slot in self._slots]

  def describe(self) -> str:
    rows = []
    for slot in self._slots:
      cfg, group = slot.cfg, self._cfgs[slot.group]
      noise = type(cfg.noise).__name__ if group.corrupt and cfg.noise is not None else ""
      lag = f"{cfg.delay_min_lag} to {cfg.delay_max_lag}" if cfg.delay_max_lag else ""
      optional = ["" if value is None else value for value in (cfg.clip, cfg.scale)]
      rows.append((slot.group, slot.name, slot.out_shape, noise, *optional, lag, slot.history or ""))
    columns = ("group", "term", "shape", "noise", "clip", "scale", "delay", "history")
    return table(columns, rows, title="Observations")

  def _group_slots(self, group: str) -> list[Slot]:
    return [slot for slot in self._slots if slot.group == group]
