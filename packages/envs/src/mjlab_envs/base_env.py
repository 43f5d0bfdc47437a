"""Base of the manager-based environment: its parts, with their state, logs and spaces."""

import contextlib
import logging
import math
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import torch
from mjlab_core import Limits, Stateful, StatefulDict, check_value
from mjlab_core.state import refuse_state
from mjlab_managers import (
  ActionManager,
  CommandManager,
  CurriculumManager,
  EventManager,
  ManagerBase,
  MetricsManager,
  ObservationManager,
  RecorderManager,
  RewardManager,
  TerminationManager,
)
from mjlab_scene import Scene
from mjlab_sim import NanGuard, Simulation, StepGraph

from mjlab_envs.compiled_terms import CompiledTerms

Observations = dict[str, torch.Tensor | dict[str, torch.Tensor]]
"""Observations by group: a tensor, or the tensors of its terms by name."""

MANAGERS: dict[str, tuple[str, type[ManagerBase[Any]]]] = {
  "events": ("event_manager", EventManager),
  "commands": ("command_manager", CommandManager),
  "actions": ("action_manager", ActionManager),
  "terminations": ("termination_manager", TerminationManager),
  "metrics": ("metrics_manager", MetricsManager),
  "rewards": ("reward_manager", RewardManager),
  "observations": ("observation_manager", ObservationManager),
  "curriculum": ("curriculum_manager", CurriculumManager),
  "recorders": ("recorder_manager", RecorderManager),
}
"""Attribute and type of the manager of each part of a config, in the order in which they are built."""

_log = logging.getLogger("mjlab")


class EnvState(StatefulDict[Stateful]):
  """Counters of an environment, and the state of its scene and managers by name."""

  def __init__(self, num_envs: int, device: torch.device) -> None:
    super().__init__()
    self.num_envs, self.device = num_envs, device
    self.episode_length = self.state(dtype=torch.int64)
    self.pending = self.state(dtype=torch.bool)
    """Worlds that ended and wait for a reset, bool (num_envs,)."""
    self.step_counter = self.state(dtype=torch.int64, shared=True)


class ManagerBasedEnv:
  """Base of `ManagerBasedRlEnv`: parts of the environment as terms and checkpoints use them."""

  seed: int
  scene: Scene
  sim: Simulation
  device: torch.device
  num_envs: int
  rng: torch.Generator
  """Source of randomness of all terms."""
  physics_dt: float
  """Duration of a physics step [s]."""
  step_dt: float
  """Duration of an environment step [s]."""
  max_episode_length: int
  """Length of an episode in steps."""
  max_episode_length_s: float
  """Length of an episode [s]."""
  episode_length_buf: torch.Tensor
  """Steps since the last reset, int64 (num_envs,)."""
  common_step_counter: torch.Tensor
  """Steps since the environment was built, int64 ()."""
  reset_buf: torch.Tensor
  """Worlds that are reset within the present step, bool (num_envs,)."""
  event_manager: EventManager
  command_manager: CommandManager
  action_manager: ActionManager
  termination_manager: TerminationManager
  metrics_manager: MetricsManager
  reward_manager: RewardManager
  observation_manager: ObservationManager
  curriculum_manager: CurriculumManager
  recorder_manager: RecorderManager
  managers: dict[str, ManagerBase[Any]]
  """All managers by the name of their part of the config."""
  nan_guard: NanGuard | None
  """Record of the last states of every world; None where it is off, or without a termination for divergence."""
  output_dir: Path | None = None
  """Folder of a training run, which sets it. Dumps of diverged worlds go to its subfolder `nan_dumps`."""

  _step_graph: StepGraph
  _state: EnvState
  _announced: set[str]
  _compiled: tuple[CompiledTerms, ...] = ()

  def run_eagerly(self, fn: Callable[[], None], name: str) -> None:
    """Run a function that cannot be recorded; split the step graph around it. Warn once for each name."""
    if self.sim.is_capturing and name not in self._announced:
      self._announced.add(name)
      _log.warning("%s cannot be recorded: the step graph is split around it and it runs eagerly.", name)
    self.sim.graph_break(fn)

  def request_recapture(self, reason: str) -> None:
    """Record the step again before the next one, because its operations have changed."""
    if self.num_graphs > 0:
      _log.info("recording the step again: %s", reason)
    self._step_graph.invalidate()
    for evaluation in self._compiled:
      evaluation.clear()

  def recompute_constants(self, mask: torch.Tensor) -> None:
    """Recompute the model's derived fields of masked worlds."""
    self.sim.recompute_constants(mask)

  @property
  def is_captured(self) -> bool:
    """True if steps are replays of a recording."""
    return self._step_graph.recorded

  @property
  def num_graphs(self) -> int:
    """Number of graphs of a recorded step: 1, unless a part of it cannot be recorded."""
    return self._step_graph.num_graphs

  def drain_log(self) -> dict[str, float]:
    """Return averages over the episodes that ended since the last call, by name; one transfer from the device.

    The logger "mjlab" warns of buffers that overflowed, with the setting to raise, and of worlds that diverged, with
    the place where each divergence began.
    """
    logs = [manager.log_tensors() for manager in self.managers.values()]
    names = [name for of_manager, _ in logs for name in of_manager]
    numbers = torch.cat([values for _, values in logs]).tolist()
    for manager in self.managers.values():
      manager.clear_log()
    self._warn(self.sim.overflow_report())
    self._warn_of_divergence()
    log = {name: number for name, number in zip(names, numbers, strict=True) if not math.isnan(number)}
    self._warn(self.observation_manager.nan_warnings(log))
    return log

  def _warn_of_divergence(self) -> None:
    if self.nan_guard is not None:
      self._warn(self.nan_guard.report(self.output_dir))

  def _warn(self, lines: list[str]) -> None:
    for line in lines:
      _log.warning("%s", line)

  def get_observations(self) -> Observations:
    """Return the present observations by group, as fresh tensors. Repeated calls change nothing."""
    return cloned(self.observation_manager.buffers)

  def state_dict(self) -> dict[str, Any]:
    """Return the state that the next step depends on, as fresh tensors."""
    return {**self._state.state_dict(), "rng": self.rng.get_state(), "sim": self.sim.state_dict()}

  def load_state_dict(self, state: dict[str, Any]) -> None:
    """Restore a `state_dict` of an environment with the same config.

    Raises:
      MjlabError: the state belongs to another task, number of worlds or kind of device; nothing was changed.
    """
    own = {name: part for name, part in state.items() if name not in ("rng", "sim")}
    problems = list(self._state.state_problems(own, "env"))
    if state["rng"].shape != self.rng.get_state().shape:
      problems.append(f"rng: saved on another kind of device, here it is {self.device}.")
    refuse_state(iter(problems))
    self.sim.load_state_dict(state["sim"])
    self._state.restore(own)
    self.rng.set_state(state["rng"].cpu())

  def load_progress(self, state: dict[str, Any]) -> None:
    """Restore the progress of training from a `state_dict`, also of another number of worlds.

    The generator gets a seed from the step counter, so that the noise of the beginning does not repeat.
    """
    self.common_step_counter.copy_(state["step_counter"])
    self.sim.keep_buffer_sizes(state["sim"])
    self.rng.manual_seed(self.seed + int(self.common_step_counter))
    self.command_manager.load_progress(state["commands"])

  def describe(self) -> str:
    """Return tables of the environment's parts."""
    head = (
      f"{self.num_envs} worlds on {self.device} ({self.sim.engine} engine), physics {self.physics_dt:g} s,"
      f" step {self.step_dt:g} s, episode {self.max_episode_length} steps, seed {self.seed}"
    )
    return "\n".join([head, *(text for manager in self.managers.values() if (text := manager.describe()))])

  @property
  def single_observation_space(self) -> Any:
    """Observation space of one world, a Gymnasium Dict of unbounded boxes by group."""
    return _space(self.observation_manager.buffers, single=True)

  @property
  def single_action_space(self) -> Any:
    """Action space of one world, an unbounded Gymnasium box."""
    return _space(self.action_manager.action, single=True)

  @property
  def observation_space(self) -> Any:
    """Observation space of all worlds."""
    return _space(self.observation_manager.buffers)

  @property
  def action_space(self) -> Any:
    """Action space of all worlds."""
    return _space(self.action_manager.action)

  @contextlib.contextmanager
  def _one_torch_thread(self) -> Generator[None, None, None]:
    """Limit torch to one thread on a CPU: more threads take cores from physics, four times slower with 64 worlds."""
    before = torch.get_num_threads()
    if self.device.type == "cuda" or before == 1:
      yield
      return
    torch.set_num_threads(1)
    try:
      yield
    finally:
      torch.set_num_threads(before)


def cloned(observations: Observations) -> Observations:
  """Return a copy of observations as fresh tensors."""
  return {
    group: value.clone() if isinstance(value, torch.Tensor) else {name: term.clone() for name, term in value.items()}
    for group, value in observations.items()
  }


def _space(values: torch.Tensor | Mapping[str, Any], *, single: bool = False) -> Any:
  """Return the Gymnasium space of values of all worlds, or of a single one: an unbounded box, or a Dict by name."""
  # Gymnasium takes a third of a second to import.
  from gymnasium import spaces

  if isinstance(values, torch.Tensor):
    return spaces.Box(-math.inf, math.inf, tuple(values.shape[1:] if single else values.shape))
  return spaces.Dict({name: _space(value, single=single) for name, value in values.items()})


def select_worlds(env_ids: torch.Tensor | Sequence[int] | None, num_envs: int, device: torch.device) -> torch.Tensor:
  """Return a bool mask (num_envs,) from a mask, from world numbers, or of all worlds (None).

  Raises:
    ConfigError: the mask has another length, a number is out of range, or `env_ids` is neither.
  """
  if env_ids is None:
    return torch.ones(num_envs, dtype=torch.bool, device=device)
  chosen = torch.as_tensor(env_ids, device=device)
  if chosen.dtype == torch.bool and chosen.shape == (num_envs,):
    return chosen.clone()
  check_value("env_ids", chosen.tolist(), Annotated[tuple[int, ...], Limits(ge=0, le=num_envs - 1)])
  mask = torch.zeros(num_envs, dtype=torch.bool, device=device)
  mask[chosen.long()] = True
  return mask
