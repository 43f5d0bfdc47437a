"""Policies to choose from while one of them runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mjlab_viewer.worlds import Policy


@dataclass(kw_only=True, frozen=True)
class CheckpointList:
  """Checkpoints of a run.

  `names` is asked anew whenever somebody wants to see what there is; `load` makes a policy of one of them.
  """

  names: Callable[[], Sequence[str]]
  """Names, oldest first."""
  load: Callable[[str], Policy]
  """The policy of a name; raises what is wrong with it."""
  loaded: str
  """Name of the one that runs at first, whether it is one of `names` or not."""
