"""The training loop: rsl-rl's algorithm, a rollout that never waits for the GPU, checkpoints that forget nothing."""

import contextlib
import io
import math
import os
import time
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any

import torch
from mjlab_core import unknown
from rsl_rl.models import MLPModel
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict
from torch.nn.utils import get_total_norm

from mjlab_rl import checkpoint
from mjlab_rl.checkpoint import CheckpointError
from mjlab_rl.config import ConfigError, RslRlBaseRunnerCfg
from mjlab_rl.console import Console
from mjlab_rl.episode_statistics import EpisodeStatistics
from mjlab_rl.iteration_report import IterationReport
from mjlab_rl.run_directory import checkpoints
from mjlab_rl.scalar_log import ScalarLog, open_logs
from mjlab_rl.stop_signals import StopSignals
from mjlab_rl.vec_env import RslRlVecEnvWrapper


class DivergedError(RuntimeError):
  """An update left a network that is not finite; the message says when, and what there is from before."""


class MjlabOnPolicyRunner(OnPolicyRunner):
  """rsl-rl's runner with a loop of its own.

  - A rollout queues work on the device and waits once, at its end; statistics accumulate on the device and come to the
    host once per iteration.
  - A checkpoint holds the learner, the worlds, every random generator and the statistics: what continues from it is
    what would have happened without the interruption. `model_<n>.pt` is the state after n iterations.
  - Ctrl-C, SIGTERM and SIGHUP end the run after the iteration, with a checkpoint.

  Args:
    env: The wrapped environment.
    cfg: Learner configuration.
    log_dir: Run directory, for checkpoints and logs; None: nothing is written.
    device: Device of the learner, that of the environment.
    console: Where progress is shown; None: standard output.
  """

  env: RslRlVecEnvWrapper

  def __init__(
    self,
    env: RslRlVecEnvWrapper,
    cfg: RslRlBaseRunnerCfg,
    log_dir: str | os.PathLike[str] | None = None,
    device: str | torch.device = "cpu",
    *,
    console: Console | None = None,
  ):
    cfg.check_samples(env.num_envs)
    if not env.num_actions:
      raise ConfigError("the environment takes no actions, so there is nothing to learn")
    seen = env.unwrapped.get_observations()
    for network, groups in cfg.obs_groups.items():
      for group in groups:
        if group not in seen:
          raise ConfigError(unknown("observation group", group, list(seen), owner=f"agent.obs_groups['{network}']"))
    self._shapes_seen = {
      network: [list(seen[group].shape[1:]) for group in groups] for network, groups in cfg.obs_groups.items()
    }
    # A rollout keeps what it is given, so it is not given what no network looks at.
    env.groups = frozenset(group for groups in cfg.obs_groups.values() for group in groups)
    self.agent_cfg = cfg
    self.console = console if console is not None else Console()
    self.log_dir = None if log_dir is None else Path(log_dir)
    with contextlib.redirect_stdout(io.StringIO()) as chatter:
      super().__init__(env, cfg.to_rsl_rl(), log_dir=None, device=str(device))
    if self.console.is_verbose:
      self.console.say(chatter.getvalue().rstrip())
    self.statistics = EpisodeStatistics(env.num_envs, device)
    self.stopped_by: str | None = None
    """Name of the signal that ended the last `learn` early; None where it ran to its end."""
    self.is_world_state_restored = False
    """Whether `load` put every world back where it was."""
    self.after_step: Callable[[], None] | None = None
    """Called after every step of a rollout, by those who watch."""
    self._torch_device = torch.device(device)
    self._elapsed = 0.0
    self._total_steps = 0

  @property
  def networks(self) -> dict[str, MLPModel]:
    """The networks by the names that they have in configurations and checkpoints."""
    return {"actor": self.alg._raw_actor, "critic": self.alg._raw_critic}

  @property
  def is_writer(self) -> bool:
    """Whether this process writes logs and checkpoints: the first of the run, and only with a run directory."""
    return self.log_dir is not None and self.gpu_global_rank == 0

  def learn(self, num_learning_iterations: int, init_at_random_ep_len: bool = False) -> None:
    """Run so many iterations more.

    Args:
      num_learning_iterations: Iterations from `current_learning_iteration` on.
      init_at_random_ep_len: Spread the ages of the first episodes evenly, so that time-outs do not come all at once.
    """
    self.stopped_by = None
    if init_at_random_ep_len:
      ages = self.env.episode_length_buf
      self.env.episode_length_buf = torch.randint_like(ages, high=int(self.env.max_episode_length))
    start = self.current_learning_iteration
    end = start + num_learning_iterations
    obs = self.env.get_observations()
    self.alg.train_mode()
    if self.is_distributed:
      self.alg.broadcast_parameters()
    with self._open_logs() as logs, StopSignals() as stop, self.console.live():
      started, before = time.perf_counter(), self._elapsed
      for iteration in range(start, end):
        began = time.perf_counter()
        obs = self._collect(obs)
        self._synchronize()
        collected = time.perf_counter()
        losses = self._update(obs)
        means, action_std = self._fetch_statistics()
        env_log = self.env.drain_log()
        learned = time.perf_counter()

        self.current_learning_iteration = iteration + 1
        self._elapsed = before + learned - started
        report = self._report(iteration, start, end, collected - began, learned - collected, learned - started)
        if means is not None:
          report.mean_reward, report.mean_episode_length = means
        report.scalars = self._scalars(report, losses, action_std, env_log)
        for log in logs:
          log.write(report)
        self.console.show(report)
        self._check_finite(iteration, losses | {"mean_std": action_std} | self._largest_weights())

        # Looked at once: a signal from here on waits for the next iteration, which saves before it stops.
        is_end = iteration + 1 == end
        self.stopped_by = None if is_end else stop.received
        is_last = is_end or self.stopped_by is not None
        if self.is_writer and (is_last or (iteration + 1) % self.agent_cfg.save_interval == 0):
          path = self.checkpoint_path()
          self.save(str(path))
          for log in logs:
            log.save_file(path)
        if is_last:
          break

  def _largest_weights(self) -> dict[str, float]:
    """By network: the losses of an update are from before its last step."""
    weights = {
      name: [value for value in network.state_dict().values() if value.is_floating_point()]
      for name, network in self.networks.items()
    }
    return {name: float(get_total_norm(values, math.inf)) for name, values in weights.items()}

  def _check_finite(self, iteration: int, values: Mapping[str, float]) -> None:
    if broken := [name for name, value in values.items() if not math.isfinite(value)]:
      saved = checkpoints(self.log_dir) if self.log_dir is not None else []
      last = f"; the last checkpoint is {saved[-1]}" if saved else ""
      raise DivergedError(
        f"iteration {iteration + 1}: {', '.join(broken)} not finite, so it is not saved{last}. Rewards that grow "
        "without limit and steps that are too large (agent.algorithm.learning_rate) do that."
      )

  def checkpoint_path(self) -> Path:
    """Where the present state is saved."""
    assert self.log_dir is not None
    return self.log_dir / f"model_{self.current_learning_iteration}.pt"

  def save(self, path: str, infos: dict[str, Any] | None = None) -> None:
    """Write a checkpoint; the file appears whole or not at all.

    Args:
      path: File to write.
      infos: Plain values to keep with it, returned by `load`.
    """
    state = self.alg.save()
    # rsl-rl's own loader continues at "iter", so this is the next iteration, not the last one.
    state |= {"iter": self.current_learning_iteration, "infos": infos}
    state["mjlab"] = {
      "format": checkpoint.FORMAT,
      "num_envs": self.env.num_envs,
      "shapes_seen": self._shapes_seen,
      "env": self.env.unwrapped.state_dict(),
      "statistics": self.statistics.state_dict(),
      "hidden_states": [network.get_hidden_state() for network in self.networks.values()],
      "rng": checkpoint.rng_state(self._torch_device),
      "elapsed": self._elapsed,
      "total_steps": self._total_steps,
    }
    checkpoint.write_checkpoint(Path(path), state)

  def load(
    self,
    path: str,
    load_cfg: dict[str, bool] | None = None,
    strict: bool = True,
    map_location: str | None = None,
  ) -> dict[str, Any]:
    """Continue from a checkpoint of ours, or from the learner of one of rsl-rl's.

    The worlds are restored only into as many worlds as were saved; otherwise they stay as they are, counters are
    restored, and the console says so.

    Args:
      path: Checkpoint file.
      load_cfg: Parts to load: names of `networks`, "optimizer", "iteration", "rnd"; None: everything, worlds included.
      strict: Whether names must match exactly.
      map_location: Not needed: tensors go to the device of what they fill.

    Returns:
      The values saved with it.

    Raises:
      CheckpointError: It cannot be read, or its networks have other sizes or saw observations of other shapes; nothing
        has been changed then.
    """
    del map_location
    state = checkpoint.read_checkpoint(Path(path), self.agent_cfg.policy)
    wanted = [part for part in (*self.networks, "optimizer") if load_cfg is None or load_cfg.get(part)]
    if missing := [part for part in wanted if f"{part}_state_dict" not in state]:
      raise CheckpointError(
        f"checkpoint {path}: no {' and no '.join(missing)} in it, so its training cannot go on; another can begin as "
        "its policy (--init-from)"
      )
    if "optimizer" in wanted:
      checkpoint.check_optimizer(Path(path), state["optimizer_state_dict"], self.alg.optimizer.state_dict())
    for part, model in self.networks.items():
      if part in wanted:
        self.check_shapes_seen(Path(path), part, checkpoint.shapes_seen(state, part))
        checkpoint.check_fit(Path(path), part, state[f"{part}_state_dict"], model.state_dict())
    if self.alg.load(state, load_cfg, strict):
      # A file of rsl-rl's names the last iteration done.
      self.current_learning_iteration = int(state["iter"]) + (0 if "mjlab" in state else 1)
    if "optimizer" in wanted and self.cfg["algorithm"].get("schedule", "fixed") == "fixed":
      # The optimiser's state has the step size of then, and nothing but the configuration changes it here.
      self.alg.learning_rate = self.cfg["algorithm"]["learning_rate"]
      for group in self.alg.optimizer.param_groups:
        group["lr"] = self.alg.learning_rate
    if load_cfg is None and "mjlab" in state:
      self._load_worlds(state["mjlab"])
    elif load_cfg is None:
      self.console.say(f"{path}: an rsl-rl checkpoint, it holds no world state; only the learner was restored.")
    return state.get("infos") or {}

  def load_policy(self, path: Path) -> None:
    """Take the weights of the policy in a checkpoint, of a run by reinforcement or of a distillation, and nothing else.

    Raises:
      CheckpointError: It cannot be read, it saw observations of other shapes, or the network has other sizes; nothing
        has been changed then.
    """
    name = self.agent_cfg.policy
    (weights, shapes), network = checkpoint.read_policy(path, name), self.networks[name]
    self.check_shapes_seen(path, name, shapes)
    checkpoint.check_fit(path, name, weights, network.state_dict())
    network.load_state_dict(weights)

  def check_shapes_seen(self, path: Path, network: str, trained: checkpoint.Shapes | None) -> None:
    """Compare what a network of a checkpoint saw, where that is known, with what one of these networks sees.

    Raises:
      CheckpointError: Observations had other shapes.
    """
    groups = self.agent_cfg.obs_groups[network]
    checkpoint.check_shapes_seen(path, groups, trained, self._shapes_seen[network])

  def _load_worlds(self, state: dict[str, Any]) -> None:
    is_restored = False
    if state["num_envs"] != self.env.num_envs:
      reason = f"it was saved with {state['num_envs']} worlds, there are {self.env.num_envs} now"
    else:
      try:
        self.env.unwrapped.load_state_dict(state["env"])
        is_restored, reason = True, ""
      except (ValueError, KeyError, RuntimeError, TypeError) as error:
        reason = str(error)
        self.env.reset()
    if not is_restored:
      self.console.say(f"World state was not restored: {reason}. Learner and counters were.")
      self.env.unwrapped.load_progress(state["env"])
    self.statistics.load_state_dict(state["statistics"], same_worlds=is_restored)
    self.is_world_state_restored = is_restored
    self._elapsed = state["elapsed"]
    self._total_steps = state["total_steps"]
    if is_restored:
      for model, hidden in zip(self.networks.values(), state["hidden_states"], strict=True):
        if hidden is not None:
          model.reset(hidden_state=_to_device(hidden, self._torch_device))
      checkpoint.restore_rng_state(state["rng"], self._torch_device)

  def _collect(self, obs: TensorDict) -> TensorDict:
    # Not inference mode: a tensor that the environment makes in there and keeps could not be written to afterwards.
    with torch.no_grad(), self._rollout_threads():
      for _ in range(self.agent_cfg.num_steps_per_env):
        actions = self.alg.act(obs)
        obs, rewards, dones, extras = self.env.step(actions)
        self.alg.process_env_step(obs, rewards, dones, extras)
        self.statistics.add(rewards, dones)
        if self.after_step is not None:
          self.after_step()
    return obs

  @contextlib.contextmanager
  def _rollout_threads(self) -> Generator[None]:
    """On a CPU physics has threads of its own, and torch's would only wait for it: a rollout's tensors are small."""
    before = torch.get_num_threads()
    if self._torch_device.type == "cpu":
      torch.set_num_threads(1)
    try:
      yield
    finally:
      torch.set_num_threads(before)

  def _update(self, obs: TensorDict) -> dict[str, float]:
    with torch.no_grad():
      self.alg.compute_returns(obs)
    with self._matmul_precision():
      losses = self.alg.update()
    return losses | {"learning_rate": self.alg.learning_rate}

  @contextlib.contextmanager
  def _matmul_precision(self) -> Generator[None]:
    """Reduced precision for the update alone: the environment's rotations and rewards need all of float32."""
    if self._torch_device.type != "cuda":
      yield
      return
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(self.agent_cfg.matmul_precision)
    try:
      yield
    finally:
      torch.set_float32_matmul_precision(before)

  def _synchronize(self) -> None:
    if self._torch_device.type == "cuda":
      torch.cuda.synchronize(self._torch_device)

  def _fetch_statistics(self) -> tuple[tuple[float, float] | None, float]:
    """(means of return and length, mean action deviation) in one transfer; waits for the update to end."""
    std = self.alg.get_policy().output_std.detach().float().mean()
    values = torch.cat((self.statistics.packed(), std.view(1))).tolist()
    return EpisodeStatistics.unpack(values[:-1]), values[-1]

  def _report(
    self, iteration: int, start: int, end: int, collect: float, learn: float, running: float
  ) -> IterationReport:
    steps = self.agent_cfg.num_steps_per_env * self.env.num_envs * self.gpu_world_size
    self._total_steps += steps
    return IterationReport(
      iteration=iteration,
      end=end,
      total_steps=self._total_steps,
      steps_per_second=steps / (collect + learn),
      collect_time=collect,
      learn_time=learn,
      elapsed=self._elapsed,
      eta=running / (iteration + 1 - start) * (end - iteration - 1),
      mean_reward=None,
      mean_episode_length=None,
    )

  @staticmethod
  def _scalars(
    report: IterationReport, losses: Mapping[str, float], action_std: float, env_log: Mapping[str, float]
  ) -> dict[str, float]:
    """All values of an iteration under rsl-rl's tags."""
    scalars = {f"Loss/{name}": value for name, value in losses.items()}
    scalars |= {
      "Policy/mean_std": action_std,
      "Perf/total_fps": report.steps_per_second,
      "Perf/collection_time": report.collect_time,
      "Perf/learning_time": report.learn_time,
    }
    if report.mean_reward is not None and report.mean_episode_length is not None:
      scalars["Train/mean_reward"] = report.mean_reward
      scalars["Train/mean_episode_length"] = report.mean_episode_length
    scalars |= {name if "/" in name else f"Episode/{name}": value for name, value in env_log.items()}
    return scalars

  @contextlib.contextmanager
  def _open_logs(self) -> Generator[list[ScalarLog]]:
    logs: list[ScalarLog] = []
    if self.is_writer:
      assert self.log_dir is not None
      logs = open_logs(self.log_dir, self.agent_cfg, self.cfg)
    try:
      yield logs
    finally:
      for log in logs:
        log.close()


def _to_device(hidden: Any, device: torch.device) -> Any:
  if isinstance(hidden, (tuple, list)):
    return tuple(_to_device(item, device) for item in hidden)
  return hidden.to(device)
