"""Delays and histories of observation terms, and the order of the output's columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from mjlab_core import DelayBuffer, HistoryBuffer, Index, Stateful, StatefulDict, as_index

from mjlab_managers.env import ManagerEnv
from mjlab_managers.observation_slots import Slot


class Memory(Stateful):
  """Past frames of the terms that have a delay or a history.

  Args:
    slots: the terms and their columns.
    width: columns of the frame.
    env: the environment.
  """

  def __init__(self, slots: Sequence[Slot], width: int, env: ManagerEnv) -> None:
    self.num_envs, self.device = env.num_envs, env.device
    self._delay_columns = delay_columns(slots)
    by_path = {slot.path: slot.cfg for slot in slots}
    self._delays: StatefulDict[DelayBuffer] = StatefulDict()
    for key, columns in self._delay_columns.items():
      cfg = by_path[key]
      self._delays[key] = DelayBuffer(
        cfg.delay_min_lag,
        cfg.delay_max_lag,
        self.num_envs,
        (columns.stop - columns.start,),
        self.device,
        torch.float32,
        env.rng,
        cfg.delay_hold_prob,
        cfg.delay_update_period,
        per_env=cfg.delay_per_env,
        per_env_phase=cfg.delay_per_env_phase,
      )
    self._sources = {slot.path: torch.arange(slot.frame.start, slot.frame.stop) for slot in slots}
    self._build_histories([slot for slot in slots if slot.needs_history], width)
    sources = [self._sources[slot.path] for slot in slots]
    self._permutation = torch.cat(sources).to(self.device) if self._histories else None
    self.is_empty = not (self._delays or self._histories)

  def _build_histories(self, slots: Sequence[Slot], width: int) -> None:
    """Make one history buffer per length, and the index of each output column in [frame, history, history, ...]."""
    self._histories: StatefulDict[HistoryBuffer] = StatefulDict()
    self._history_columns: dict[str, Index] = {}
    for length in sorted({slot.history for slot in slots}):
      those = [slot for slot in slots if slot.history == length]
      columns = [column for slot in those for column in range(slot.frame.start, slot.frame.stop)]
      self._history_columns[str(length)] = as_index(columns, self.device)
      self._histories[str(length)] = HistoryBuffer(length, self.num_envs, (len(columns),), self.device, torch.float32)
      places = torch.arange(width, width + length * len(columns)).view(length, len(columns))
      parts = places.split([slot.width for slot in those], dim=1)
      self._sources |= {slot.path: part.flatten() for slot, part in zip(those, parts, strict=True)}
      width += places.numel()

  def advance(self, frame: torch.Tensor, fresh: torch.Tensor | None, only: torch.Tensor | None) -> torch.Tensor:
    """Delay the columns of `frame`, (N, W), in place, and return the output with all histories.

    Args:
      frame: the newest frame.
      fresh: worlds whose delays and histories are filled with this frame, bool (N,).
      only: worlds to change, bool (N,); their delays and histories are filled with this frame. None for all worlds.
    """
    for key, delay in self._delays.items():
      columns = frame[:, self._delay_columns[key]]
      if only is not None:
        delay.fill(only, columns)
        continue
      if fresh is not None:
        delay.reset(fresh)
      columns.copy_(delay.push(columns))
    if self._permutation is None:
      return frame
    blocks = [frame]
    for key, history in self._histories.items():
      columns = frame[:, self._history_columns[key]]
      if only is not None:
        history.fill(only, columns)
      else:
        if fresh is not None:
          history.reset(fresh)
        history.append(columns)
      blocks.append(history.read().flatten(1))
    return torch.cat(blocks, dim=1).index_select(1, self._permutation)


def delay_columns(slots: Sequence[Slot]) -> dict[str, slice]:
  """Return the columns of the frame that share one delay buffer, by the path of its first slot."""
  columns: dict[str, slice] = {}
  last: tuple[Any, ...] | None = None
  key = ""
  for slot in slots:
    cfg = slot.cfg
    if cfg.delay_max_lag == 0:
      last = None
      continue
    fixed = cfg.delay_min_lag == cfg.delay_max_lag
    # Neighbours with one constant delay share a line; random delays are drawn for each term.
    if fixed and last == (slot.group, cfg.delay_max_lag):
      columns[key] = slice(columns[key].start, slot.frame.stop)
    else:
      key = slot.path
      columns[key] = slot.frame
    last = (slot.group, cfg.delay_max_lag) if fixed else None
  return columns
