"""Launches of an engine's stages: recorded once as graphs, then replayed."""

import contextlib
import dataclasses
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

import mujoco
import mujoco_warp as mjw
import torch
import warp as wp
from mjlab_core import MjlabError

from mjlab_sim.warp.recorder import Recorder


@dataclass
class Stage:
  """Worlds that kernels work on: a model and the poses of its parts in every world."""

  model: mujoco.MjModel
  num_envs: int
  m: Any
  """MuJoCo Warp's model. Its arrays may be replaced, when a field is expanded."""
  d: Any
  """Holds the poses, under the names that MuJoCo Warp's data have."""
  device: Any
  """Warp's device."""
  run: Callable[[str, Callable[[], None]], None]
  """Runs launches under a name; they may be recorded and replayed under it."""
  refresh: Callable[[], None] = lambda: None
  """Brings `m` and `d` up to date."""


class Launcher:
  """Launcher of stages of Warp kernels on one device, on torch's current stream.

  Args:
    d: Data that stages write; a warm-up launch leaves it as it was.
    device: Device of the data.
    capture: Record stages as graphs and replay them.
  """

  def __init__(self, d: mjw.Data, device: torch.device, *, capture: bool) -> None:
    self._d, self._device, self._capture = d, device, capture
    self._wp_device: Any = wp.device_from_torch(device)
    self._graphs: dict[str, Callable[[], None]] = {}

  def clear(self) -> None:
    """Drop all graphs: the memory that they use was replaced."""
    self._graphs.clear()

  def run(self, name: str, stage: Callable[[], None]) -> None:
    """Replay the graph of a stage, recording it first if need be; inside a larger capture only record its kernels."""
    if not self._capture:
      with self.stream():
        stage()
      return
    if self._device.type == "cuda":
      if torch.cuda.is_current_stream_capturing():
        stage()
        return
      if name not in self._graphs:
        # Kernels compile and load on their first launch, which a capture does not allow.
        with self.stream(), self.preserved():
          stage()
        recorder = Recorder(self._device, generators=())
        recorder.record(stage)
        self._graphs[name] = recorder.replay
    elif name not in self._graphs:
      with wp.ScopedDevice(self._wp_device), wp.ScopedCapture(device=self._wp_device) as capture:
        stage()
      graph: Any = capture.graph
      self._graphs[name] = lambda: wp.capture_launch(graph)
    self._graphs[name]()

  @contextlib.contextmanager
  def stream(self) -> Generator[None, None, None]:
    """Send Warp's launches to torch's current stream, so that the two need no synchronisation."""
    with wp.ScopedDevice(self._wp_device):
      if self._device.type == "cuda":
        stream = wp.stream_from_torch(torch.cuda.current_stream(self._device))
        with wp.ScopedStream(stream, sync_enter=False, sync_exit=False):
          yield
      else:
        yield

  @contextlib.contextmanager
  def preserved(self) -> Generator[None, None, None]:
    """Restore all arrays of the data after launches."""
    saved = []
    for owner in (self._d, self._d.contact, self._d.efc):
      for field in dataclasses.fields(owner):
        array = getattr(owner, field.name)
        if isinstance(array, wp.array) and array.size:
          saved.append((array, wp.clone(array)))
    yield
    for array, before in saved:
      wp.copy(array, before)


def check_capture(device: Any) -> None:
  """Raise MjlabError for a GPU that cannot replay a step as one graph, rather than run it slowly in silence."""
  missing = []
  if device.is_cuda and not wp.is_mempool_enabled(device):
    missing.append("Warp's memory pool is disabled on it")
  if device.is_cuda and not wp.is_conditional_graph_supported():
    missing.append("the driver has no conditional graph nodes (CUDA 12.4 or newer has)")
  if missing:
    raise MjlabError(
      f"{device.name} cannot capture a step: {' and '.join(missing)}. Run without graphs with --env.sim.no-capture."
    )
