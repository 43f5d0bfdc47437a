"""ONNX graphs, run by ONNX Runtime."""

from collections.abc import Mapping

import numpy as np
import onnxruntime

from mjlab_deploy.errors import reading

Shapes = dict[str, tuple[int, ...]]
_DTYPES = {
  "tensor(float)": np.float32,
  "tensor(double)": np.float64,
  "tensor(int32)": np.int32,
  "tensor(int64)": np.int64,
}


class OnnxGraph:
  """Graph of a bundle, or network of another project, in one file. It runs on one CPU thread.

  Args:
    data: Content of the file.

  Raises:
    DeployError: The graph is damaged.
  """

  def __init__(self, data: bytes) -> None:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    with reading("policy.onnx: not a graph that ONNX Runtime takes", Exception):
      self._session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
      inputs = self._session.get_inputs()
      self._dtypes = {item.name: _DTYPES[item.type] for item in inputs}
    self.inputs: Shapes = {item.name: tuple(n if isinstance(n, int) else 0 for n in item.shape) for item in inputs}
    """Shapes of the inputs by name; 0 for a size that is not fixed."""
    self.outputs = [item.name for item in self._session.get_outputs()]
    """Names of the outputs."""
    self.metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map
    """Metadata of the file."""
    self.states = {
      name: f"{name[:-3]}_out" for name in self.inputs if name.endswith("_in") and f"{name[:-3]}_out" in self.outputs
    }
    """Outputs "NAME_out" with the next recurrent states by input, "NAME_in"."""

  @property
  def action(self) -> str:
    """Output with the action: "actions", or the first that is not a state."""
    # Trainers agree on "obs", not on the output: rsl-rl writes "actions", MuJoCo Playground "continuous_actions".
    others = [name for name in self.outputs if name not in self.states.values()]
    return "actions" if "actions" in others else others[0]

  def zeros(self, *names: str) -> dict[str, np.ndarray]:
    """Return zeros for inputs, of size 1 along axes whose size is not fixed."""
    return {name: np.zeros([max(n, 1) for n in self.inputs[name]], self._dtypes[name]) for name in names}

  def run(self, feed: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return all outputs by name."""
    given = {name: np.asarray(value, self._dtypes.get(name)) for name, value in feed.items()}
    return dict(zip(self.outputs, map(np.asarray, self._session.run(None, given)), strict=True))
