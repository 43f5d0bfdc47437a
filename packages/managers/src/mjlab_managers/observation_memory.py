"""Delays and histories of observation terms, and the order of the output's columns."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from mjlab_core import DelayBuffer, HistoryBuffer, Stateful, StatefulDict, as_index

from mjlab_managers.env import ManagerEnv
from mjlab_managers.observation_processing import TermLayout


class Memory(Stateful):
  """Past frames of the terms that have a delay or a history.

  Args:
    slots: the terms and their columns.
    env: the environment.
  """

  def __init__(self, slots: Sequence[TermLayout], env: ManagerEnv) -> None:
    self.num_envs, self.device = env.num_envs, env.device
    self._delays: StatefulDict[DelayBuffer] = StatefulDict()
    self._delayed: list[TermLayout] = [slot for slot in slots if slot.cfg.delay_max_lag > 0]
    for slot in self._delayed:
      self._delays[slot.path] = DelayBuffer(
        slot.cfg.delay_min_lag,
        slot.cfg.delay_max_lag,
        self.num_envs,
        (slot.width,),
        self.device,
        torch.float32,
        env.rng,
        slot.cfg.delay_hold_prob,
        slot.cfg.delay_update_period,
        per_env=slot.cfg.delay_per_env,
        per_env_phase=slot.cfg.delay_per_env_phase,
      )
    # One history of all columns that have one, as long as the longest, and the index of each output column in
    # [frame, history].
    self._history: HistoryBuffer | None = None
    if remembered := [slot for slot in slots if slot.history_length > 1 and slot.width > 0]:
      length = max(slot.history_length for slot in remembered)
      columns = [column for slot in remembered for column in range(slot.frame.start, slot.frame.stop)]
      self._remembered = as_index(columns, self.device)
      self._history = HistoryBuffer(length, self.num_envs, (len(columns),), self.device, torch.float32)
      places = torch.arange(length * len(columns)).view(length, -1) + slots[-1].frame.stop
      sources = {slot: torch.arange(slot.frame.start, slot.frame.stop) for slot in slots}
      for slot, part in zip(remembered, places.split([slot.width for slot in remembered], dim=1), strict=True):
        sources[slot] = part[-slot.history_length :].flatten()
      self._permutation = torch.cat(list(sources.values())).to(self.device)
    self.is_empty = not (self._delays or self._history)

  def advance(self, frame: torch.Tensor, fresh: torch.Tensor | None, only: torch.Tensor | None) -> torch.Tensor:
    """Delay the columns of `frame`, (N, W), in place, and return the output with all histories.

    Args:
      frame: the newest frame.
      fresh: worlds whose delays and histories are filled with this frame, bool (N,).
      only: worlds to change, bool (N,); their delays and histories are filled with this frame. None for all worlds.
    """
    for slot in self._delayed:
      columns, delay = frame[:, slot.frame], self._delays[slot.path]
      if only is not None:
        delay.fill(only, columns)
        continue
      if fresh is not None:
        delay.reset(fresh)
      columns.copy_(delay.push(columns))
    history = self._history
    if history is None:
      return frame
    columns = frame[:, self._remembered]
    if only is not None:
      history.fill(only, columns)
    else:
      if fresh is not None:
        history.reset(fresh)
      history.append(columns)
    return torch.cat((frame, history.read().flatten(1)), dim=1).index_select(1, self._permutation)
