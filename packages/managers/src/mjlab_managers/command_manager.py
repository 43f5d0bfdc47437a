"""Commands: what the policy is asked to do, drawn anew from time to time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from mjlab_core.masking import fill_, where_
from mjlab_core.sampling import check_bounds, uniform
from mjlab_core.state import Stateful

from mjlab_managers.env import ManagerEnv
from mjlab_managers.log import LogBuffer
from mjlab_managers.manager import ManagerBase
from mjlab_managers.table import table

# Timers are float64, and due this early [s]: rounding of repeated subtraction must not delay one by a step.
_DUE = 1e-6


@dataclass(kw_only=True)
class CommandTermCfg(ABC):
  """Base of command configs."""

  resampling_time_range: tuple[float, float] | None
  """Shortest and longest time between two draws [s]; None: a command lasts until the reset."""
  debug_vis: bool = False
  """Whether viewers draw the command at first, which its term does if it has `debug_draw(draw)`."""

  @abstractmethod
  def build(self, env: Any) -> CommandTerm:
    """The term, on an environment whose scene is initialised."""


class Metrics(dict[str, torch.Tensor]):
  """Metrics of a command by name, float32 (N,) each, accumulating over an episode.

  `metrics["error"] = x` and `metrics["error"] += x` write into the memory that the first assignment made.
  """

  def __setitem__(self, name: str, value: torch.Tensor) -> None:
    mine = self.get(name)
    if mine is None:
      super().__setitem__(name, value.to(torch.float32, copy=True))
    elif mine is not value:
      mine.copy_(value)


class CommandTerm(Stateful, ABC):
  """Base of command terms. Subclasses name their metrics in `__init__`: `self.metrics["error"] = torch.zeros(...)`."""

  name: str = ""

  def __init__(self, cfg: CommandTermCfg, env: Any) -> None:
    self.cfg, self.env = cfg, env
    self.num_envs, self.device = env.num_envs, env.device
    self.metrics = Metrics()
    self._metric_values = torch.zeros(self.num_envs, 0, device=self.device)
    self.time_left = torch.zeros(self.num_envs, dtype=torch.float64, device=self.device)
    """Time to the next draw, float64 (N,) [s]; zero where only resets draw."""
    self.command_counter = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
    """Draws since the reset, int64 (N,)."""
    self.by_hand: tuple[torch.Tensor, torch.Tensor] | None = None
    """Which worlds are steered, bool (N,), and their numbers, (N, len(axes)); None until somebody does, so that only
    then `update` has anything to do with it."""

  @property
  @abstractmethod
  def command(self) -> torch.Tensor:
    """The command, (N, d), always in the same memory."""

  @abstractmethod
  def resample(self, mask: torch.Tensor) -> None:
    """Draws new commands, for all worlds, and writes them into those of `mask`, bool (N,)."""

  def update(self) -> None:
    """Follows what the command depends on, every step; no time passes in the worlds of `env.command_manager.fresh`."""

  def update_metrics(self) -> None:
    """Adds this step to `metrics`."""

  def reset(self, mask: torch.Tensor) -> None:
    """Forgets what belongs to the episodes of the worlds in `mask`, bool (N,), before the command is drawn anew."""
    del mask

  def log_values(self) -> dict[str, torch.Tensor]:
    """What to log beside the metrics, by name: 0-d tensors, asked for once per log interval; always the same names."""
    return {}

  def load_progress(self, state: Mapping[str, Any]) -> None:
    """Takes from a `state_dict` what a run with another number of worlds can use."""
    del state

  @property
  def axes(self) -> Sequence[tuple[str, float, float]]:
    """What viewers can give by hand: name, least and greatest value of each number; nothing unless a term says so.

    Such a term takes the numbers of `by_hand` over in `update`.
    """
    return ()

  def steer(self, world: int, values: Sequence[float] | None) -> None:
    """Give one world these numbers, one for each of `axes`, until they are taken back with None; on the host.

    Raises:
      ValueError: More or fewer numbers than axes.
    """
    axes = self.axes
    if values is not None and len(values) != len(axes):
      names = ", ".join(name for name, _, _ in axes) or "nothing"
      raise ValueError(f"command '{self.name}' is steered by {names}; got {len(values)} numbers")
    if self.by_hand is None:
      numbers = torch.zeros(self.num_envs, len(axes), dtype=self.command.dtype, device=self.device)
      self.by_hand = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device), numbers
      self.env.request_recapture(f"command '{self.name}' is given by hand")
    steered, numbers = self.by_hand
    steered[world] = values is not None
    if values is not None:
      numbers[world] = torch.tensor(values, dtype=numbers.dtype, device=self.device)

  def _renew(self, mask: torch.Tensor) -> None:
    if self.cfg.resampling_time_range is not None:
      lo, hi = self.cfg.resampling_time_range
      draw = uniform(lo, hi, (self.num_envs,), generator=self.env.rng, device=self.device, dtype=torch.float64)
      where_(self.time_left, mask, draw)
    self.command_counter.add_(mask)
    self.resample(mask)


class CommandManager(ManagerBase[CommandTermCfg]):
  """Keeps the commands and their timers. Everything works on masks; nothing asks how many worlds are in one."""

  cfg_type = CommandTermCfg
  _constants = frozenset({"fresh", "_none"})

  def __init__(self, cfgs: Mapping[str, CommandTermCfg | None], env: ManagerEnv) -> None:
    super().__init__(cfgs, env)
    self.fresh = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
    """Worlds that do not advance in the current `compute`, bool (N,)."""
    self._none = self.fresh
    self._terms: dict[str, CommandTerm] = {}
    log_names: list[str] = []
    for name, cfg in self._cfgs.items():
      try:
        if cfg.resampling_time_range is not None:
          what = f"term '{name}': resampling_time_range"
          check_bounds(what, cfg.resampling_time_range, minimum=0.0, finite=True)
      except ValueError as error:
        self._problem(str(error), error)
      term = self._build(name, cfg)
      if term is None:
        continue
      self._terms[name] = term
      log_names += [f"Metrics/{name}/{metric}" for metric in term.metrics]
      self._check_command(name, term)
      self._lay_out_metrics(name, term)
    self._raise_problems()
    self._log = LogBuffer(log_names, self.device)

  def _check_command(self, name: str, term: CommandTerm) -> None:
    try:
      command = term.command
    except Exception as error:
      self._problem(f"term '{name}': {type(error).__name__} while reading its command: {error}", error)
      return
    what = f"a command of shape ({self.num_envs}, d)"
    if self._check_tensor(name, command, what, lambda dtype: not dtype.is_complex) and (
      command.dim() < 2 or command.shape[0] != self.num_envs
    ):
      self._problem(f"term '{name}': must return {what}, returned {tuple(command.shape)}.")

  def _lay_out_metrics(self, name: str, term: CommandTerm) -> None:
    if not term.metrics:
      return
    for metric, value in term.metrics.items():
      if value.shape != (self.num_envs,):
        self._problem(f"term '{name}': metric '{metric}' must be ({self.num_envs},), is {tuple(value.shape)}.")
        return
    # One block per term: one operation to log it, one to reset it.
    term._metric_values = torch.stack(list(term.metrics.values()), dim=1)
    for column, metric in enumerate(term.metrics):
      dict.__setitem__(term.metrics, metric, term._metric_values[:, column])

  def get_term(self, name: str) -> CommandTerm:
    """A term; UnknownNameError with the nearest names if there is none such."""
    return self._lookup(self._terms, name)

  def get_command(self, name: str) -> torch.Tensor:
    """A term's command, (N, d)."""
    return self._lookup(self._terms, name).command

  def compute(self, dt: float, fresh: torch.Tensor | None = None) -> None:
    """One step of `dt` [s]: metrics, timers, new draws where a timer ran out, updates.

    Args:
      dt: time that passed [s].
      fresh: worlds for which no time passed because they were just reset, bool (N,); None for no world.
    """
    if not self._terms:
      return
    self.fresh = self._none if fresh is None else fresh
    moving = ~self.fresh
    passed = moving.double()
    for term in self._terms.values():
      term.update_metrics()
      if term.cfg.resampling_time_range is not None:
        term.time_left.sub_(passed, alpha=dt)
        term._renew((term.time_left <= _DUE) & moving)
      term.update()

  def reset(self, mask: torch.Tensor) -> None:
    """Logs the metrics of the worlds in `mask`, bool (N,), zeroes them and draws new commands there."""
    if not self._terms:
      return
    terms = list(self._terms.values())
    if self._log.names:
      blocks = [term._metric_values for term in terms if term.metrics]
      values = blocks[0] if len(blocks) == 1 else torch.cat(blocks, dim=1)
      # One world that went wrong must not spoil the mean of all.
      played = mask & (self.env.episode_length_buf > 0)
      self._log.add(values.nan_to_num(nan=0.0, posinf=0.0, neginf=0.0), played)
    super().reset(mask)
    for term in terms:
      if term.metrics:
        fill_(term._metric_values, mask, 0.0)
      term.command_counter.masked_fill_(mask, 0)
      term._renew(mask)

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """`Metrics/<command>/<metric>`: mean over the episodes that ended; and what terms log of their own."""
    names, values = self._log.tensors()
    own = {
      f"Metrics/{name}/{key}": value for name, term in self._terms.items() for key, value in term.log_values().items()
    }
    if not own:
      return names, values
    return [*names, *own], torch.cat((values, torch.stack([value.double() for value in own.values()])))

  def load_progress(self, state: Mapping[str, Any]) -> None:
    """Lets each term take from a `state_dict` what a run with another number of worlds can use."""
    for name, term in self._terms.items():
      if name in state.get("_stateful_terms", {}):
        term.load_progress(state["_stateful_terms"][name])

  def clear_log(self) -> None:
    self._log.clear()

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    return [(name, term.command[env_idx].flatten().tolist()) for name, term in self._terms.items()]

  def describe(self) -> str:
    rows = []
    for name, term in self._terms.items():
      times = term.cfg.resampling_time_range
      after = "the reset" if times is None else "{} to {} s".format(*times)
      rows.append((name, type(term).__name__, tuple(term.command.shape[1:]), after))
    return table("Commands", ("term", "type", "shape", "resampled after"), rows)
