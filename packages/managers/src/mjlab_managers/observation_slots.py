"""Where the terms of all observation groups are: in the frame that is processed, and in the output."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from mjlab_managers.binding import Term, same
from mjlab_managers.observation_cfg import ObservationGroupCfg, ObservationTermCfg


@dataclass
class Slot:
  """A term of a group: its columns in the frame of all terms, and in the output."""

  group: str
  name: str
  group_cfg: ObservationGroupCfg
  cfg: ObservationTermCfg
  own: Term
  """The slot's own binding, whose parameters are the ones in `cfg`."""
  term: Term
  """What is evaluated: `own`, or that of an earlier slot that asks for the same."""
  shape: tuple[int, ...]
  history: int
  flatten: bool
  frame: slice = field(default_factory=lambda: slice(0, 0))
  out: slice = field(default_factory=lambda: slice(0, 0))

  @property
  def path(self) -> str:
    return f"{self.group}/{self.name}"

  @property
  def width(self) -> int:
    return math.prod(self.shape)

  @property
  def remembers(self) -> bool:
    """Whether there is a window of its past to keep: joints of an entity that has none make an observation of none."""
    return self.history > 1 and self.width > 0

  @property
  def out_shape(self) -> tuple[int, ...]:
    if self.history == 0:
      return self.shape
    return (self.history * self.width,) if self.flatten else (self.history, *self.shape)

  def processing(self) -> tuple[Any, ...]:
    """What the fused pass was compiled from; a replaced value has another identity."""
    cfg, group = self.cfg, self.group_cfg
    return (cfg.noise, cfg.clip, cfg.scale, group.corrupt, group.nan_policy)


def twin_of(own: Term, slots: Sequence[Slot]) -> Slot | None:
  """A slot that evaluates the same function with the same parameters; what remembers something is never shared."""
  if hasattr(own.func, "reset"):
    return None
  for slot in slots:
    if same(slot.own.func, own.func) and same(slot.own.cfg.params, own.cfg.params):
      return slot
  return None


def place_columns(slots: Sequence[Slot]) -> None:
  """Gives every slot its columns, one behind the other."""
  frame = out = 0
  for slot in slots:
    slot.frame = slice(frame, frame + slot.width)
    slot.out = slice(out, out + math.prod(slot.out_shape))
    frame, out = slot.frame.stop, slot.out.stop


def delay_columns(slots: Sequence[Slot]) -> dict[str, slice]:
  """Columns of the frame that go through one delay line, by the path of the first slot in it."""
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
