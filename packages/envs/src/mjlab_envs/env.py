"""The manager-based environment and its step."""

import contextlib
import copy
import math
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
import torch
from mjlab_core import ConfigError, MjlabError, call_where, check_value, draw_seed, make_generator
from mjlab_managers import EventManager, TerminationTermCfg
from mjlab_scene import Scene
from mjlab_sim import NanGuard, Simulation

from mjlab_envs import rehearsal, viewing
from mjlab_envs.base_env import MANAGERS, EnvState, Observations, cloned, select_worlds
from mjlab_envs.compiled_terms import CompiledTerms
from mjlab_envs.env_cfg import ManagerBasedRlEnvCfg
from mjlab_envs.mdp.terminations import nan_detection


class ManagerBasedRlEnv(viewing.ViewableEnv):
  """Many worlds of one task behind Gymnasium's vector interface.

  A step is eight stages in a fixed order, `_step_stages`. On a GPU they are recorded once as one graph and replayed;
  on a CPU the same code runs eagerly. A step returns fresh tensors.

  Args:
    cfg: Parts of the environment; copied.
    device: "cpu", "cuda[:i]", or "auto" for a GPU if there is one.
    render_mode: "rgb_array", for `render`, or None. It may be set later, too.

  Raises:
    ConfigError: the config has mistakes; the message lists all of them by name.
  """

  is_vector_env = True

  def __init__(
    self, cfg: ManagerBasedRlEnvCfg, device: str | torch.device = "auto", render_mode: str | None = None
  ) -> None:
    self.cfg = copy.deepcopy(cfg)
    check_value("render_mode", render_mode, viewing.RenderMode | None)
    self.render_mode = render_mode
    """Kind of picture that `render` returns: "rgb_array", or None for no picture."""
    if device == "auto":
      device = "cuda" if torch.cuda.is_available() else "cpu"
    self._closed = False
    self._resources = contextlib.ExitStack()
    problems = [f"env: {problem}" for problem in self.cfg.problems()]
    try:
      self._build(device, problems)
    except Exception as error:
      self.close()
      parts = [(kind, getattr(cfg, part)) for part, (_, kind) in MANAGERS.items()]
      unread = [line for kind, terms in parts if isinstance(terms, dict) for line in kind.check(terms)]
      if not (problems or unread):
        raise
      if isinstance(error, MjlabError):
        problems.append(str(error))
      raise ConfigError(*problems, *(line for line in unread if line not in problems)) from error
    if problems:
      self.close()
      raise ConfigError(*problems)
    self.event_manager.apply("startup")

  def _build(self, device: str | torch.device, problems: list[str]) -> None:
    """Build all parts; add a line to `problems` for each mistake that does not prevent building the rest."""
    self.seed = draw_seed() if self.cfg.seed is None else self.cfg.seed
    self.scene = Scene(self.cfg.scene, self.cfg.decimation, problems=problems)
    self.sim = Simulation(self.cfg.scene.num_envs, self.scene.spec, self.cfg.sim, device)
    self._resources.callback(self.sim.close)
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
      "render_modes": list(get_args(viewing.RenderMode)),
      "render_fps": 1.0 / self.step_dt,
      "autoreset_mode": autoreset,
    }
    self._camera: viewing.Camera | None = None

    n, device = self.num_envs, self.device
    self._state = EnvState(n, device)
    self._state["scene"] = self.scene
    self.episode_length_buf, self.common_step_counter = self._state.episode_length, self._state.step_counter
    self.reset_buf = torch.zeros(n, dtype=torch.bool, device=device)
    self._everybody = torch.ones(n, dtype=torch.bool, device=device)
    self._announced = set()

    self._step_graph = self.sim.capture(self._step_stages, generators=(self.rng,))

    self._load_managers(problems)
    self._resources.callback(self._warn_of_divergence)
    self._resources.callback(self.recorder_manager.close)
    self._action = torch.zeros(n, self.action_manager.total_action_dim, device=device)
    self._rehearse(problems)
    if self.cfg.compile_terms:
      managers = (self.observation_manager, self.reward_manager, self.termination_manager, self.metrics_manager)
      self._compiled = tuple(CompiledTerms(self.sim, self.rng, manager) for manager in managers)
    if self.cfg.capture_terminal_observations:
      # Their memory is made here, not inside a recording.
      _ = self.observation_manager.terminal_buffers

  def _load_managers(self, problems: list[str]) -> None:
    terminations = dict(self.cfg.terminations)
    given = (name for name, term in terminations.items() if term is not None and term.func is nan_detection)
    self._nan_detector = next(given, "")
    if not self._nan_detector and "nan_detection" not in terminations:
      # Without a termination, a world that diverged would never be reset.
      self._nan_detector = "nan_detection"
      terminations["nan_detection"] = TerminationTermCfg(nan_detection)
    guard = self.cfg.sim.nan_guard
    is_guarded = guard.enabled and self._nan_detector
    self.nan_guard = NanGuard(self.sim, self.cfg.decimation, guard) if is_guarded else None
    parts = vars(self.cfg) | {"terminations": terminations}
    self.managers = {}
    options = {
      "rewards": {"scale_by_dt": self.cfg.scale_rewards_by_dt},
      "curriculum": {"others": self.managers.values()},
    }
    for part, (name, kind) in MANAGERS.items():
      manager = kind(parts[part], self, problems=problems, **options.get(part, {}))
      self.managers[part] = self._state[part] = manager
      setattr(self, name, manager)
      if isinstance(manager, EventManager):
        self.sim.expand_model_fields(manager.model_fields)

  def _rehearse(self, problems: list[str]) -> None:
    """Call the parts that no manager has called yet, add failures to `problems`, and restore all state."""
    state = self.state_dict()
    undo = [manager.remember() for manager in self.managers.values()]
    problems += rehearsal.rehearse(self.managers, self.drawers())
    if problems:
      return
    for put_back in undo:
      put_back()
    rehearsal.complete(state["sim"], self.sim)
    self.load_state_dict(state)

  # The step

  def _step_stages(self) -> None:
    """Run one environment step. Terms may rely on this order."""
    self._act()  # the action becomes targets
    self._simulate()  # `decimation` physics steps; sensors follow each
    self._terminate()  # episodes end, judged on the fresh terminal state
    self._reward()  # rewards of the transition, for the command it was made under
    self._keep_terminal_observations()  # last observations of ended worlds, if configured
    self._reset(self.reset_buf)  # ended worlds begin a new episode
    self._command()  # timers run, commands are drawn and followed up
    self._event()  # pushes and other interval events
    self._observe()  # the next input of the policy

  def _keep_terminal_observations(self) -> None:
    if self.cfg.capture_terminal_observations:
      self.observation_manager.keep_terminal(self.reset_buf)

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
    self.episode_length_buf += 1
    self.common_step_counter += 1

  def _terminate(self) -> None:
    self.termination_manager.compute()
    if self.nan_guard is not None:
      self.nan_guard.keep(self.termination_manager.get_term(self._nan_detector))
    if self.cfg.auto_reset:
      self.reset_buf.copy_(self.termination_manager.dones)
    else:
      self._state.pending.copy_(self.termination_manager.dones)

  def _reward(self) -> None:
    self.reward_manager.compute()
    self.metrics_manager.compute()

  def _reset(self, mask: torch.Tensor) -> None:
    self.recorder_manager.pre_reset(mask)
    self.curriculum_manager.compute(mask)
    call_where(mask, self._begin_episodes, self.rng)

  def _begin_episodes(self, mask: torch.Tensor) -> None:
    self.sim.reset(mask)
    self.scene.reset(mask)
    self.event_manager.apply("reset", mask)
    for manager in reversed(self.managers.values()):
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
      action: Raw policy output, (num_envs, action dim). Infinite numbers and NaN count as zero.

    Returns:
      Observations by group, reward (num_envs,), terminated and truncated, bool (num_envs,), and a dict of extras; all
      fresh tensors. Observations of worlds that ended are the first of their next episode. With
      `capture_terminal_observations`, extras have the last of the one that ended: "final_obs" by group, as Gymnasium
      names it, valid where "_final_obs", bool (num_envs,), is true.

    Raises:
      TypeError: `action` is not a tensor.
      ValueError: `action` has the wrong shape.
      RuntimeError: without auto-reset, the episode of a world ended and the world was not reset.
    """
    self._check_open()
    if not isinstance(action, torch.Tensor):
      raise TypeError(f"action must be a torch tensor, got {type(action).__name__}; torch.as_tensor makes one")
    if action.shape != self._action.shape:
      raise ValueError(f"action must have shape {tuple(self._action.shape)}, got {tuple(action.shape)}")
    if not self.cfg.auto_reset and bool(self._state.pending.any()):
      worlds = self._state.pending.nonzero().flatten().tolist()
      raise RuntimeError(f"the episodes of worlds {worlds} ended; reset them before the next step")
    # A step is not differentiable; a policy may be called outside torch.no_grad().
    self._action.copy_(action.detach())
    with self._one_torch_thread():
      for manager in self.managers.values():
        manager.sync()
      self._step_graph()
    return (
      self.get_observations(),
      self.reward_manager.reward.clone(),
      self.termination_manager.terminated.clone(),
      self.termination_manager.time_outs.clone(),
      self._extras(),
    )

  def _extras(self) -> dict[str, Any]:
    if not self.cfg.capture_terminal_observations:
      return {}
    final = self.observation_manager.terminal_buffers
    return {"final_obs": cloned(final), "_final_obs": self.termination_manager.dones.clone()}

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
      env_ids: Worlds to reset: a bool mask (num_envs,), or world numbers as a tensor or sequence; all by default.
      options: Ignored; it exists for Gymnasium.

    Returns:
      Observations of all worlds by group, fresh tensors, and an empty dict. Observations of the other worlds stay
      bit-identical.

    Raises:
      ValueError: `env_ids` does not fit the number of worlds; nothing was changed.
    """
    self._check_open()
    del options
    mask = select_worlds(env_ids, self.num_envs, self.device)
    if seed is not None:
      self.seed = seed
      self.rng.manual_seed(seed)
    with self._one_torch_thread():
      self._reset(mask)
      self._state.pending.masked_fill_(mask, False)
      # No time passes in any world, so the others' commands stay as they are.
      self.command_manager.compute(0.0, self._everybody)
      self.observation_manager.compute(mask, advance=mask)
      self.recorder_manager.post_reset(mask)
      self.sim.forward()
    return self.get_observations(), {}

  def close(self) -> None:
    """Release recorders, threads and graphs. Calling it again does nothing."""
    self._closed = True
    self._resources.close()

  def render(self) -> np.ndarray | None:
    """Return a picture of the first worlds side by side, (height, width, 3) uint8; None if `render_mode` is None.

    The camera follows each world. The simulation does not change.

    Raises:
      RuntimeError: mjlab-viewer is not installed, or OpenGL does not work here; the message says what is missing.
    """
    self._check_open()
    if self.render_mode is None:
      return None
    if self._camera is None:
      self._camera = viewing.Camera(self, self.cfg.viewer)
      self._resources.callback(self._camera.close)
    return self._camera.picture()

  def __enter__(self) -> "ManagerBasedRlEnv":
    return self

  def __exit__(self, *_: object) -> None:
    self.close()

  @property
  def unwrapped(self) -> "ManagerBasedRlEnv":
    return self

  def _check_open(self) -> None:
    if self._closed:
      raise RuntimeError("this environment is closed")
