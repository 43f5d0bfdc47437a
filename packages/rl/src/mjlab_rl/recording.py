"""Updates recorded as CUDA graphs."""

from collections.abc import Callable

import torch

_WARM_UP = 3


def record(function: Callable[[], None], stream: torch.cuda.Stream | None = None) -> Callable[[], None]:
  """Return the replay of a CUDA graph of a function without arguments and result.

  Args:
    function: Function on tensors of fixed shapes and addresses. Recording does not run it.
    stream: Stream to record on; None: one of torch's own.
  """
  graph = torch.cuda.CUDAGraph()
  # Other threads, such as those of viewers and of NCCL, may use the device meanwhile.
  with torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local"):
    function()
  return graph.replay


class Recorded:
  """Function that is replayed as one CUDA graph after its first calls, which run eagerly, as torch requires.

  On a CPU all calls do.

  Args:
    function: Function as for `record`.
    device: Device of its tensors.
    is_eager: Never record.
  """

  def __init__(self, function: Callable[[], None], device: torch.device, *, is_eager: bool = False) -> None:
    self._function = function
    self._is_eager = is_eager or device.type != "cuda"
    self.clear()

  def clear(self) -> None:
    """Forget the recording, because tensors have been replaced."""
    self._replay: Callable[[], None] | None = None
    self._eager_calls = 0

  def __call__(self) -> None:
    if self._is_eager:
      self._function()
      return
    if self._replay is None:
      stream = torch.cuda.Stream()
      if self._eager_calls < _WARM_UP:
        self._eager_calls += 1
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
          self._function()
        torch.cuda.current_stream().wait_stream(stream)
        return
      self._replay = record(self._function, stream)
    self._replay()
