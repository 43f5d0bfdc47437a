"""Networks of others, from observations to actions, behind the inputs and outputs of a bundle's graph.

Observations are assembled here, in NumPy, as the description of the bundle says.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from mjlab_deploy.description import Joint, Observation
from mjlab_deploy.errors import DeployError, reading
from mjlab_deploy.network_metadata import GROUP, reading_width
from mjlab_deploy.onnx_graph import OnnxGraph, Shapes

_SIX = (0, 1, 3, 4, 6, 7)
"""Entries of a rotation matrix, row by row, that are its first two columns."""


class NetworkGraph:
  """A network as a graph from readings to joint targets.

  Args:
    network: The network.
    joints: Joints of the robot.
    action_scale: Shift of the target per unit of action for each joint.
    observations: Observations in the order of the network's input.

  Raises:
    DeployError: The network has other inputs or outputs, or cannot be run.
  """

  def __init__(
    self,
    network: OnnxGraph,
    joints: Sequence[Joint],
    action_scale: Sequence[float],
    observations: Sequence[Observation],
  ) -> None:
    self._network, self._observations = network, observations
    self._default, self._scale = np.array([joint.default_position for joint in joints]), np.array(action_scale)
    if (width := sum(item.shape[0] for item in observations)) != network.inputs["obs"][-1]:
      raise DeployError(f"its observation_names give {width} numbers, the network takes {network.inputs['obs'][-1]}")
    count = len(joints)
    self.readings: Shapes = {
      name: (reading_width(name, count),) for item in observations for name in item.sources if name != "last_action"
    }
    """Shapes of the readings by name."""
    self.memories: Shapes = {"memory/last_action": (1, count), "memory/time_step": (1, 1)}
    """Shapes of the memories by name."""
    for item in observations:
      if item.history_length > 1:
        self.memories[_history(item)] = (1, item.history_length, item.shape[0] // item.history_length)
    self.memories |= {f"memory/{name}": value.shape for name, value in network.zeros(*network.states).items()}
    with reading("the network cannot be run", Exception):
      self.run({name: np.zeros(shape, np.float32) for name, shape in self.inputs.items()})

  @property
  def inputs(self) -> Shapes:
    """Shapes of the inputs by name."""
    readings = {name: (1, *shape) for name, shape in self.readings.items()}
    return readings | self.memories | {"episode_start": (1, 1)}

  @property
  def outputs(self) -> list[str]:
    """Names of the outputs."""
    return ["target/position", "action", f"observation/{GROUP}", *(f"{name}/next" for name in self.memories)]

  def run(self, feed: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return all outputs by name."""
    following: dict[str, np.ndarray] = {}
    parts = [self._observe(item, feed, following) for item in self._observations]
    observation = np.concatenate(parts, axis=1).astype(np.float32)
    given = {"obs": observation} | {name: feed[f"memory/{name}"] for name in self._network.states}
    if "time_step" in self._network.inputs:
      given["time_step"] = feed["memory/time_step"]
    values = self._network.run(given)
    action = values[self._network.action].astype(np.float32).reshape(1, -1)
    following |= {f"memory/{name}": values[output] for name, output in self._network.states.items()}
    following |= {"memory/last_action": action, "memory/time_step": feed["memory/time_step"] + np.float32(1.0)}
    target = (self._default + self._scale * action).astype(np.float32)
    found = {"target/position": target, "action": action, f"observation/{GROUP}": observation}
    return found | {f"{name}/next": value for name, value in following.items()}

  def _observe(self, item: Observation, feed: Mapping[str, np.ndarray], following: dict[str, np.ndarray]) -> np.ndarray:
    sources = [feed[f"memory/{name}" if name == "last_action" else name][0] for name in item.sources]
    frame = self._compute(item.name, sources)
    if item.clip is not None:
      frame = np.clip(frame, *item.clip)
    frame = frame[None] * (1.0 if item.scale is None else np.array(item.scale))
    if item.history_length < 2:
      return frame
    past = np.concatenate((feed[_history(item)][0, 1:], frame))
    if feed["episode_start"][0, 0]:
      past = np.repeat(frame, item.history_length, axis=0)
    following[_history(item)] = past[None].astype(np.float32)
    return past.reshape(1, -1)

  def _compute(self, name: str, sources: list[np.ndarray]) -> np.ndarray:
    if name.startswith("joint_pos"):
      return sources[0] - self._default
    if name == "motion_anchor_pos_b":
      return (sources[0] - sources[1]) @ _matrix(sources[2])
    if name == "motion_anchor_ori_b":
      return (_matrix(sources[1]).T @ _matrix(sources[0])).ravel()[list(_SIX)]
    return np.concatenate(sources)


def _history(item: Observation) -> str:
  """Return the name of the memory of an observation."""
  return f"memory/history/{GROUP}/{item.name}"


def _matrix(quat: np.ndarray) -> np.ndarray:
  """Return the rotation matrix of a quaternion (w, x, y, z)."""
  matrix = np.empty(9)
  mujoco.mju_quat2Mat(matrix, quat / max(float(np.linalg.norm(quat)), 1e-9))
  return matrix.reshape(3, 3)
