"""The graph of a policy from readings to joint targets, as a torch module and as ONNX."""

import contextlib
import io
import logging
import warnings
from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from mjlab_core.errors import MjlabError
from mjlab_deploy import Observation
from mjlab_deploy.description import ACTION, EPISODE_START, LAST_ACTION
from torch import nn

from mjlab_rl.config import RslRlBaseRunnerCfg

Tensors = Mapping[str, torch.Tensor]


@dataclass(frozen=True)
class GraphTerm:
  """Observation term of a graph."""

  described: Observation
  compute: Callable[..., torch.Tensor] | None
  """Function of its sources; None returns the only one."""

  @property
  def memory(self) -> str:
    """Name of the memory of its history."""
    return f"memory/history/{self.described.group}/{self.described.name}"

  def observe(self, given: Tensors, following: dict[str, torch.Tensor]) -> torch.Tensor:
    """Return the observation for inputs by name, and put its history into `following`."""
    described = self.described
    inputs = [given[name if name in given else f"memory/{name}"] for name in described.sources]
    frame = (inputs[0] if self.compute is None else self.compute(*inputs)).float()
    if described.clip is not None:
      frame = frame.clamp(*described.clip)
    if described.scale is not None:
      scale = torch.as_tensor(described.scale, dtype=torch.float32)
      frame = frame * (scale if scale.dim() == 0 else scale.view(frame.shape))
    if described.history_length > 1:
      newest = frame[:, None]
      past = _last(given, self.memory, newest)
      frame = following[self.memory] = torch.cat((past[:, 1:], newest), 1)
    return frame.reshape(1, *described.shape)


@dataclass(frozen=True)
class GraphAction:
  """Action term of a graph."""

  name: str
  term: Any
  columns: slice
  """Columns in the raw action."""
  targets: Any
  """Its `ActionTargets`."""

  @property
  def memory(self) -> str:
    """Name of the memory of its last targets."""
    return f"memory/target/{self.name}"

  def act(self, action: torch.Tensor, given: Tensors, following: dict[str, torch.Tensor]) -> torch.Tensor:
    """Return the targets for a raw action and inputs by name, and put them into `following` if they are remembered."""
    mine, readings = action[:, self.columns], [given[reading.name] for reading in self.targets.readings]
    if self.targets.start is None:
      return self.targets.compute(mine, *readings)
    target = self.targets.compute(mine, _last(given, self.memory, self.targets.start(*readings)), *readings)
    following[self.memory] = target + 0.0
    return target


def _last(given: Tensors, memory: str, first: torch.Tensor) -> torch.Tensor:
  """Return a memory; at the start of an episode it is filled with `first`."""
  start = given[EPISODE_START].view(1, *[1] * (first.dim() - 1))
  return start * first + (1.0 - start) * given[memory]


def readings_of(env: Any, groups: Iterable[str]) -> dict[str, Any]:
  """Return the readings of observation groups and of all actions by name.

  Raises:
    MjlabError: A term has no source, or two readings of one name differ.
  """
  owners = {}
  for group in groups:
    for layout in env.observation_manager.layout(group):
      owners[f"observation '{group}/{layout.name}'"] = env.observation_manager.source(group, layout.name)
  for name in env.action_manager.term_slices():
    owners[f"action '{name}'"] = env.action_manager.get_term(name).exported()
  found: dict[str, Any] = {}
  for owner, source in owners.items():
    for reading in source.readings if source is not None else ():
      known = found.setdefault(reading.name, reading)
      if (known.frame, known.columns, known.origin) != (reading.frame, reading.columns, reading.origin):
        raise MjlabError(
          f"{owner}: reading '{reading.name}' is declared twice, with different frames, origins or columns"
        )
  return found


class PolicyGraph(nn.Module):
  """Observations, network and actions of an environment in one module, for one world.

  The graph has no noise and no delays; the robot has them. NaN is not replaced, because a runner stops on it.

  Args:
    env: Environment with an observation and an action manager.
    agent: Configuration of the learner.
    network: The policy's network, a model of rsl-rl.

  Raises:
    MjlabError: A term has no source, an action has no computation outside the simulation, or two readings of one name
      differ.
  """

  def __init__(self, env: Any, agent: RslRlBaseRunnerCfg, network: Any) -> None:
    super().__init__()
    with _quiet():
      self.network: Any = network.as_onnx(verbose=False).to("cpu").eval()
    self.groups = list(agent.obs_groups[agent.policy])
    self._clip = agent.clip_actions
    self.readings = readings_of(env, self.groups)
    """Readings by name, without the last action."""
    self.memories: dict[str, tuple[int, ...]] = {}
    """Shape of each memory by the name of its input."""
    self.terms = [
      self._term(env, group, layout) for group in self.groups for layout in env.observation_manager.layout(group)
    ]
    """Observation terms in the order of the network's input."""
    if self.readings.pop("last_action", None) is not None:
      self.memories[LAST_ACTION] = (1, env.action_manager.total_action_dim)
    self.actions = [self._action(env, name, columns) for name, columns in env.action_manager.term_slices().items()]
    """Action terms in the order of the raw action."""
    self.targets: dict[str, list[GraphAction]] = {}
    """Action terms by the name of the output with their joint targets, "target/QUANTITY"."""
    for action in self.actions:
      self.targets.setdefault(f"target/{action.targets.quantity}", []).append(action)
    self._states: dict[str, str] = {}
    for name, value in zip(self.network.input_names, self.network.get_dummy_inputs(), strict=True):
      if name not in ("obs", *self.groups):
        self._states[name] = f"memory/{name.removesuffix('_in')}"
        self.memories[self._states[name]] = tuple(value.shape)
    self.input_names = [*self.readings, *self.start()]
    """Names of the inputs in their order."""

  def _term(self, env: Any, group: str, layout: Any) -> GraphTerm:
    manager = env.observation_manager
    source, cfg = manager.source(group, layout.name), manager.get_term_cfg(group, layout.name)
    described = Observation(
      group=group,
      name=layout.name,
      columns=(layout.columns.start, layout.columns.stop) if len(layout.shape) == 1 else (0, 0),
      shape=tuple(layout.shape),
      sources=tuple(reading.name for reading in source.readings),
      scale=layout.scale,
      clip=layout.clip,
      history_length=layout.history_length,
      delay_range=(cfg.delay_min_lag, cfg.delay_max_lag),
    )
    term = GraphTerm(described, source.compute)
    if layout.history_length > 1:
      self.memories[term.memory] = (1, layout.history_length, *layout.frame_shape)
    return term

  def _action(self, env: Any, name: str, columns: slice) -> GraphAction:
    term = env.action_manager.get_term(name)
    if (targets := term.exported()) is None:
      what = f"action '{name}' ({type(term).__name__}) has no computation outside the simulation"
      raise MjlabError(f"{what}, so the policy cannot be exported; use an action that sets joint targets")
    action = GraphAction(name, term, columns, targets)
    if targets.start is not None:
      self.memories[action.memory] = (1, len(targets.joints))
    return action

  @property
  def output_names(self) -> list[str]:
    """Names of the outputs in their order."""
    observations = [f"observation/{group}" for group in self.groups]
    return [*self.targets, ACTION, *observations, *(f"{name}/next" for name in self.memories)]

  def read(self) -> dict[str, torch.Tensor]:
    """Return the present readings of the first world."""
    return {name: reading.read()[:1].detach().cpu().float() for name, reading in self.readings.items()}

  def start(self) -> dict[str, torch.Tensor]:
    """Return the memories of the first step of an episode, and the input that marks it if it is needed."""
    zeros = {name: torch.zeros(shape) for name, shape in self.memories.items()}
    is_marked = any(name.startswith(("memory/history/", "memory/target/")) for name in zeros)
    return zeros | ({EPISODE_START: torch.ones(1, 1)} if is_marked else {})

  def named(self, given: Tensors) -> dict[str, torch.Tensor]:
    """Return the outputs by name for inputs by name."""
    return dict(zip(self.output_names, self(*(given[name] for name in self.input_names)), strict=True))

  def forward(self, *values: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Return the outputs in the order of `output_names`."""
    given = dict(zip(self.input_names, values, strict=True))
    following: dict[str, torch.Tensor] = {}
    seen: dict[str, list[torch.Tensor]] = {group: [] for group in self.groups}
    for term in self.terms:
      seen[term.described.group].append(term.observe(given, following))
    observations = {group: torch.cat(parts, 1) for group, parts in seen.items()}
    # Images are separate inputs of the network.
    inputs: list[str] = list(self.network.input_names)
    vectors = [observations[group] for group in self.groups if group not in inputs or group == "obs"]
    feed = observations | ({"obs": torch.cat(vectors, 1)} if vectors else {})
    feed |= {name: given[memory] for name, memory in self._states.items()}
    result = self.network(*(feed[name] for name in inputs))
    outputs = dict(zip(self.network.output_names, result if isinstance(result, tuple) else (result,), strict=False))
    action = outputs["actions"]
    if self._clip is not None:
      action = action.clamp(-self._clip, self._clip)
    for name, memory in self._states.items():
      following[memory] = outputs[name.replace("_in", "_out")]
    # Copies, because one tensor cannot have two names.
    following[LAST_ACTION] = action + 0.0
    targets = [torch.cat([part.act(action, given, following) for part in parts], 1) for parts in self.targets.values()]
    shown = [observations[group] + 0.0 for group in self.groups]
    return (*targets, action, *shown, *(following[name] for name in self.memories))


def export_onnx(
  module: nn.Module, example: tuple[torch.Tensor, ...], input_names: list[str], output_names: list[str]
) -> Any:
  """Return a module as an ONNX model whose constants keep the names of its parameters."""
  with _quiet():
    program = torch.onnx.export(
      module,
      example,
      None,
      input_names=input_names,
      output_names=output_names,
      opset_version=18,
      dynamo=True,
      optimize=False,
      verbose=False,
    )
  assert program is not None
  model = program.model_proto
  for value in (*model.graph.node, *model.graph.value_info, *model.graph.initializer):
    # Stack traces and doc strings hold paths of this machine.
    del value.metadata_props[:]
    value.doc_string = ""
  return model


def refresh_weights(model: Any, network: Mapping[str, torch.Tensor]) -> bool:
  """Write a network's present parameters into an exported model; return False if the model lacks one of them.

  The variance of a normaliser is not needed: the network uses its root, a separate parameter.
  """
  from onnx import numpy_helper

  constants = {constant.name: constant for constant in model.graph.initializer}
  values = {
    f"network.{name}": value
    for name, value in network.items()
    if value.is_floating_point() and not name.endswith("normalizer._var")
  }
  if not values.keys() <= constants.keys():
    return False
  for name, value in values.items():
    array = value.detach().cpu().numpy()
    if list(array.shape) != list(constants[name].dims):
      return False
    constants[name].CopyFrom(numpy_helper.from_array(np.ascontiguousarray(array), name))
  return True


@contextlib.contextmanager
def _quiet() -> Generator[None]:
  """Silence the exporter, which prints, warns and logs."""
  before = logging.root.manager.disable
  logging.disable(logging.WARNING)
  try:
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
      warnings.simplefilter("ignore")
      yield
  finally:
    logging.disable(before)
