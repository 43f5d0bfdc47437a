"""The manager-based environment and its step."""

import contextlib
import copy
import logging
import math
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from mjlab_core import DebugDraw
from mjlab_core.seeding import draw_seed, make_generator
from mjlab_core.state import StateError, Stateful
from mjlab_managers import (
  ActionManager,
  CommandManager,
  ConfigError,
  CurriculumManager,
  EventManager,
  ManagerBase,
  MetricsManager,
  ObservationManager,
  RecorderManager,
  RewardManager,
  TerminationManager,
  TerminationTermCfg,
)
from mjlab_scene import Scene
from mjlab_sim import NanGuard, Simulation

from mjlab_envs import viewing
from mjlab_envs.env_cfg import ManagerBasedRlEnvCfg
from mjlab_envs.mdp.terminations import nan_detection
from mjlab_envs.worlds import select_worlds

Observations = dict[str, torch.Tensor | dict[str, torch.Tensor]]

_log = logging.getLogger("mjlab")


class ManagerBasedRlEnv:
  """Many worlds of one task behind Gymnasium's vector interface.

  A step is eight stages in a fixed order, `_step_stages`. On a GPU they are recorded once as one graph and replayed;
  on a CPU the same code runs eagerly. What a step returns are fresh tensors.

  Args:
    cfg: What the environment is made of; copied.
    device: "cpu", "cuda[:i]", or "auto" for a GPU if there is one.
    render_mode: "rgb_array", for `render`, or None. It may be set later, too.

  Raises:
    ConfigError: everything that is wrong with `cfg`, by name.
  """

  is_vector_env = True

  def __init__(
    self, cfg: ManagerBasedRlEnvCfg, device: str | torch.device = "auto", render_mode: str | None = None
  ) -> None:
    self.cfg = copy.deepcopy(cfg)
    if problems := self.cfg.problems():
      raise ConfigError("env", problems)
    self.render_mode = render_mode
    if device == "auto":
      device = "cuda" if torch.cuda.is_available() else "cpu"
    self.seed: int = draw_seed() if self.cfg.seed is None else self.cfg.seed
    self.scene = Scene(self.cfg.scene, self.cfg.decimation)
    self.sim = Simulation(self.cfg.scene.num_envs, self.scene.spec, self.cfg.sim, device)
    self.device = self.sim.device
    self.num_envs = self.sim.num_envs
    self.rng = make_generator(self.device, self.seed)
    self.scene.initialize(self.sim, self.rng)

    self.physics_dt = self.sim.timestep
    self.step_dt = self.physics_dt * self.cfg.decimation
    self.max_episode_length_s = self.cfg.episode_length_s
    # A length that is a whole number of steps must not gain one by rounding.
    self.max_episode_length = math.ceil(self.max_episode_length_s / self.step_dt - 1e-9)
    autoreset = "SameStep" if self.cfg.auto_reset else "Disabled"
    self.metadata: dict[str, Any] = {
      "render_modes": list(viewing.RENDER_MODES),
      "render_fps": 1.0 / self.step_dt,
      "autoreset_mode": autoreset,
    }
    self._camera: viewing.Camera | None = None

    n, device = self.num_envs, self.device
    self.episode_length_buf = torch.zeros(n, dtype=torch.int64, device=device)
    self.common_step_counter = torch.zeros((), dtype=torch.int64, device=device)
    self.reset_buf = torch.zeros(n, dtype=torch.bool, device=device)
    self._everybody = torch.ones(n, dtype=torch.bool, device=device)
    self._pending = torch.zeros(n, dtype=torch.bool, device=device)
    self._announced: set[str] = set()
    self._closed = False
    self.output_dir: Path | None = None
    """Folder of a training run, which sets it: dumps of diverged worlds go to `nan_dumps` in it."""

    self._step_graph = self.sim.capture(self._step_stages, generators=(self.rng,))

    self._load_managers()
    self._action = torch.zeros(n, self.action_manager.total_action_dim, device=device)
    self.event_manager.apply("startup")

  def _load_managers(self) -> None:
    terminations = dict(self.cfg.terminations)
    detectors = [name for name, term in terminations.items() if term is not None and term.func is nan_detection]
    if not detectors and "nan_detection" not in terminations:
      # A world that diverged must be ended by somebody, or it stays so for good.
      terminations["nan_detection"] = TerminationTermCfg(nan_detection)
      detectors = ["nan_detection"]
    guard = self.cfg.sim.nan_guard
    self.nan_guard = NanGuard(self.sim, self.cfg.decimation, guard) if guard.enabled and detectors else None
    """Remembers the last states of every world; None where that is off, or nothing detects a divergence."""
    self._nan_detector = detectors[0] if detectors else ""
    self.event_manager = EventManager(self.cfg.events, self)
    self.sim.expand_model_fields(self.event_manager.model_fields)
    self.command_manager = CommandManager(self.cfg.commands, self)
    self.action_manager = ActionManager(self.cfg.actions, self)
    self.termination_manager = TerminationManager(terminations, self)
    self.metrics_manager = MetricsManager(self.cfg.metrics, self)
    self.reward_manager = RewardManager(self.cfg.rewards, self, scale_by_dt=self.cfg.scale_rewards_by_dt)
    self.curriculum_manager = CurriculumManager(self.cfg.curriculum, self)
    self.observation_manager = ObservationManager(self.cfg.observations, self)
    self.recorder_manager = RecorderManager(self.cfg.recorders, self)
    self._managers = tuple(self.managers.values())

  @property
  def managers(self) -> dict[str, ManagerBase[Any]]:
    """All managers by the name of their part of the config."""
    return {
      "events": self.event_manager,
      "commands": self.command_manager,
      "actions": self.action_manager,
      "observations": self.observation_manager,
      "terminations": self.termination_manager,
      "rewards": self.reward_manager,
      "curriculum": self.curriculum_manager,
      "metrics": self.metrics_manager,
      "recorders": self.recorder_manager,
    }

  # The step

  def _step_stages(self) -> None:
    """One environment step. This order is the contract of every term."""
    self._act()  # the action becomes targets
    self._simulate()  # `decimation` physics steps; sensors follow each
    self._terminate()  # whose episode ends, seen on the fresh terminal state
    self._reward()  # what the transition was worth, for the command it was made under
    self._reset(self.reset_buf)  # ended worlds begin anew
    self._command()  # timers run, commands are drawn and followed up
    self._event()  # pushes and other interval events
    self._observe()  # what the policy sees next

  def _act(self) -> None:
    self.action_manager.process_action(self._action)

  def _simulate(self) -> None:
    for substep in range(self.cfg.decimation):
      self.action_manager.apply_action()
      self.scene.write_ctrl()
      if self.nan_guard is not None:
        self.nan_guard.record(substep)
      self.sim.step()
      self.scene.update(self.physics_dt)
      self.metrics_manager.compute_substep()
    self.sim.count_overflow()
    self.episode_length_buf += 1
    self.common_step_counter += 1

  def _terminate(self) -> None:
    self.termination_manager.compute()
    if self.nan_guard is not None:
      self.nan_guard.keep(self.termination_manager.get_term(self._nan_detector))
    if self.cfg.auto_reset:
      self.reset_buf.copy_(self.termination_manager.dones)
    else:
      self._pending.copy_(self.termination_manager.dones)

  def _reward(self) -> None:
    self.reward_manager.compute()
    self.metrics_manager.compute()

  def _reset(self, mask: torch.Tensor) -> None:
    self.recorder_manager.pre_reset(mask)
    self.curriculum_manager.compute(mask)
    self.sim.reset(mask)
    self.scene.reset(mask)
    self.event_manager.apply("reset", mask)
    for manager in (
      self.observation_manager,
      self.action_manager,
      self.reward_manager,
      self.metrics_manager,
      self.curriculum_manager,
      self.command_manager,
      self.event_manager,
      self.termination_manager,
    ):
      manager.reset(mask)
    self.episode_length_buf.masked_fill_(mask, 0)

  def _command(self) -> None:
    self.command_manager.compute(self.step_dt, self.reset_buf)

  def _event(self) -> None:
    self.event_manager.apply("step")
    self.event_manager.apply("interval", ~self.reset_buf)

  def _observe(self) -> None:
    self.observation_manager.compute(self.reset_buf)
    self.recorder_manager.post_reset(self.reset_buf)
    self.recorder_manager.post_step()

  # The Gymnasium interface

  def step(self, action: torch.Tensor) -> tuple[Observations, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
    """Advance every world by one step.

    Args:
      action: Raw policy output, (num_envs, action dim). Numbers that are not finite count as zero.

    Returns:
      Observations by group, reward (num_envs,), terminated and truncated, bool (num_envs,), and an empty dict of
      extras; all fresh tensors. Observations of worlds that ended are the first of their next episode.

    Raises:
      TypeError, ValueError: what is no tensor, or has the wrong shape.
      RuntimeError: without auto-reset, a world whose episode ended was not reset; it is named.
    """
    self._check_open()
    if not isinstance(action, torch.Tensor):
      raise TypeError(f"action must be a torch tensor, got {type(action).__name__}; torch.as_tensor makes one")
    if action.shape != self._action.shape:
      raise ValueError(f"action must have shape {tuple(self._action.shape)}, got {tuple(action.shape)}")
    if not self.cfg.auto_reset and bool(self._pending.any()):
      worlds = self._pending.nonzero().flatten().tolist()
      raise RuntimeError(f"the episodes of worlds {worlds} ended; reset them before the next step")
    # Nothing here is differentiable, and a policy called outside torch.no_grad() is no mistake.
    self._action.copy_(action.detach())
    with self._one_torch_thread():
      for manager in self._managers:
        manager.sync()
      self._step_graph()
    return (
      self.get_observations(),
      self.reward_manager.reward.clone(),
      self.termination_manager.terminated.clone(),
      self.termination_manager.time_outs.clone(),
      {},
    )

  def reset(
    self,
    *,
    seed: int | None = None,
    env_ids: torch.Tensor | Sequence[int] | None = None,
    options: dict[str, Any] | None = None,
  ) -> tuple[Observations, dict[str, Any]]:
    """Begin new episodes.

    Args:
      seed: Restart the environment's generator from this seed.
      env_ids: Which worlds: a bool mask (num_envs,), or world numbers as a tensor or sequence; all by default.
      options: Must be empty; there are none.

    Returns:
      Observations of all worlds by group, fresh tensors, and an empty dict. Worlds that were not asked for keep their
      observations, bit for bit.

    Raises:
      ValueError: a world number or mask that does not fit; nothing was changed.
    """
    self._check_open()
    if options:
      raise ValueError(f"reset knows no options, got: {', '.join(options)}")
    mask = select_worlds(env_ids, self.num_envs, self.device)
    if seed is not None:
      self.seed = seed
      self.rng.manual_seed(seed)
    with self._one_torch_thread():
      self._reset(mask)
      self._pending.masked_fill_(mask, False)
      # No time passes in any world, so the others' commands stay as they are.
      self.command_manager.compute(0.0, self._everybody)
      self.observation_manager.compute(mask, advance=mask)
      self.recorder_manager.post_reset(mask)
      self.sim.forward()
    return self.get_observations(), {}

  def get_observations(self) -> Observations:
    """The current observations by group, as fresh tensors. Asking again changes nothing."""
    return {
      group: value.clone() if isinstance(value, torch.Tensor) else {name: term.clone() for name, term in value.items()}
      for group, value in self.observation_manager.get().items()
    }

  def close(self) -> None:
    """Release recorders, threads and graphs. Calling it again does nothing."""
    if not self._closed:
      self._closed = True
      if self._camera is not None:
        self._camera.close()
      try:
        self.recorder_manager.close()
        self._warn_of_divergence()
      finally:
        self.sim.close()

  @property
  def render_mode(self) -> str | None:
    """What `render` returns: "rgb_array", or nothing."""
    return self._render_mode

  @render_mode.setter
  def render_mode(self, mode: str | None) -> None:
    if mode is not None and mode not in viewing.RENDER_MODES:
      raise ValueError(f"render_mode '{mode}' does not exist; there is {', '.join(viewing.RENDER_MODES)} (and None)")
    self._render_mode = mode

  def render(self) -> np.ndarray | None:
    """A picture of the first worlds, side by side, each followed by its camera: (height, width, 3) uint8.

    None where `render_mode` is None. Nothing of the simulation is changed.

    Raises:
      RuntimeError: mjlab-viewer is not installed, or OpenGL does not work here; the message says what is missing.
    """
    self._check_open()
    if self.render_mode is None:
      return None
    if self._camera is None:
      self._camera = viewing.Camera(self)
    return self._camera.picture()

  # What viewers ask for

  def signals(self) -> dict[str, tuple[Sequence[str], torch.Tensor]]:
    """Names and live values, (num_envs, k), of what can be plotted, by group: "rewards", observations, commands."""
    return viewing.signals(self)

  def drawers(self) -> dict[str, Callable[[DebugDraw], None]]:
    """Who draws over pictures: the `debug_draw` of commands and sensors that have one, by name."""
    return viewing.drawers(self)

  def drawn_at_first(self) -> tuple[str, ...]:
    """Names of the commands and sensors whose configuration wants them drawn (`debug_vis`)."""
    return viewing.drawn_at_first(self)

  def steering(self) -> dict[str, Any]:
    """Commands that can be given by hand, by name: those that have `axes`."""
    return viewing.steering(self)

  def __enter__(self) -> "ManagerBasedRlEnv":
    return self

  def __exit__(self, *_: object) -> None:
    self.close()

  @property
  def unwrapped(self) -> "ManagerBasedRlEnv":
    return self

  @property
  def single_observation_space(self) -> Any:
    """Gymnasium Dict of unbounded boxes, one per observation group."""
    from mjlab_envs.spaces import observation_space

    return observation_space(self.observation_manager)

  @property
  def single_action_space(self) -> Any:
    """Unbounded Gymnasium box of the raw action."""
    from mjlab_envs.spaces import box

    return box((self.action_manager.total_action_dim,))

  @property
  def observation_space(self) -> Any:
    """The spaces of all worlds' observations."""
    from mjlab_envs.spaces import batched

    return batched(self.single_observation_space, self.num_envs)

  @property
  def action_space(self) -> Any:
    """The space of all worlds' actions."""
    from mjlab_envs.spaces import batched

    return batched(self.single_action_space, self.num_envs)

  @property
  def is_captured(self) -> bool:
    """Whether steps are replays of a recording."""
    return self._step_graph.recorded

  @property
  def num_graphs(self) -> int:
    """Graphs that a step consists of, once recorded: one, unless something in it cannot be recorded."""
    return self._step_graph.num_graphs

  # What terms and managers may ask for

  def run_eagerly(self, fn: Callable[[], None], name: str) -> None:
    """Run code that cannot be recorded: the step graph is split around it. Says so once for each name."""
    if self.sim.is_capturing and name not in self._announced:
      self._announced.add(name)
      _log.warning("%s cannot be recorded: the step graph is split around it and it runs eagerly.", name)
    self.sim.graph_break(fn)

  def request_recapture(self, reason: str) -> None:
    """Record the step anew before the next one, because what it does has changed."""
    if self.num_graphs > 0:
      _log.info("recording the step anew: %s", reason)
    self._step_graph.invalidate()

  def recompute_constants(self, mask: torch.Tensor) -> None:
    """Recompute the model's derived fields of masked worlds."""
    self.sim.recompute_constants(mask)

  # Logging and state

  def drain_log(self) -> dict[str, float]:
    """Averages since the last call over the episodes that ended since, by name; one transfer from the device.

    Buffers that overflowed are reported through the logger "mjlab" with the setting to raise, and worlds that diverged
    with what was first.
    """
    names: list[str] = []
    values: list[torch.Tensor] = []
    for manager in self._managers:
      manager_names, manager_values = manager.log_tensors()
      names += manager_names
      values.append(manager_values)
    numbers = torch.cat(values).tolist() if names else []
    for manager in self._managers:
      manager.clear_log()
    self._warn(self.sim.overflow_report())
    self._warn_of_divergence()
    return {name: number for name, number in zip(names, numbers, strict=True) if not math.isnan(number)}

  def _warn_of_divergence(self) -> None:
    if self.nan_guard is not None:
      self._warn(self.nan_guard.report(self.output_dir))

  def _warn(self, lines: list[str]) -> None:
    for line in lines:
      _log.warning("%s", line)

  def state_dict(self) -> dict[str, Any]:
    """Everything that the next step depends on, as fresh tensors."""
    return {
      **{name: tensor.clone() for name, tensor in self._own_state().items()},
      "rng": self.rng.get_state(),
      "sim": self.sim.state_dict(),
      **{name: part.state_dict() for name, part in self._stateful_parts().items()},
    }

  def load_state_dict(self, state: dict[str, Any]) -> None:
    """Go on from a `state_dict` of an environment with the same config.

    Raises:
      StateError, SimulationError: the state belongs to another task, another number of worlds or another kind of
        device; nothing was changed.
    """
    own, parts = self._own_state(), self._stateful_parts()
    for name in (*own, *parts, "sim", "rng"):
      if name not in state:
        raise StateError(f"{name}: missing from the saved state, which has: {', '.join(state) or 'nothing'}.")
    for name, tensor in own.items():
      if state[name].shape != tensor.shape:
        raise StateError(f"{name}: saved shape {tuple(state[name].shape)}, here {tuple(tensor.shape)}.")
    if state["rng"].shape != self.rng.get_state().shape:
      raise StateError(f"rng: saved on another kind of device, here it is {self.device}.")
    for name, part in parts.items():
      part.check_state_dict(state[name])
    self.sim.load_state_dict(state["sim"])
    for name, part in parts.items():
      part.load_state_dict(state[name])
    for name, tensor in own.items():
      tensor.copy_(state[name])
    self.rng.set_state(state["rng"].cpu())

  def _own_state(self) -> dict[str, torch.Tensor]:
    return {
      "episode_length": self.episode_length_buf,
      "pending": self._pending,
      "step_counter": self.common_step_counter,
    }

  def _stateful_parts(self) -> dict[str, Stateful]:
    return {"scene": self.scene, **self.managers}

  def load_progress(self, state: dict[str, Any]) -> None:
    """Take over only how far training had come: what a run with another number of worlds can use.

    Draws go on from elsewhere, so that nobody sees the noise of the beginning again.
    """
    self.common_step_counter.copy_(state["step_counter"])
    self.rng.manual_seed(self.seed + int(self.common_step_counter))
    self.command_manager.load_progress(state["commands"])

  def describe(self) -> str:
    """The environment's parts as tables."""
    head = (
      f"{self.num_envs} worlds on {self.device} ({self.sim.engine} engine), physics {self.physics_dt:g} s,"
      f" step {self.step_dt:g} s, episode {self.max_episode_length} steps, seed {self.seed}"
    )
    return "\n".join([head, *(text for manager in self._managers if (text := manager.describe()))])

  @contextlib.contextmanager
  def _one_torch_thread(self) -> Generator[None, None, None]:
    """On a CPU a second thread of torch only waits, on a core that physics wants: 64 worlds took four times as long."""
    before = torch.get_num_threads()
    if self.device.type == "cuda" or before == 1:
      yield
      return
    torch.set_num_threads(1)
    try:
      yield
    finally:
      torch.set_num_threads(before)

  def _check_open(self) -> None:
    if self._closed:
      raise RuntimeError("this environment is closed")
