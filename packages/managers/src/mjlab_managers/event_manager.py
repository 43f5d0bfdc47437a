"""Events: changes to the simulation at startup, at resets, in intervals, or in every step."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import Literal, get_args

import torch
from mjlab_core import Count, NonNegativeRange, call_where, where_
from mjlab_core.tables import table

from mjlab_managers.binding import Term, attribute_of
from mjlab_managers.manager import ManagerBase
from mjlab_managers.term import ManagerTermBaseCfg

EventMode = Literal["startup", "reset", "interval", "step"]

_MODES: tuple[EventMode, ...] = get_args(EventMode)
# Timers are float64, and due this early [s]: rounding of repeated subtraction must not delay one by a step.
_DUE = 1e-6
_NEVER = -(2**62)


@dataclass
class EventTermCfg(ManagerTermBaseCfg):
  """Config of an event: `func(env, mask, **params)` changes the worlds of `mask`, bool (N,).

  The function, class or instance may have three attributes:

  - `model_fields`: names of the model fields that it writes per world.
  - `needs_constants`: True if quantities that derive from these fields must be recomputed afterwards.
  - `claims`: mapping from keys of the written numbers to their descriptions. Two events must not claim the same key.
  """

  _: KW_ONLY
  mode: EventMode
  """`startup`: once; `reset`: when an episode begins; `interval`: when a timer expires; `step`: in every step."""
  interval_range_s: NonNegativeRange | None = None
  """Shortest and longest time between two events [s]; required in mode interval, not allowed in others."""
  is_global_time: bool = False
  """True: one timer for all worlds, which resets do not change; mode interval only."""
  min_step_count_between_reset: Count = 0
  """Smallest number of environment steps between two events in one world; mode reset only."""


class EventManager(ManagerBase[EventTermCfg]):
  """Manager that fires events. Timers are on the device; a mode without terms costs nothing."""

  cfg_type = EventTermCfg
  masked = True

  def _make(self) -> None:
    self._terms: dict[EventMode, list[Term]] = {mode: [] for mode in _MODES}
    for name, cfg in list(self._cfgs.items()):
      term = self._bind(name, cfg)
      if term is not None and self._may_write(term):
        self._terms[cfg.mode].append(term)
      else:
        self._drop(name)
    self._raise_problems()

    self.model_fields = self._written_fields()
    """Model fields that terms write per world. They must be expanded before the first event."""
    self._needs_constants = self._deriving()
    self._all_worlds = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)

    interval = self._terms["interval"]
    self._own = [term for term in interval if not self._cfgs[term.name].is_global_time]
    self._global = [term for term in interval if self._cfgs[term.name].is_global_time]
    self._lo, self._span = self._ranges(self._own)
    self._global_lo, self._global_span = self._ranges(self._global)
    self._time_left = self.state_of(self._draw((self.num_envs, len(self._own)), self._lo, self._span))
    self._global_time_left = self.state_of(
      self._draw((1, len(self._global)), self._global_lo, self._global_span), shared=True
    )

    self._gated = [term for term in self._terms["reset"] if self._cfgs[term.name].min_step_count_between_reset > 0]
    steps = [self._cfgs[term.name].min_step_count_between_reset for term in self._gated]
    self._min_steps = torch.tensor([steps], dtype=torch.int64, device=self.device)
    self._last_fired = self.state((len(self._gated),), fill=_NEVER, dtype=torch.int64)

  @classmethod
  def _cfg_problems(cls, name: str, cfg: EventTermCfg) -> Iterator[str]:
    yield from super()._cfg_problems(name, cfg)
    if not isinstance(cfg, EventTermCfg):
      return
    if cfg.mode == "interval" and cfg.interval_range_s is None:
      yield f"term '{name}': mode interval needs interval_range_s."
    for option, mode in (
      ("interval_range_s", "interval"),
      ("is_global_time", "interval"),
      ("min_step_count_between_reset", "reset"),
    ):
      if getattr(cfg, option) and cfg.mode != mode:
        yield f"term '{name}': {option} is for mode {mode}, the mode is {cfg.mode}."

  def rehearse(self) -> None:
    for term in self._all_terms():
      worlds = torch.arange(self.num_envs, device=self.device) if term.wants_ids else self._all_worlds
      with self._trial(term.name, term.func) as trial:
        term.try_call(worlds, rebuilt=trial.rebuilt)
    self._raise_problems()

  def _check_again(self, term: Term) -> bool:
    if new := [field for field in self._written_fields() if field not in self.model_fields]:
      self._problem(f"term '{term.name}': writes model fields {', '.join(new)}, which must be known at build.")
    self._needs_constants = self._deriving()
    return self._may_write(term) and not new

  def _may_write(self, term: Term) -> bool:
    """Return True if no other event claims the same numbers; note the mistake otherwise."""
    claims: Mapping[Hashable, str] = attribute_of(term.func, "claims", {})
    for other in self._all_terms():
      both = () if other is term else [key for key in attribute_of(other.func, "claims", ()) if key in claims]
      if both:
        self._problem(
          f"term '{term.name}': {claims[both[0]]} is written by event '{other.name}' too; only one of them would count."
        )
        return False
    return True

  def _written_fields(self) -> tuple[str, ...]:
    fields = [field for term in self._all_terms() for field in attribute_of(term.func, "model_fields", ())]
    return tuple(dict.fromkeys(fields))

  def _deriving(self) -> set[str]:
    """Return the names of the terms after which quantities that derive from model fields must be recomputed."""
    return {term.name for term in self._all_terms() if attribute_of(term.func, "needs_constants", False)}

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
    """Fire the terms of one mode.

    Args:
      mode: mode of the terms.
      mask: worlds to act on, bool (N,); None for all worlds. In mode reset these are the worlds whose episode begins,
        in mode interval those in which one step of time passed. A global timer always advances, and fires in all
        worlds.
    """
    terms = self._terms[mode]
    if not terms:
      return
    mask = self._all_worlds if mask is None else mask
    if mode == "interval":
      fired = self._due(mask)
    elif mode == "reset" and self._gated:
      fired = self._allowed(mask)
    else:
      fired = {}
    self._fire(terms, mask, fired)

  def fire(self, name: str, mask: torch.Tensor | None = None) -> None:
    """Fire one term now, outside of a step, independent of its mode and timers.

    Raises:
      UnknownNameError: no such term.
    """
    term = self._lookup({term.name: term for term in self._all_terms()}, name)
    self._fire([term], self._all_worlds if mask is None else mask, {})

  def _fire(self, terms: list[Term], mask: torch.Tensor, fired: dict[str, torch.Tensor]) -> None:
    """Call each term on its worlds in `fired`, or on `mask` if it has none there."""
    derived: list[torch.Tensor] = []
    for term in terms:
      where = fired.get(term.name, mask)
      act = partial(self._with_ids, term.name, act=term) if term.wants_ids else term
      if term.name in fired:
        call_where(where, act, self.env.rng)
      else:
        act(where)
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

  def reset(self, mask: torch.Tensor) -> None:
    """Draw new timers in the worlds of `mask`, bool (N,), and reset class terms; after `apply("reset", mask)`."""
    if self._own:
      where_(self._time_left, mask, self._draw((self.num_envs, len(self._own)), self._lo, self._span))
    super().reset(mask)

  def describe(self) -> str:
    rows = []
    for mode, terms in self._terms.items():
      for term in terms:
        cfg = self._cfgs[term.name]
        when = "every {} to {} s".format(*cfg.interval_range_s) if cfg.interval_range_s else ""
        when += ", one timer for all worlds" if cfg.is_global_time else ""
        when += f"at most every {cfg.min_step_count_between_reset} steps" if cfg.min_step_count_between_reset else ""
        rows.append((mode, term.name, when))
    return table(("mode", "term", "when"), rows, title="Events")
