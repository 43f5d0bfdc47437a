"""Functions of torch operations and physics that a GPU records once and replays."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import torch
from mjlab_core import MjlabError

from mjlab_sim.freshness import Freshness

if TYPE_CHECKING:
  from mjlab_sim.warp.recorder import Recorder

_WARM_UP_CALLS = 3


class Recordings:
  """All step graphs of a simulation, and the recording that is under way.

  Args:
    fresh: The worlds.
    prepare: Called before each replay; it may invalidate graphs.
  """

  def __init__(self, fresh: Freshness, prepare: Callable[[], object]) -> None:
    self.fresh = fresh
    self.prepare = prepare
    self.recorder: Recorder | None = None
    """The recording under way: operations are noted, not run."""
    self.is_replaying = False
    self.graphs: list[StepGraph] = []

  @property
  def is_inside(self) -> bool:
    """True inside a function that is being recorded or replayed."""
    return self.recorder is not None or self.is_replaying

  def invalidate_outside(self, change: str) -> None:
    """Have every graph recorded again after a change, which is refused inside a recorded step."""
    if self.is_inside:
      raise MjlabError(f"{change} inside a recorded step; do it before the first step")
    self.invalidate()

  def invalidate(self) -> None:
    """Have every graph recorded again before its next replay: memory or behaviour changed."""
    for graph in self.graphs:
      graph.invalidate()

  def interrupt(self, fn: Callable[[], object]) -> None:
    """Call `fn` eagerly at this point of every replay; outside of a recording call it now."""
    if self.recorder is None:
      fn()
      return

    def between() -> None:
      # A replay changes memory that caches follow by version.
      self.fresh.version += 1
      fn()
      self.fresh.refresh()

    self.fresh.refresh()
    self.recorder.interrupt(between)
    self.fresh.version += 1


class StepGraph:
  """A function that is recorded on a GPU and replayed; made by `Simulation.capture`."""

  def __init__(
    self,
    recordings: Recordings,
    fn: Callable[[], object],
    generators: Sequence[torch.Generator],
    device: torch.device,
    *,
    recorded: bool,
  ) -> None:
    self._recordings = recordings
    self._fresh = recordings.fresh
    self._fn = fn
    self._generators = generators
    self._device = device
    self._calls = 0
    self._recorder: Recorder | None = None
    self.recorded = recorded
    """True if calls are replays of a recording."""
    recordings.graphs.append(self)

  def __call__(self) -> None:
    self._fresh.refresh()
    if self.recorded:
      self._recordings.prepare()
      if self._recorder is None and self._calls >= _WARM_UP_CALLS:
        self._record()
    if self._recorder is None:
      # Kernels and libraries load on first use, which a capture does not allow: the first calls are real steps.
      self._calls += 1
      # `_run` in place: one call less on the path of an action.
      self._fn()
      self._fresh.refresh()
      return
    self._recordings.is_replaying = True
    try:
      self._recorder.replay()
    finally:
      self._recordings.is_replaying = False
      self._fresh.version += 1

  def invalidate(self) -> None:
    """Record again before the next replay: memory or behaviour changed."""
    self._recorder = None
    self._calls = min(self._calls, _WARM_UP_CALLS - 1)

  @property
  def num_graphs(self) -> int:
    """Number of CUDA graphs of the recording: one, and one more for every eager call between."""
    return 0 if self._recorder is None else self._recorder.num_graphs

  def _record(self) -> None:
    from mjlab_sim.warp.recorder import Recorder

    # The recorded function may ask for a new recording, which drops this one.
    recorder = self._recorder = self._recordings.recorder = Recorder(self._device, self._generators)
    # Nothing cached before may be left out of the recording, and nothing recorded may be taken for computed.
    self._fresh.version += 1
    try:
      recorder.record(self._run)
    except BaseException:
      self._recorder = None
      raise
    finally:
      self._recordings.recorder = None
      self._fresh.version += 1

  def _run(self) -> None:
    self._fn()
    self._fresh.refresh()
