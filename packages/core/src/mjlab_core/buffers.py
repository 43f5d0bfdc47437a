"""Ring buffers over time with one row per world: a window of past frames, and a delay line.

Both work inside a recorded step: fixed memory, no host reads. Each world has its own clock. The first frame after a
reset stands for all frames before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import torch
from torch import Tensor

from mjlab_core.constraints import Ascending, Count, PositiveCount, Share, check_value
from mjlab_core.indexing import where_
from mjlab_core.state import Stateful


class _Ring(Stateful):
  """`length` frames per world, (num_envs, length, *shape)."""

  def __init__(
    self, length: int, num_envs: int, shape: Sequence[int], device: torch.device | str, dtype: torch.dtype
  ) -> None:
    check_value(f"{type(self).__name__}: length", length, PositiveCount)
    self.length, self.num_envs, self.shape = length, num_envs, tuple(shape)
    self.device, self.dtype = torch.device(device), dtype
    self._frames = self.state((length, *self.shape), dtype=dtype)
    self._worlds = torch.arange(num_envs, device=device)
    # Tick of the newest frame, and of the first one since the reset. The latter is tick + 1 before the first frame.
    self._tick = self.state(dtype=torch.int64)
    self._born = self.state(dtype=torch.int64, fill=1)

  def fill(self, mask: Tensor, x: Tensor | float) -> None:
    """Make `x` the whole past of the worlds in `mask`, bool (num_envs,); time does not pass.

    `x` broadcasts to (num_envs, *shape). The other worlds stay bit-identical.
    """
    self._restart(mask, x, self._tick)

  def reset(self, mask: Tensor) -> None:
    """Forget the frames of the worlds in `mask`, bool (num_envs,); the others are unchanged.

    They read zero until their next frame, which then fills their whole past.
    """
    self._restart(mask, 0.0, self._tick + 1)

  def refill(self, mask: Tensor) -> None:
    self.reset(mask)

  def _restart(self, mask: Tensor, x: Tensor | float, born: Tensor) -> None:
    slot = self._tick % self.length
    self._frames[self._worlds, slot] = where_(self._frames[self._worlds, slot], mask, x)
    where_(self._born, mask, born)

  def append(self, x: Tensor) -> None:
    """Add the newest frame, (num_envs, *shape); the oldest is dropped."""
    self._tick.add_(1)
    self._frames[self._worlds, self._tick % self.length] = x.to(self.dtype)


class HistoryBuffer(_Ring):
  """Window of the last `length` frames of every world.

  Args:
    length: number of frames kept, at least 1.
    num_envs: number of worlds.
    shape: shape of one world's frame.
    device: device of the frames.
    dtype: type of the frames; appended frames are cast to it.
  """

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

  def read(self) -> Tensor:
    """Return the window, oldest first, (num_envs, length, *shape), in new memory.

    A world that is younger than the window repeats its first frame.
    """
    tick = self._tick[:, None]
    ticks = torch.minimum(torch.maximum(tick - self._ages, self._born[:, None]), tick)
    return self._frames[self._worlds[:, None], ticks % self.length]


class DelayBuffer(_Ring):
  """Delay line that serves frames `lag` pushes late, with a lag in [min_lag, max_lag] per world.

  A lag is drawn at build, at `reset` and `fill` of a world, and at pushes: at every push, or every `update_period`
  pushes if that is positive (each world in its own phase). A draw keeps the old lag with probability `hold_prob`. A
  world younger than its lag serves its first frame. With min_lag == max_lag no random number is drawn.

  Args:
    min_lag: smallest lag [pushes], at least 0.
    max_lag: largest lag [pushes].
    num_envs: number of worlds.
    shape: shape of one world's frame.
    device: device of the frames.
    dtype: type of the frames; pushed frames are cast to it.
    generator: source of the lags, on `device`; None is torch's global one.
    hold_prob: probability in [0, 1] that a lag due for a new draw stays.
    update_period: pushes between two draws; 0 draws at every push.
    per_env: False gives all worlds one lag, which a reset leaves alone.
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
    check_value("DelayBuffer: (min_lag, max_lag)", (min_lag, max_lag), Annotated[tuple[Count, Count], Ascending()])
    check_value("DelayBuffer: hold_prob", hold_prob, Share)
    check_value("DelayBuffer: update_period", update_period, Count)
    super().__init__(max_lag + 1, num_envs, shape, device, dtype)
    self.min_lag, self.max_lag = min_lag, max_lag
    self.hold_prob, self.update_period = hold_prob, update_period
    self._generator, self._per_env, self._per_env_phase = generator, per_env, per_env_phase
    self._varies = min_lag < max_lag
    self._draws = (num_envs if per_env else 1,)
    self._lag = self.state(dtype=torch.int64, fill=min_lag)
    # Pushes to the next draw, this one included.
    self._until_draw = self.state(dtype=torch.int64, fill=update_period + 1)
    self._pinned: Tensor | None = None
    if self._varies:
      self._lag.copy_(self._draw_lags())
      self._until_draw.copy_(self._draw_phases())

  @property
  def lag(self) -> Tensor:
    """Present lag, int64 (num_envs,) [pushes]; read-only."""
    return self._lag

  def push(self, x: Tensor) -> Tensor:
    """Add a frame, (num_envs, *shape), and return the delayed one, of that shape; `x` itself if max_lag is 0."""
    if self.max_lag == 0:
      self.append(x)
      return x.to(self.dtype)
    if self._varies:
      self._advance_lags()
    self.append(x)
    return self._frames[self._worlds, torch.maximum(self._tick - self._lag, self._born) % self.length]

  def pin(self, mask: Tensor, lag: Tensor | int) -> None:
    """Set the lags of the worlds in `mask`, bool (num_envs,), and keep them through draws and resets.

    `lag` is int64 and broadcasts to (num_envs,) [pushes]; it is clamped to [min_lag, max_lag]. The first call
    allocates memory, so it belongs before a step is recorded; with an empty mask it does nothing else.
    """
    if self._pinned is None:
      self._pinned = self.state(dtype=torch.int64, fill=-1)
    lag = torch.as_tensor(lag, device=self.device).clamp(self.min_lag, self.max_lag)
    where_(self._pinned, mask, lag)
    where_(self._lag, mask, lag)

  def _restart(self, mask: Tensor, x: Tensor | float, born: Tensor) -> None:
    super()._restart(mask, x, born)
    if self._varies and self._per_env:
      where_(self._lag, mask, self._draw_lags())
      if self.update_period > 0:
        where_(self._until_draw, mask, self._draw_phases())

  def _advance_lags(self) -> None:
    lags = self._draw_lags()
    if self.hold_prob > 0.0:
      holds = torch.rand(self._draws, generator=self._generator, device=self.device) < self.hold_prob
      lags = torch.where(holds, self._lag, lags)
    if self.update_period > 0:
      self._until_draw.sub_(1)
      due = self._until_draw <= 0
      self._until_draw.masked_fill_(due, self.update_period)
      where_(self._lag, due, lags)
    else:
      self._lag.copy_(lags)

  def _draw_lags(self) -> Tensor:
    lags = self._draw(self.min_lag, self.max_lag)
    return lags if self._pinned is None else torch.where(self._pinned >= 0, self._pinned, lags)

  def _draw_phases(self) -> Tensor:
    if self.update_period == 0 or not (self._per_env and self._per_env_phase):
      return torch.full_like(self._until_draw, self.update_period + 1)
    return self._draw(1, self.update_period)

  def _draw(self, lo: int, hi: int) -> Tensor:
    return torch.randint(lo, hi + 1, self._draws, generator=self._generator, device=self.device, dtype=torch.int64)
