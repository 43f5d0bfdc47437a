"""Events: changes to the simulation at startup, at resets, in intervals, or in every step."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from functools import partial, reduce
from typing import Any, Literal, get_args

import torch
from mjlab_core import Count, NonNegativeRange, call_where, where_

from mjlab_managers.manager import ManagerBase
from mjlab_managers.terms.binding import Term, attribute_of
from mjlab_managers.terms.term import ManagerTermBaseCfg

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
    self._modes: dict[str, list[Term]] = {mode: [] for mode in _MODES}
    for name, term in self._terms.items():
      self._modes[self._cfgs[name].mode].append(term)
    # The order of a rehearsal.
    self._terms = {term.name: term for terms in self._modes.values() for term in terms}
    self.model_fields = self._written_fields(self._terms.values())
    """Model fields that terms write per world. They must be expanded before the first event."""

    def options(names: list[str], field: str, dtype: torch.dtype) -> torch.Tensor:
      return torch.tensor([[getattr(self._cfgs[name], field) for name in names]], dtype=dtype, device=self.device)

    self._timed = [term.name for term in self._modes["interval"]]
    is_global = options(self._timed, "is_global_time", torch.bool)
    self._global = is_global if is_global.any() else None
    self._lo, self._hi = options(self._timed, "interval_range_s", torch.float64).view(1, -1, 2).unbind(2)
    self._time_left = self.state_of(self._draw())

    self._gated = [term.name for term in self._modes["reset"] if self._cfgs[term.name].min_step_count_between_reset > 0]
    self._min_steps = options(self._gated, "min_step_count_between_reset", torch.int64)
    self._last_fired = self.state((len(self._gated),), fill=_NEVER, dtype=torch.int64)

  @classmethod
  def _cfg_problems(cls, cfg: Any) -> list[str]:
    problems = super()._cfg_problems(cfg)
    if not isinstance(cfg, EventTermCfg):
      return problems
    if cfg.mode == "interval" and cfg.interval_range_s is None:
      problems.append("mode interval needs interval_range_s.")
    for option, mode in (
      ("interval_range_s", "interval"),
      ("is_global_time", "interval"),
      ("min_step_count_between_reset", "reset"),
    ):
      if getattr(cfg, option) and cfg.mode != mode:
        problems.append(f"{option} is for mode {mode}, the mode is {cfg.mode}.")
    return problems

  def _mistake(self, term: Term) -> str:
    claims: Mapping[Hashable, str] = attribute_of(term.func, "claims", {})
    for other in self._terms.values():
      both = () if other is term else [key for key in attribute_of(other.func, "claims", ()) if key in claims]
      if both:
        return f"{claims[both[0]]} is written by event '{other.name}' too; only one of them would count."
    is_new = term.name not in self._terms
    unknown = [] if is_new else [field for field in self._written_fields([term]) if field not in self.model_fields]
    return f"writes model fields {', '.join(unknown)}, which must be known at build." if unknown else ""

  def _rehearse(self, term: Term) -> None:
    self._tried(term, self._all_worlds(term))

  @staticmethod
  def _written_fields(terms: Iterable[Term]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(field for term in terms for field in attribute_of(term.func, "model_fields", ())))

  def _draw(self) -> torch.Tensor:
    """Draw the times of all timers, (N, K); a global one has the same time in all worlds."""
    shape = (self.num_envs, len(self._timed))
    u = torch.rand(shape, generator=self.env.rng, device=self.device, dtype=self._lo.dtype)
    times = torch.lerp(self._lo, self._hi, u)
    return times if self._global is None else torch.where(self._global, times[:1], times)

  @property
  def available_modes(self) -> list[str]:
    """Modes that have at least one term."""
    return [mode for mode, terms in self._modes.items() if terms]

  def apply(self, mode: EventMode, mask: torch.Tensor | None = None) -> None:
    """Fire the terms of one mode.

    Args:
      mode: mode of the terms.
      mask: worlds to act on, bool (N,); None for all worlds. Mode reset takes the worlds that begin an
        episode, and mode interval those that advanced by one step. A global timer always advances, and fires in all
        worlds.
    """
    terms = self._modes[mode]
    if not terms:
      return
    mask = self._everywhere if mask is None else mask
    fired = {}
    if mode == "interval":
      fired = self._due(mask)
    elif mode == "reset" and self._gated:
      fired = self._allowed(mask)
    self._fire(terms, mask, fired)

  def fire(self, name: str, mask: torch.Tensor | None = None) -> None:
    """Fire one term now, outside of a step, independent of its mode and timers.

    Raises:
      UnknownNameError: no such term.
    """
    self._fire([self.term(name)], self._everywhere if mask is None else mask, {})

  def _fire(self, terms: list[Term], mask: torch.Tensor, fired: dict[str, torch.Tensor]) -> None:
    """Call each term on its worlds in `fired`, or on `mask` if it has none there."""
    derived: list[torch.Tensor] = []
    for term in terms:
      where = fired.get(term.name, mask)
      act = partial(self._with_ids, term, act=term) if term.wants_ids else term
      if term.name in fired:
        call_where(where, act, self.env.rng)
      else:
        act(where)
      if attribute_of(term.func, "needs_constants", False) and not any(where is other for other in derived):
        derived.append(where)
    if derived:
      self.env.recompute_constants(reduce(torch.logical_or, derived))

  def _due(self, mask: torch.Tensor) -> dict[str, torch.Tensor]:
    moving = mask[:, None] if self._global is None else mask[:, None] | self._global
    self._time_left.sub_(moving.double(), alpha=self.env.step_dt)
    due = (self._time_left <= _DUE) & moving
    where_(self._time_left, due, self._draw())
    return dict(zip(self._timed, due.unbind(1), strict=True))

  def _allowed(self, mask: torch.Tensor) -> dict[str, torch.Tensor]:
    now = self.env.common_step_counter
    allowed = (now - self._last_fired >= self._min_steps) & mask[:, None]
    where_(self._last_fired, allowed, now)
    return dict(zip(self._gated, allowed.unbind(1), strict=True))

  def reset(self, mask: torch.Tensor) -> None:
    """Draw new timers in the worlds of `mask`, bool (N,), and reset class terms; after `apply("reset", mask)`."""
    if self._timed:
      own = mask if self._global is None else mask[:, None] & ~self._global
      where_(self._time_left, own, self._draw())
    super().reset(mask)
