"""Commands: targets for the policy, drawn at resets and in intervals."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from mjlab_core import Config, NonNegativeRange, call_where, fill_, uniform, where_

from mjlab_managers.manager import ManagerBase
from mjlab_managers.observations.deployment import Reading, TermSource
from mjlab_managers.terms.binding import call_named, placed
from mjlab_managers.terms.term import ManagerTermBase
from mjlab_managers.vector_manager import LogBuffer

# Timers are float64, and due this early [s]: rounding of repeated subtraction must not delay one by a step.
_DUE = 1e-6


@dataclass(kw_only=True)
class CommandTermCfg(Config, ABC):
  """Base of command configs."""

  resampling_time_range: NonNegativeRange | None
  """Shortest and longest time between two draws [s]; None keeps a command until the reset."""
  debug_vis: bool = False
  """Initial state of the drawing in viewers. The term draws by a method `debug_draw(draw)`."""

  @abstractmethod
  def build(self, env: Any) -> CommandTerm:
    """Return the term for an environment whose scene is initialised."""


class Metrics(dict[str, torch.Tensor]):
  """Metrics of a command by name, float32 (N,) each, accumulated over an episode.

  The first assignment to a name makes its memory. Later ones, such as `metrics["error"] += x`, write into it.
  """

  def __setitem__(self, name: str, value: torch.Tensor) -> None:
    mine = self.get(name)
    if mine is None:
      super().__setitem__(name, value.to(torch.float32, copy=True))
    elif mine is not value:
      mine.copy_(value)


class CommandTerm(ManagerTermBase, ABC):
  """Base of command terms.

  Subclasses declare state and metrics in `__init__`: `self.state(...)` and `self.metrics["error"] = torch.zeros(...)`.
  """

  def __init__(self, cfg: CommandTermCfg, env: Any) -> None:
    super().__init__(env)
    self.cfg = cfg
    self.metrics = Metrics()
    # The manager resets both.
    self.time_left = self.state_of(torch.zeros(self.num_envs, dtype=torch.float64, device=self.device))
    """Time to the next draw, float64 (N,) [s]; zero if only resets draw."""
    self.command_counter = self.state_of(torch.zeros(self.num_envs, dtype=torch.int64, device=self.device))
    """Draws since the reset, int64 (N,)."""
    self.by_hand: tuple[torch.Tensor, torch.Tensor] | None = None
    """Mask of the steered worlds, bool (N,), and their numbers, (N, len(axes)); None until the first `steer`."""

  @property
  @abstractmethod
  def command(self) -> torch.Tensor:
    """Command of each world, (N, d), always in the same memory."""

  @abstractmethod
  def resample(self, mask: torch.Tensor) -> None:
    """Draw new commands for all worlds, and write them into the worlds of `mask`, bool (N,)."""

  def update(self) -> None:
    """Update the command in every step. No time passes in the worlds of `env.command_manager.fresh`."""

  def update_metrics(self) -> None:
    """Add this step to `metrics`."""

  def log_values(self) -> dict[str, torch.Tensor]:
    """Return further values to log, 0-d tensors by name. Called once per log interval; the names must not change."""
    return {}

  def load_progress(self, state: Mapping[str, Any]) -> None:
    """Load the parts of a `state_dict` that do not depend on the number of worlds."""
    del state

  def source(self) -> TermSource:
    """Return the readings that make the command outside the simulation. By default an operator gives the command."""
    columns = tuple(name for name, *_ in self.axes)
    return TermSource(readings=(Reading(name=f"command/{self.name}", read=lambda: self.command, columns=columns),))

  @property
  def axes(self) -> Sequence[tuple[str, float, float]]:
    """Name, smallest and largest value of each number that viewers can set; empty by default.

    A term with axes copies the numbers of `by_hand` into its command in `update`.
    """
    return ()

  def steer(self, world: int, values: Sequence[float] | None) -> None:
    """Set the command of one world on the host: one number for each of `axes`, or None to end steering.

    Raises:
      ValueError: more or fewer numbers than axes.
    """
    axes = self.axes
    if values is not None and len(values) != len(axes):
      names = ", ".join(name for name, _, _ in axes) or "nothing"
      raise ValueError(f"command '{self.name}' is steered by {names}; got {len(values)} numbers")
    if self.by_hand is None:
      numbers = torch.zeros(self.num_envs, len(axes), dtype=self.command.dtype, device=self.device)
      self.by_hand = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device), numbers
      self.env.request_recapture(f"command '{self.name}' is steered")
    steered, numbers = self.by_hand
    steered[world] = values is not None
    if values is not None:
      numbers[world] = torch.tensor(values, dtype=numbers.dtype, device=self.device)

  def _advance(self, moving: torch.Tensor, dt: float) -> None:
    """Let time pass in the worlds of `moving`, bool (N,)."""
    self.update_metrics()
    if self.cfg.resampling_time_range is not None:
      self.time_left.sub_(moving.double(), alpha=dt)
      call_where((self.time_left <= _DUE) & moving, self._renew, self.env.rng)
    self.update()

  def _renew(self, mask: torch.Tensor) -> None:
    if self.cfg.resampling_time_range is not None:
      lo, hi = self.cfg.resampling_time_range
      draw = uniform(lo, hi, (self.num_envs,), generator=self.env.rng, device=self.device, dtype=torch.float64)
      where_(self.time_left, mask, draw)
    self.command_counter.add_(mask)
    self.resample(mask)


class CommandManager(ManagerBase[CommandTermCfg]):
  """Manager of the commands and their timers. It works on masks only and never counts worlds on the host."""

  cfg_type = CommandTermCfg

  def _mistake(self, term: CommandTerm) -> str:
    def fits(command: torch.Tensor) -> bool:
      return command.dim() >= 2 and command.shape[0] == self.num_envs

    with placed("while reading its command"):
      if misfit := self._misfit(term.command, f"a command of shape ({self.num_envs}, d)", fits):
        return misfit
    for metric, value in term.metrics.items():
      if value.shape != (self.num_envs,):
        return f"metric '{metric}' must be ({self.num_envs},), is {tuple(value.shape)}."
    return ""

  def _make(self) -> None:
    self.fresh = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
    """Worlds that do not advance in the current `compute`, bool (N,)."""
    self._none = self.fresh
    columns = [(name, term.metrics, metric) for name, term in self._terms.items() for metric in term.metrics]
    # One block for the metrics of all terms: one operation to log it, one to reset it.
    self._metric_values = self.state((len(columns),))
    for (_, metrics, metric), values in zip(columns, self._metric_values.unbind(1), strict=True):
      values.copy_(metrics[metric])
      dict.__setitem__(metrics, metric, values)
    self._log = LogBuffer([f"Metrics/{name}/{metric}" for name, _, metric in columns], self.device)

  def _rehearse(self, term: CommandTerm) -> None:
    with self._trial(term):
      term.reset(self._everywhere)
      term.resample(self._everywhere)
      term.update_metrics()
      term.update()
      term.log_values()

  def get_term(self, name: str) -> CommandTerm:
    """Return a term.

    Raises:
      UnknownNameError: no such term; the message lists the nearest names.
    """
    return self.term(name)

  def get_command(self, name: str) -> torch.Tensor:
    """Return the command of a term, (N, d).

    Raises:
      UnknownNameError: no such term; the message lists the nearest names.
    """
    return self.term(name).command

  def compute(self, dt: float, fresh: torch.Tensor | None = None) -> None:
    """Advance all commands by `dt`: metrics, timers, draws for expired timers, updates.

    Args:
      dt: elapsed time [s].
      fresh: worlds that were just reset, in which no time passed, bool (N,); None for no world.
    """
    if not self._terms:
      return
    self.fresh = self._none if fresh is None else fresh
    moving = ~self.fresh
    for name, term in self._terms.items():
      call_named(self.label, name, term._advance, moving, dt)

  def reset(self, mask: torch.Tensor) -> None:
    """Log the metrics of the worlds in `mask`, bool (N,), set them to zero, and draw new commands there."""
    if not self._terms:
      return
    if self._log.names:
      played = mask & (self.env.episode_length_buf > 0)
      # One world that diverged must not change the mean of all.
      self._log.add(self._metric_values.nan_to_num(nan=0.0, posinf=0.0, neginf=0.0), played)
      fill_(self._metric_values, mask, 0.0)
    super().reset(mask)
    for name, term in self._terms.items():
      term.command_counter.masked_fill_(mask, 0)
      call_named(self.label, name, term._renew, mask)

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return `Metrics/<command>/<metric>`, means over the episodes that ended, and the `log_values` of terms."""
    names, means = self._log.tensors()
    own: dict[str, torch.Tensor] = {}
    for name, term in self._terms.items():
      values = call_named(self.label, name, term.log_values)
      own |= {f"Metrics/{name}/{key}": value.double().reshape(1) for key, value in values.items()}
    return [*names, *own], torch.cat((means, *own.values()))

  def load_progress(self, state: Mapping[str, Any]) -> None:
    """Load the parts of a `state_dict` that do not depend on the number of worlds, term by term."""
    for name, saved in state.get("_stateful_terms", {}).items():
      if name in self._terms:
        self._terms[name].load_progress(saved)

  def clear_log(self) -> None:
    self._log.clear()

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    return [(name, term.command[env_idx].flatten().tolist()) for name, term in self._terms.items()]
