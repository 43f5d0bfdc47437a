"""Delays and histories of observation terms, and the order of the output's columns."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from mjlab_core import DelayBuffer, HistoryBuffer, Index, Stateful, StatefulDict, as_index

from mjlab_managers.env import ManagerEnv
from mjlab_managers.observations.observation_processing import TermLayout


class Memory(Stateful):
  """Past frames of the terms that have a delay or a history.

  Args:
    slots: the terms and their columns.
    env: the environment.
  """

  def __init__(self, slots: Sequence[TermLayout], env: ManagerEnv) -> None:
    self.num_envs, self.device = env.num_envs, env.device
    self._delays: StatefulDict[DelayBuffer] = StatefulDict()
    self._histories: StatefulDict[HistoryBuffer] = StatefulDict()
    self._columns: dict[str, Index] = {}
    for slot in slots:
      if slot.cfg.delay_max_lag > 0:
        self._columns[slot.path] = slot.frame
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
    # Index of each output column in [frame, history, history, ...], with one history for each length.
    sources = {slot: torch.arange(slot.frame.start, slot.frame.stop) for slot in slots}
    width = sum(slot.width for slot in slots)
    remembered = [slot for slot in slots if slot.history_length > 1 and slot.width > 0]
    for length in sorted({slot.history_length for slot in remembered}):
      those = [slot for slot in remembered if slot.history_length == length]
      columns = torch.cat([sources[slot] for slot in those]).tolist()
      self._columns[str(length)] = as_index(columns, self.device)
      self._histories[str(length)] = HistoryBuffer(length, self.num_envs, (len(columns),), self.device, torch.float32)
      places = torch.arange(width, width + length * len(columns)).view(length, len(columns))
      parts = places.split([slot.width for slot in those], dim=1)
      sources |= {slot: part.flatten() for slot, part in zip(those, parts, strict=True)}
      width += places.numel()
    self._permutation = torch.cat(list(sources.values())).to(self.device) if self._histories else None
    self.is_empty = not (self._delays or self._histories)

  def advance(self, frame: torch.Tensor, fresh: torch.Tensor | None, only: torch.Tensor | None) -> torch.Tensor:
    """Delay the columns of `frame`, (N, W), in place, and return the output with all histories.

    Args:
      frame: the newest frame.
      fresh: worlds whose delays and histories are filled with this frame, bool (N,).
      only: worlds to change, bool (N,); their delays and histories are filled with this frame. None for all worlds.
    """
    for key, delay in self._delays.items():
      columns = frame[:, self._columns[key]]
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
      columns = frame[:, self._columns[key]]
      if only is not None:
        history.fill(only, columns)
      else:
        if fresh is not None:
          history.reset(fresh)
        history.append(columns)
      blocks.append(history.read().flatten(1))
    return torch.cat(blocks, dim=1).index_select(1, self._permutation)
