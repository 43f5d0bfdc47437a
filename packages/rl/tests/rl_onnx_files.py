"""Small ONNX policies with chosen inputs, outputs and metadata."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

FLOAT = TensorProto.FLOAT


def linear_policy(
  path: Path,
  weights: Any,
  *,
  metadata: dict[str, str] | None = None,
  time_step: bool = False,
  memory: bool = False,
  batch: Any = 1,
  obs: str = "obs",
  other: str | None = None,
) -> Path:
  """Write actions = obs @ weights.

  Args:
    path: File to write.
    weights: (observations, actions).
    metadata: Metadata of the file.
    time_step: Add the input "time_step" and the motion frame at that step as an output, as mjlab 1.x does.
    memory: Add a state that counts calls and is added to the actions.
    batch: Size of the first axis, or its name.
    obs: Name of the first input.
    other: Name of one more input, which has no meaning.
  """
  weights = np.asarray(weights, np.float32)
  width, count = weights.shape
  inputs = [helper.make_tensor_value_info(obs, FLOAT, [batch, width])]
  outputs = [helper.make_tensor_value_info("actions", FLOAT, [batch, count])]
  nodes = [helper.make_node("MatMul", [obs, "weights"], ["linear" if memory else "actions"])]
  constants: dict[str, Any] = {"weights": weights}
  if time_step:
    # In front, as a reader by position would take it for the observations.
    inputs.insert(0, helper.make_tensor_value_info("time_step", FLOAT, [1, 1]))
    outputs.insert(0, helper.make_tensor_value_info("joint_pos", FLOAT, [1, 3]))
    constants |= {"motion": np.arange(30, dtype=np.float32).reshape(10, 3), "flat": np.array([-1], np.int64)}
    nodes += [
      helper.make_node("Cast", ["time_step"], ["whole"], to=TensorProto.INT64),
      helper.make_node("Reshape", ["whole", "flat"], ["frame"]),
      helper.make_node("Gather", ["motion", "frame"], ["joint_pos"]),
    ]
  if memory:
    inputs.append(helper.make_tensor_value_info("h_in", FLOAT, [1, batch, count]))
    outputs.append(helper.make_tensor_value_info("h_out", FLOAT, [1, batch, count]))
    constants |= {"one": np.ones((1, 1, count), np.float32), "axis": np.array([0], np.int64)}
    nodes += [
      helper.make_node("Add", ["h_in", "one"], ["h_out"]),
      helper.make_node("Squeeze", ["h_out", "axis"], ["counted"]),
      helper.make_node("Add", ["linear", "counted"], ["actions"]),
    ]
  if other is not None:
    inputs.append(helper.make_tensor_value_info(other, FLOAT, [1, 2]))
    nodes.append(helper.make_node("Identity", [other], [f"{other}_copy"]))
  initializers = [numpy_helper.from_array(value, name) for name, value in constants.items()]
  graph = helper.make_graph(nodes, "policy", inputs, outputs, initializers)
  model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
  helper.set_model_props(model, metadata or {})
  onnx.save(model, path)
  return path
