"""A function of torch operations and physics that a GPU records once and replays."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
  from mjlab_sim.graph import Recorder
  from mjlab_sim.simulation import Simulation

_WARM_UP_CALLS = 3


class StepGraph:
  """A function that is recorded on a GPU and replayed; made by `Simulation.capture`."""

  def __init__(self, sim: "Simulation", fn: Callable[[], object], generators: Sequence[torch.Generator]) -> None:
    self._sim = sim
    self._fn = fn
    self._generators = generators
    self._calls = 0
    self._recorder: Recorder | None = None
    self.recorded = sim.device.type == "cuda" and sim.cfg.capture
    """Whether calls are replays of a recording."""

  def __call__(self) -> None:
    sim = self._sim
    sim._check_open()
    sim._refresh()
    if not self.recorded:
      self._fn()
      sim._refresh()
      return
    sim.fixed_geoms_are_in_place()
    if self._recorder is None and self._calls >= _WARM_UP_CALLS:
      self._record()
    if self._recorder is None:
      # Kernels and libraries load on first use, which a capture does not allow; these calls are real steps.
      self._calls += 1
      self._fn()
      sim._refresh()
      return
    sim._is_replaying = True
    try:
      self._recorder.replay()
    finally:
      sim._is_replaying = False
      sim._epoch += 1

  def invalidate(self) -> None:
    """Record anew before the next replay: memory or behaviour changed."""
    self._recorder = None
    self._calls = min(self._calls, _WARM_UP_CALLS - 1)

  @property
  def num_graphs(self) -> int:
    """How many graphs the recording consists of: one, and one more for every eager call between."""
    return 0 if self._recorder is None else self._recorder.num_graphs

  def _record(self) -> None:
    from mjlab_sim.graph import Recorder

    sim = self._sim
    # What is recorded may itself ask for a new recording, which drops this one.
    self._recorder = sim._recorder = Recorder(sim.device, self._generators)
    # Nothing cached before may be left out of the recording, and nothing recorded may be taken for computed.
    sim._epoch += 1
    try:
      sim._recorder.record(self._body)
    except BaseException:
      self._recorder = None
      raise
    finally:
      sim._recorder = None
      sim._epoch += 1

  def _body(self) -> None:
    self._fn()
    self._sim._refresh()
