"""Ring buffers over time with one row per world: a window of past frames, and a delay line.

Both live inside a captured step. Time is a counter on the device, one frame is written per step, and a world's reset
moves only that world's "born" mark: reads never look behind it, which back-fills a young window with its first frame at
no cost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from mjlab_core.masking import where_
from mjlab_core.state import Stateful


class _Ring(Stateful):
  """`length` frames, time first: storage (length, num_envs, *shape)."""

  _constants = frozenset({"_rows"})
  _extra_state = ("_storage", "_tick")

  def __init__(
    self, length: int, num_envs: int, shape: Sequence[int], device: torch.device | str, dtype: torch.dtype
  ) -> None:
    if length < 1:
      raise ValueError(f"{type(self).__name__}: length must be at least 1, got {length}.")
    self.length, self.num_envs, self.shape = length, num_envs, tuple(shape)
    self.device, self.dtype = torch.device(device), dtype
    self._frame = (num_envs, *self.shape)
    self._storage = torch.zeros((length, *self._frame), device=device, dtype=dtype)
    # Tick of the newest frame. A row's born mark is the tick of its first frame; tick + 1 means none yet.
    self._tick = torch.zeros(1, device=device, dtype=torch.int64)
    self._born = torch.ones(num_envs, device=device, dtype=torch.int64)
    self._rows = torch.arange(num_envs, device=device)

  def fill(self, mask: Tensor, x: Tensor | float) -> None:
    """Makes `x` the whole past of the masked rows, as if it had been written for ever; time does not move.

    `mask` is bool (num_envs,); `x` broadcasts to (num_envs, *shape). The other rows stay bit-identical.
    """
    self._put_newest(mask, x)
    where_(self._born, mask, self._tick)

  def reset(self, mask: Tensor) -> None:
    """Forgets the masked rows, bool (num_envs,): they read zero until the next frame, which then back-fills them."""
    self._put_newest(mask, 0.0)
    where_(self._born, mask, self._tick + 1)

  def take_back(self, before: Mapping[str, Any], mask: Tensor) -> None:
    """As for all that is Stateful; a frame that was written since becomes the whole past of the masked rows."""
    written = self._tick != before["_tick"]
    newest = self._storage.index_select(0, self._tick % self.length)[0]
    super().take_back(before, mask)
    _Ring.fill(self, mask & written, newest)

  def _put_newest(self, mask: Tensor, x: Tensor | float) -> None:
    slot = self._tick % self.length
    newest = self._storage.index_select(0, slot)
    where_(newest[0], mask, x)
    self._storage.index_copy_(0, slot, newest)

  def _write(self, x: Tensor) -> None:
    if x.shape != self._frame:
      raise ValueError(f"{type(self).__name__}: expected a frame of shape {self._frame}, got {tuple(x.shape)}.")
    self._tick.add_(1)
    self._storage.index_copy_(0, self._tick % self.length, x.to(self.dtype).unsqueeze(0))


class HistoryBuffer(_Ring):
  """The last `length` frames of every world.

  Args:
    length: number of frames kept, at least 1.
    num_envs: number of worlds.
    shape: shape of one world's frame.
    device: where the frames live.
    dtype: their type; what is appended is cast to it.
  """

  _constants = frozenset({"_ages"})

  def __init__(
    self,
    length: int,
    num_envs: int,
    shape: Sequence[int],
    device: torch.device | str,
    dtype: torch.dtype = torch.float32,
  ) -> None:
    super().__init__(length, num_envs, shape, device, dtype)
    self._ages = torch.arange(length - 1, -1, -1, device=device)

  def append(self, x: Tensor) -> None:
    """Adds the newest frame, (num_envs, *shape); the oldest is dropped."""
    self._write(x)

  def read(self) -> Tensor:
    """The window, oldest first, (num_envs, length, *shape), in new memory; a young row repeats its first frame."""
    ticks = torch.minimum(torch.maximum(self._tick - self._ages, self._born[:, None]), self._tick)
    return self._storage[ticks % self.length, self._rows[:, None]]


class DelayBuffer(_Ring):
  """Serves frames that are `lag` pushes old, with a lag in [min_lag, max_lag] per world at every moment.

  The lag is drawn at build, at a world's reset, and then anew at pushes: at every push, or every `update_period` pushes
  if that is positive (each world at its own phase), and each time kept as it was with probability `hold_prob`. A row
  younger than its lag serves its first frame. With min_lag == max_lag no random number is drawn.

  Args:
    min_lag: smallest lag [pushes], at least 0.
    max_lag: largest lag [pushes].
    num_envs: number of worlds.
    shape: shape of one world's frame.
    device: where the frames live.
    dtype: their type; what is pushed is cast to it.
    generator: source of the lags, on `device`; None is torch's global one.
    hold_prob: probability in [0, 1] that a lag due for a new draw stays.
    update_period: pushes between two draws; 0 draws at every push.
    per_env: False gives all worlds one lag, which a reset then leaves alone.
    per_env_phase: False lets all worlds redraw at the same push after their reset.
  """

  def __init__(
    self,
    min_lag: int,
    max_lag: int,
    num_envs: int,
    shape: Sequence[int],
    device: torch.device | str,
    dtype: torch.dtype = torch.float32,
    generator: torch.Generator | None = None,
    hold_prob: float = 0.0,
    update_period: int = 0,
    *,
    per_env: bool = True,
    per_env_phase: bool = True,
  ) -> None:
    if not 0 <= min_lag <= max_lag:
      raise ValueError(f"DelayBuffer: needs 0 <= min_lag <= max_lag, got min_lag {min_lag}, max_lag {max_lag}.")
    if not 0.0 <= hold_prob <= 1.0:
      raise ValueError(f"DelayBuffer: hold_prob must be in [0, 1], got {hold_prob}.")
    if update_period < 0:
      raise ValueError(f"DelayBuffer: update_period must not be negative, got {update_period}.")
    super().__init__(max_lag + 1, num_envs, shape, device, dtype)
    self.min_lag, self.max_lag = min_lag, max_lag
    self.hold_prob, self.update_period = hold_prob, update_period
    self._generator, self._per_env, self._per_env_phase = generator, per_env, per_env_phase
    self._varies = min_lag < max_lag
    self._lag = torch.full((num_envs,), min_lag, device=device, dtype=torch.int64)
    self._until_draw = torch.full((num_envs,), update_period, device=device, dtype=torch.int64)
    self._pinned: Tensor | None = None
    if self._varies:
      self._lag.copy_(self._draw_lags())
      self._until_draw.copy_(self._draw_phases())

  @property
  def lag(self) -> Tensor:
    """The lag now, int64 (num_envs,) [pushes]; not to be written."""
    return self._lag

  def push(self, x: Tensor) -> Tensor:
    """Adds a frame, (num_envs, *shape), and returns the delayed one, of that shape; `x` itself if max_lag is 0."""
    if self.max_lag == 0:
      self._write(x)
      return x.to(self.dtype)
    if self._varies:
      self._advance_lags()
    self._write(x)
    return self._delayed(torch.maximum(self._tick - self._lag, self._born))

  def read(self) -> Tensor:
    """The delayed frame as of the last push, (num_envs, *shape); time does not move."""
    return self._delayed(torch.minimum(torch.maximum(self._tick - self._lag, self._born), self._tick))

  def reset(self, mask: Tensor) -> None:
    """Forgets the masked rows, bool (num_envs,), and draws their lags anew; the others stay bit-identical."""
    super().reset(mask)
    self._restart(mask)

  def fill(self, mask: Tensor, x: Tensor | float) -> None:
    """Makes `x` the whole past of the masked rows and draws their lags anew; the others stay bit-identical.

    `mask` is bool (num_envs,); `x` broadcasts to (num_envs, *shape).
    """
    super().fill(mask, x)
    self._restart(mask)

  def pin(self, mask: Tensor, lag: Tensor | int) -> None:
    """Sets the lags of the masked rows, bool (num_envs,), and keeps them through draws and resets until the next pin.

    `lag` is int64 and broadcasts to (num_envs,) [pushes]; it is clamped to [min_lag, max_lag]. The first call makes
    memory, so it belongs before a step is recorded; an empty mask does only that.

    Raises:
      ValueError: the lag is the same for all rows at all times, so there is nothing to set.
    """
    if not (self._varies and self._per_env):
      raise ValueError(
        f"DelayBuffer: lags in [{self.min_lag}, {self.max_lag}], per_env {self._per_env}, are alike in all rows; they "
        "cannot be pinned."
      )
    if self._pinned is None:
      self._pinned = torch.full_like(self._lag, -1)
    lag = torch.as_tensor(lag, device=self.device).clamp(self.min_lag, self.max_lag)
    where_(self._pinned, mask, lag)
    where_(self._lag, mask, lag)

  def _restart(self, mask: Tensor) -> None:
    if self._varies and self._per_env:
      where_(self._lag, mask, self._draw_lags())
      if self.update_period > 0:
        where_(self._until_draw, mask, self._draw_phases())

  def _advance_lags(self) -> None:
    lags = self._draw_lags()
    if self.update_period == 0 and self.hold_prob == 0.0:
      self._lag.copy_(lags)
      return
    due = None
    if self.update_period > 0:
      self._until_draw.sub_(1)
      due = self._until_draw <= 0
      self._until_draw.masked_fill_(due, self.update_period)
    if self.hold_prob > 0.0:
      moves = torch.rand(self._draws, generator=self._generator, device=self.device) >= self.hold_prob
      due = moves if due is None else due & moves
    assert due is not None
    where_(self._lag, due, lags)

  @property
  def _draws(self) -> tuple[int]:
    return (self.num_envs,) if self._per_env else (1,)

  def _draw_lags(self) -> Tensor:
    lags = torch.randint(
      self.min_lag, self.max_lag + 1, self._draws, generator=self._generator, device=self.device, dtype=torch.int64
    )
    return lags if self._pinned is None else torch.where(self._pinned >= 0, self._pinned, lags)

  def _draw_phases(self) -> Tensor:
    if self.update_period == 0 or not (self._per_env and self._per_env_phase):
      return torch.full_like(self._until_draw, self.update_period)
    return torch.randint(
      1, self.update_period + 1, self._draws, generator=self._generator, device=self.device, dtype=torch.int64
    )

  def _delayed(self, ticks: Tensor) -> Tensor:
    return self._storage[ticks % self.length, self._rows]
