"""Columns of observation terms in the processed frame and in the output."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from mjlab_managers.binding import Term, same
from mjlab_managers.observation_cfg import ObservationGroupCfg, ObservationTermCfg


@dataclass
class Slot:
  """Term of a group, with its columns in the frame of all terms and in the output."""

  group: str
  name: str
  group_cfg: ObservationGroupCfg
  cfg: ObservationTermCfg
  own: Term
  """Binding of this slot."""
  term: Term
  """Evaluated binding: `own`, or that of an earlier slot with the same function and parameters."""
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
  def needs_history(self) -> bool:
    """True if the term needs a history buffer. A term without columns needs none."""
    return self.history > 1 and self.width > 0

  @property
  def out_shape(self) -> tuple[int, ...]:
    if self.history == 0:
      return self.shape
    return (self.history * self.width,) if self.flatten else (self.history, *self.shape)

  def processing(self) -> tuple[Any, ...]:
    """Return the configs of the processing. A replaced config has another identity."""
    cfg, group = self.cfg, self.group_cfg
    return (cfg.noise, cfg.clip, cfg.scale, group.corrupt, group.nan_policy)


def twin_of(own: Term, slots: Sequence[Slot]) -> Slot | None:
  """Return a slot with the same function and the same parameters. Class terms are never shared."""
  if hasattr(own.func, "reset"):
    return None
  for slot in slots:
    if same(slot.own.func, own.func) and same(slot.own.given, own.given):
      return slot
  return None


def place_columns(slots: Sequence[Slot]) -> None:
  """Assign columns to all slots, one after the other."""
  frame = out = 0
  for slot in slots:
    slot.frame = slice(frame, frame + slot.width)
    slot.out = slice(out, out + math.prod(slot.out_shape))
    frame, out = slot.frame.stop, slot.out.stop
