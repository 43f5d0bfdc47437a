"""Function without arguments that a GPU records once and then replays."""

from collections.abc import Callable

import torch

_WARM_UP = 3


class Recorded:
  """Function on tensors of fixed shapes and addresses, replayed as one CUDA graph.

  The first calls run eagerly, as torch requires before a recording. On a CPU all calls do.

  Args:
    function: Function without arguments and result.
    device: Device of its tensors.
    is_eager: Never record.
  """

  def __init__(self, function: Callable[[], None], device: torch.device, *, is_eager: bool = False) -> None:
    self._function = function
    self._is_eager = is_eager or device.type != "cuda"
    self.clear()

  def clear(self) -> None:
    """Forget the recording, because tensors have been replaced."""
    self._graph: torch.cuda.CUDAGraph | None = None
    self._eager_calls = 0

  def __call__(self) -> None:
    if self._is_eager:
      self._function()
      return
    if self._graph is None:
      stream = torch.cuda.Stream()
      if self._eager_calls < _WARM_UP:
        self._eager_calls += 1
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
          self._function()
        torch.cuda.current_stream().wait_stream(stream)
        return
      graph = torch.cuda.CUDAGraph()
      # Other threads, such as those of viewers, may use the device meanwhile.
      with torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local"):
        self._function()
      self._graph = graph
    self._graph.replay()
