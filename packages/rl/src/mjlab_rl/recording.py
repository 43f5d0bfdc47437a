"""Updates recorded as CUDA graphs."""

from collections.abc import Callable

import torch

_WARM_UP = 3


class Recorded:
  """Function that is replayed as one CUDA graph after its first calls, which run eagerly, as torch requires.

  On a CPU all calls run eagerly.

  Args:
    function: Function without arguments and result, on tensors of fixed shapes and addresses.
    device: Device of its tensors.
    is_eager: Never record.
  """

  def __init__(self, function: Callable[[], None], device: torch.device, *, is_eager: bool = False) -> None:
    self._function = function
    # One stream for all calls: autograd's nodes, which may outlive a call, belong to the stream that made them.
    self._stream = None if is_eager or device.type != "cuda" else torch.cuda.Stream(device)
    self.clear()

  def clear(self) -> None:
    """Forget the recording, because tensors have been replaced."""
    self._graph: torch.cuda.CUDAGraph | None = None
    self._eager_calls = 0

  def __call__(self) -> None:
    """Run the function, record it, or replay its graph."""
    if self._stream is None:
      self._function()
    elif self._graph is not None:
      self._graph.replay()
    elif self._eager_calls < _WARM_UP:
      self._eager_calls += 1
      current = torch.cuda.current_stream()
      self._stream.wait_stream(current)
      with torch.cuda.stream(self._stream):
        self._function()
      current.wait_stream(self._stream)
    else:
      self._graph = torch.cuda.CUDAGraph()
      # Other threads, for instance of viewers and NCCL, may use the device meanwhile.
      with torch.cuda.graph(self._graph, stream=self._stream, capture_error_mode="thread_local"):
        self._function()
      self._graph.replay()
