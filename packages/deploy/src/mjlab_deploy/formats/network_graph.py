"""Networks of other projects, from observations to actions, with the inputs and outputs of a bundle's graph.

Observations are assembled here, in NumPy, as the description of the bundle says.
"""

from collections import deque
from collections.abc import Mapping

import mujoco
import numpy as np

from mjlab_deploy.description import ACTION, Description, Observation
from mjlab_deploy.errors import DeployError, reading
from mjlab_deploy.formats.network_metadata import GROUP, reading_width
from mjlab_deploy.formats.onnx_graph import OnnxGraph, Shapes

_SIX = (0, 1, 3, 4, 6, 7)
"""Entries of a rotation matrix, row by row, that are its first two columns."""


class NetworkGraph:
  """Network as a graph from readings to joint targets, which keeps its memory itself.

  Args:
    network: The network.
    description: Robot, action scale and observations, in the order of the network's input.

  Raises:
    DeployError: The network has other inputs or outputs, or cannot be run.
  """

  def __init__(self, network: OnnxGraph, description: Description) -> None:
    self._network, self._observations = network, description.observations
    self._default = description.robot.values("default_position")
    self._scale = np.array(description.action_scale)
    if (width := sum(item.shape[0] for item in self._observations)) != network.inputs["obs"][-1]:
      raise DeployError(f"its observation_names give {width} numbers, the network takes {network.inputs['obs'][-1]}")
    names = [name for item in self._observations for name in item.sources if name != "last_action"]
    self.inputs: Shapes = {name: (1, reading_width(name, len(self._default))) for name in names}
    """Shapes of the readings by name."""
    self.outputs = ["target/position", ACTION, f"observation/{GROUP}"]
    """Names of the outputs."""
    self.reset()
    with reading("the network cannot be run", Exception):
      self.run({name: np.zeros(shape) for name, shape in self.inputs.items()})
    self.reset()

  def reset(self) -> None:
    """Begin an episode: forget everything."""
    self._last_action, self._time_step = np.zeros(len(self._default)), 0
    self._states = self._network.zeros(*self._network.states)
    self._past: dict[str, deque[np.ndarray]] = {}

  def run(self, feed: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return all outputs by name."""
    observation = np.concatenate([self._observe(item, feed) for item in self._observations])[None].astype(np.float32)
    given = {"obs": observation, **self._states}
    if "time_step" in self._network.inputs:
      given["time_step"] = np.array([[self._time_step]])
    values = self._network.run(given)
    action = values[self._network.action].astype(np.float32).reshape(1, -1)
    self._states = {name: values[output] for name, output in self._network.states.items()}
    self._last_action, self._time_step = action[0], self._time_step + 1
    target = (self._default + self._scale * action).astype(np.float32)
    return dict(zip(self.outputs, (target, action, observation), strict=True))

  def _observe(self, item: Observation, feed: Mapping[str, np.ndarray]) -> np.ndarray:
    sources = [self._last_action if name == "last_action" else feed[name][0] for name in item.sources]
    frame = self._compute(item.name, sources)
    if item.clip is not None:
      frame = np.clip(frame, *item.clip)
    frame = frame * (1.0 if item.scale is None else np.array(item.scale))
    # At the start of an episode the past is filled with the present.
    count = max(item.history_length, 1)
    past = self._past.setdefault(item.name, deque([frame] * count, maxlen=count))
    past.append(frame)
    return np.concatenate(past)

  def _compute(self, name: str, sources: list[np.ndarray]) -> np.ndarray:
    if name.startswith("joint_pos"):
      return sources[0] - self._default
    if name == "motion_anchor_pos_b":
      return (sources[0] - sources[1]) @ _matrix(sources[2])
    if name == "motion_anchor_ori_b":
      return (_matrix(sources[1]).T @ _matrix(sources[0])).ravel()[list(_SIX)]
    return np.concatenate(sources)


def _matrix(quat: np.ndarray) -> np.ndarray:
  """Return the rotation matrix of a quaternion (w, x, y, z)."""
  matrix = np.empty(9)
  mujoco.mju_quat2Mat(matrix, quat / max(float(np.linalg.norm(quat)), 1e-9))
  return matrix.reshape(3, 3)
