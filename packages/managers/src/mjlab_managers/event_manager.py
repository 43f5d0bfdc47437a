"""Events: changes to the simulation at startup, at resets, from time to time, or every step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Literal, get_args

import torch
from mjlab_core.counts import why_no_count
from mjlab_core.masking import where_
from mjlab_core.names import unknown
from mjlab_core.sampling import check_bounds

from mjlab_managers.binding import Term, attribute_of
from mjlab_managers.env import ManagerEnv
from mjlab_managers.manager import ManagerBase
from mjlab_managers.table import table
from mjlab_managers.term import ManagerTermBaseCfg

EventMode = Literal["startup", "reset", "interval", "step"]

_MODES: tuple[EventMode, ...] = get_args(EventMode)
# Timers are float64, and due this early [s]: rounding of repeated subtraction must not delay one by a step.
_DUE = 1e-6
_NEVER = -(2**62)


@dataclass
class EventTermCfg(ManagerTermBaseCfg):
  """An event: `func(env, mask, **params)` changes the worlds of `mask`, bool (N,).

  A function (or the class or instance) may carry two attributes: `model_fields`, names of model fields that it writes
  per world, and `needs_constants`, true if quantities that derive from them must be recomputed afterwards.
  """

  _: KW_ONLY
  mode: EventMode
  """`startup`: once; `reset`: where an episode begins; `interval`: where a timer ran out; `step`: every step."""
  interval_range_s: tuple[float, float] | None = None
  """Shortest and longest time between two firings [s]; mode interval only, required there."""
  is_global_time: bool = False
  """Whether one timer serves all worlds, which resets then leave alone; mode interval only."""
  min_step_count_between_reset: int = 0
  """Environment steps that must have passed since the event last fired in a world; mode reset only."""


class EventManager(ManagerBase[EventTermCfg]):
  """Fires events. Timers are on the device; a mode without terms costs nothing."""

  cfg_type = EventTermCfg
  _constants = frozenset({"_everyone", "_lo", "_span", "_global_lo", "_global_span", "_min_steps"})
  _extra_state = ("_global_time_left",)

  def __init__(self, cfgs: Mapping[str, EventTermCfg | None], env: ManagerEnv) -> None:
    super().__init__(cfgs, env)
    self._terms: dict[EventMode, list[Term]] = {mode: [] for mode in _MODES}
    for name, cfg in self._cfgs.items():
      if not self._check(name, cfg):
        continue
      term = self._bind(name, cfg, masked=True)
      if term is not None:
        self._terms[cfg.mode].append(term)
    self._raise_problems()

    self.model_fields: tuple[str, ...] = tuple(
      dict.fromkeys(field for term in self._all_terms() for field in attribute_of(term.func, "model_fields", ()))
    )
    """Model fields that some term writes per world, to be expanded before the first event."""
    self._needs_constants = {
      term.name for term in self._all_terms() if attribute_of(term.func, "needs_constants", False)
    }
    self._masks = {
      term.name: torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
      for term in self._all_terms()
      if term.wants_ids
    }
    self._everyone = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)

    interval = self._terms["interval"]
    self._own = [term for term in interval if not self._cfgs[term.name].is_global_time]
    self._global = [term for term in interval if self._cfgs[term.name].is_global_time]
    self._lo, self._span = self._ranges(self._own)
    self._global_lo, self._global_span = self._ranges(self._global)
    self._time_left = self._draw((self.num_envs, len(self._own)), self._lo, self._span)
    self._global_time_left = self._draw((1, len(self._global)), self._global_lo, self._global_span)

    self._gated = [term for term in self._terms["reset"] if self._cfgs[term.name].min_step_count_between_reset > 0]
    steps = [self._cfgs[term.name].min_step_count_between_reset for term in self._gated]
    self._min_steps = torch.tensor([steps], dtype=torch.int64, device=self.device)
    self._last_fired = torch.full((self.num_envs, len(self._gated)), _NEVER, dtype=torch.int64, device=self.device)

  def _check(self, name: str, cfg: EventTermCfg) -> bool:
    before = len(self._problems)
    if cfg.mode not in _MODES:
      self._problem(unknown("mode", str(cfg.mode), _MODES, owner=f"term '{name}'"))
    elif cfg.mode == "interval" and cfg.interval_range_s is None:
      self._problem(f"term '{name}': mode interval needs interval_range_s.")
    elif cfg.mode != "interval" and (cfg.interval_range_s is not None or cfg.is_global_time):
      option = "is_global_time" if cfg.interval_range_s is None else "interval_range_s"
      self._problem(f"term '{name}': {option} is for mode interval, the mode is {cfg.mode}.")
    if cfg.interval_range_s is not None:
      try:
        check_bounds(f"term '{name}': interval_range_s", cfg.interval_range_s, minimum=0.0, finite=True)
      except ValueError as error:
        self._problem(str(error), error)
    if wrong := why_no_count(cfg.min_step_count_between_reset):
      self._problem(f"term '{name}': min_step_count_between_reset {wrong}.")
    elif cfg.min_step_count_between_reset > 0 and cfg.mode != "reset":
      self._problem(f"term '{name}': min_step_count_between_reset is for mode reset, the mode is {cfg.mode}.")
    return len(self._problems) == before

  def _all_terms(self) -> list[Term]:
    return [term for terms in self._terms.values() for term in terms]

  def _ranges(self, terms: list[Term]) -> tuple[torch.Tensor, torch.Tensor]:
    ranges = [self._cfgs[term.name].interval_range_s or (0.0, 0.0) for term in terms]
    lo = torch.tensor([[lo for lo, _ in ranges]], dtype=torch.float64, device=self.device)
    return lo, torch.tensor([[hi - lo for lo, hi in ranges]], dtype=torch.float64, device=self.device)

  def _draw(self, shape: tuple[int, int], lo: torch.Tensor, span: torch.Tensor) -> torch.Tensor:
    return torch.addcmul(lo, torch.rand(shape, generator=self.env.rng, device=self.device, dtype=lo.dtype), span)

  @property
  def available_modes(self) -> list[EventMode]:
    """Modes that have at least one term."""
    return [mode for mode, terms in self._terms.items() if terms]

  def apply(self, mode: EventMode, mask: torch.Tensor | None = None) -> None:
    """Fires the terms of one mode.

    Args:
      mode: which.
      mask: bool (N,), None for all worlds. Reset: worlds whose episode begins. Interval: worlds for which a step of
        time passed; a global timer always advances, and fires in all worlds.
    """
    terms = self._terms[mode]
    if not terms:
      return
    mask = self._everyone if mask is None else mask
    if mode == "interval":
      fired = self._due(mask)
    elif mode == "reset" and self._gated:
      fired = self._allowed(mask)
    else:
      fired = {}
    self._fire(terms, mask, fired)

  def fire(self, name: str, mask: torch.Tensor | None = None) -> None:
    """Fires one term now, whatever its mode and timers say; outside of a step.

    Raises:
      KeyError: no such term.
    """
    term = self._lookup({term.name: term for term in self._all_terms()}, name)
    self._fire([term], self._everyone if mask is None else mask, {})

  def _fire(self, terms: list[Term], mask: torch.Tensor, fired: dict[str, torch.Tensor]) -> None:
    """Calls terms on the worlds where each is due, `mask` unless `fired` says otherwise."""
    derived: list[torch.Tensor] = []
    for term in terms:
      where = fired.get(term.name, mask)
      if term.wants_ids:
        self._call_with_ids(term, where)
      else:
        term(where)
      if term.name in self._needs_constants and not any(where is other for other in derived):
        derived.append(where)
    if derived:
      where = derived[0]
      for other in derived[1:]:
        where = where | other
      self.env.recompute_constants(where)

  def _due(self, mask: torch.Tensor) -> dict[str, torch.Tensor]:
    fired: dict[str, torch.Tensor] = {}
    dt = self.env.step_dt
    if self._own:
      self._time_left.sub_(mask[:, None].double(), alpha=dt)
      due = (self._time_left <= _DUE) & mask[:, None]
      where_(self._time_left, due, self._draw((self.num_envs, len(self._own)), self._lo, self._span))
      fired |= {term.name: column for term, column in zip(self._own, due.unbind(1), strict=True)}
    if self._global:
      self._global_time_left.sub_(dt)
      due = self._global_time_left <= _DUE
      where_(self._global_time_left, due, self._draw((1, len(self._global)), self._global_lo, self._global_span))
      columns = due.expand(self.num_envs, -1).unbind(1)
      fired |= {term.name: column for term, column in zip(self._global, columns, strict=True)}
    return fired

  def _allowed(self, mask: torch.Tensor) -> dict[str, torch.Tensor]:
    now = self.env.common_step_counter
    allowed = (now - self._last_fired >= self._min_steps) & mask[:, None]
    where_(self._last_fired, allowed, now)
    return {term.name: column for term, column in zip(self._gated, allowed.unbind(1), strict=True)}

  def _call_with_ids(self, term: Term, where: torch.Tensor) -> None:
    kept = self._masks[term.name]
    kept.copy_(where)

    def call() -> None:
      ids = kept.nonzero().flatten()
      if ids.numel() > 0:
        term(ids)

    self.env.run_eagerly(call, name=f"event '{term.name}'")

  def reset(self, mask: torch.Tensor) -> None:
    """Redraws the timers of the worlds in `mask`, bool (N,), and resets class terms; after mode reset was applied."""
    if self._own:
      where_(self._time_left, mask, self._draw((self.num_envs, len(self._own)), self._lo, self._span))
    super().reset(mask)

  def _watched_terms(self) -> list[Term]:
    return self._all_terms()

  def describe(self) -> str:
    rows = []
    for mode, terms in self._terms.items():
      for term in terms:
        cfg = self._cfgs[term.name]
        when = "every {} to {} s".format(*cfg.interval_range_s) if cfg.interval_range_s else ""
        when += ", one timer for all worlds" if cfg.is_global_time else ""
        when += f"at most every {cfg.min_step_count_between_reset} steps" if cfg.min_step_count_between_reset else ""
        rows.append((mode, term.name, when))
    return table("Events", ("mode", "term", "when"), rows)
