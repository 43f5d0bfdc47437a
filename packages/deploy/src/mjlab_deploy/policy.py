"""Policy of a bundle, step by step."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mjlab_deploy.bundle import Bundle
from mjlab_deploy.description import ACTION, EPISODE_START, LAST_ACTION
from mjlab_deploy.errors import DeployError, check_known, reading
from mjlab_deploy.formats.network_graph import NetworkGraph
from mjlab_deploy.formats.onnx_graph import OnnxGraph


@dataclass(frozen=True)
class Step:
  """Result of one step of the policy."""

  targets: dict[str, np.ndarray]
  """Targets by the name of their output, (joints,) each."""
  action: np.ndarray
  """Raw action, (actions,)."""
  observations: dict[str, np.ndarray]
  """Observation of each group, as the network saw it."""


class Policy:
  """Policy that turns readings into targets, and keeps its memory.

  Args:
    bundle: The bundle.

  Raises:
    DeployError: The graph is damaged, or is not the one that `bundle.json` describes.
  """

  def __init__(self, bundle: Bundle) -> None:
    self.description = bundle.description
    graph: OnnxGraph | NetworkGraph = OnnxGraph(bundle.read_bytes("policy.onnx"))
    if "obs" in graph.inputs:
      # A network of another project takes observations instead of readings.
      with reading("policy.onnx", LookupError, ValueError):
        graph = NetworkGraph(graph, self.description)
    self._graph, given = graph, graph.inputs
    wanted: dict[str, tuple[int, ...]] = {item.name: (1, *item.shape) for item in self.description.inputs}
    wanted |= {item.input: item.shape for item in self.description.memories}
    self._has_start = EPISODE_START in given
    if self._has_start:
      wanted[EPISODE_START] = (1, 1)
    for name in sorted({*given, *wanted}):
      if given.get(name) != wanted.get(name):
        raise DeployError(
          f"policy.onnx: input {name[:60]!r} is {given.get(name, 'missing')}, bundle.json says {wanted.get(name)}"
        )
    memories, targets = self.description.memories, self.description.targets
    for name in (ACTION, *(item.output for item in memories), *(item.name for item in targets)):
      check_known("policy.onnx: output", name, graph.outputs)
    self.reset()

  def reset(self) -> None:
    """Begin an episode: forget everything."""
    self._memory = {item.input: np.zeros(item.shape, np.float32) for item in self.description.memories}
    self._is_first = True
    if isinstance(self._graph, NetworkGraph):
      self._graph.reset()

  def replace_last_action(self, action: np.ndarray) -> None:
    """Take another action, (actions,), as the last one, if the policy remembers one."""
    if LAST_ACTION in self._memory:
      self._memory[LAST_ACTION] = np.asarray(action, np.float32).reshape(1, -1)

  def step(self, readings: Mapping[str, np.ndarray]) -> Step:
    """Return the targets for the present readings, by the names of the inputs.

    Raises:
      DeployError: A reading is missing or has another size.
    """
    feed = dict(self._memory)
    for item in self.description.inputs:
      value = np.asarray(readings.get(item.name, ()), np.float32)
      if value.size != np.prod(item.shape, dtype=int):
        found = f"has {value.size} numbers" if item.name in readings else "is missing"
        raise DeployError(f"reading '{item.name}' {found}; the policy takes {item.shape}")
      feed[item.name] = value.reshape(1, *item.shape)
    if self._has_start:
      feed[EPISODE_START] = np.full((1, 1), float(self._is_first), np.float32)
    values = self._graph.run(feed)
    self._memory = {item.input: values[item.output] for item in self.description.memories}
    self._is_first = False
    prefix = "observation/"
    return Step(
      targets={item.name: values[item.name][0] for item in self.description.targets},
      action=values[ACTION][0],
      observations={name.removeprefix(prefix): value[0] for name, value in values.items() if name.startswith(prefix)},
    )
