"""Recording torch operations and Warp kernels together as CUDA graphs.

Only imported where Warp is. A recording is a list of graphs with eager calls between them: code that cannot be
captured interrupts the recording, runs by itself on every replay, and the recording goes on behind it.
"""

import gc
from collections.abc import Callable, Sequence

import torch
import warp as wp


class Recorder:
  """Recording of one function, which it replays."""

  def __init__(self, device: torch.device, generators: Sequence[torch.Generator]) -> None:
    self._device = device
    self._generators = generators
    self._stream = torch.cuda.Stream(device)
    self._wp_stream = wp.stream_from_torch(self._stream)
    self._pool = torch.cuda.graph_pool_handle()
    self._segments: list[Callable[[], object]] = []
    self._graph: torch.cuda.CUDAGraph | None = None

  def record(self, fn: Callable[[], object]) -> None:
    """Record `fn` without running it. It must have run on this device before, so that all its kernels are loaded."""
    self._segments.clear()
    torch.cuda.synchronize(self._device)
    # A finaliser that frees device memory inside a capture would become part of it.
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
      with (
        torch.cuda.stream(self._stream),
        wp.ScopedDevice(self._wp_stream.device),
        wp.ScopedStream(self._wp_stream, sync_enter=False, sync_exit=False),
      ):
        try:
          self._begin()
          fn()
        finally:
          self._end()
    finally:
      if enabled:
        gc.enable()
    torch.cuda.synchronize(self._device)

  def interrupt(self, fn: Callable[[], object]) -> None:
    """End the graph being recorded, call `fn` here on every replay, and go on recording behind it."""
    self._end()
    self._segments.append(fn)
    self._begin()

  def replay(self) -> None:
    """Run the recording on torch's current stream."""
    for segment in self._segments:
      segment()

  @property
  def num_graphs(self) -> int:
    return sum(1 for segment in self._segments if hasattr(segment, "__self__"))

  def _begin(self) -> None:
    self._graph = torch.cuda.CUDAGraph()
    for generator in self._generators:
      self._graph.register_generator_state(generator)
    self._graph.capture_begin(pool=self._pool, capture_error_mode="thread_local")
    # Warp must know of torch's capture, or it would synchronise where a solver loop becomes a conditional node.
    wp.capture_begin(stream=self._wp_stream, force_module_load=False, external=True)

  def _end(self) -> None:
    graph = self._graph
    if graph is None:
      return
    self._graph = None
    try:
      wp.capture_end(stream=self._wp_stream)
    finally:
      graph.capture_end()
    self._segments.append(graph.replay)
