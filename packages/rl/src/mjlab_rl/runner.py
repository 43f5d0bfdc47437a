"""Training loop around rsl-rl's algorithms: rollouts without waiting for the GPU, complete checkpoints."""

import contextlib
import io
import math
import os
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import torch
from mjlab_core import printable
from mjlab_core.errors import ConfigError, DivergedError, FileError
from mjlab_core.io.files import reading
from rsl_rl.models import MLPModel
from rsl_rl.modules import RNN
from rsl_rl.runners import OnPolicyRunner
from rsl_rl.utils import resolve_callable
from tensordict import TensorDict

from mjlab_rl.config import RslRlBaseRunnerCfg, RslRlOnPolicyRunnerCfg
from mjlab_rl.models.networks import largest_weights
from mjlab_rl.onpolicy.critic_warmup import actor_held, set_learning_rate
from mjlab_rl.processes.rank_averages import Figures, RankAverages
from mjlab_rl.processes.ranks import Patience, Ranks
from mjlab_rl.processes.stop_signals import StopSignals
from mjlab_rl.reports.console import Console
from mjlab_rl.reports.episode_statistics import EpisodeStatistics
from mjlab_rl.reports.scalar_log import IterationReport, RunLogs
from mjlab_rl.runs import checkpoint
from mjlab_rl.runs.process_state import ProcessState, pack, set_for_now, unpack
from mjlab_rl.vec_env import RslRlVecEnvWrapper

# Tags of figures that are checked and not logged.
_WEIGHTS = "Weights/"


class MjlabOnPolicyRunner(OnPolicyRunner):
  """rsl-rl's runner with another training loop.

  - A rollout waits for the device once, at its end; statistics accumulate there and are read once per iteration.
  - A checkpoint holds the learner, the worlds, every random generator and the statistics, so that a resumed run equals
    an uninterrupted one. `model_<n>.pt` is the state after n iterations.
  - Ctrl-C, SIGTERM and SIGHUP end the run after the iteration, with a checkpoint.

  Args:
    env: The wrapped environment.
    cfg: Learner configuration.
    log_dir: Run directory, for checkpoints and logs; None: nothing is written.
    device: Device of the learner and of the environment.
    console: Output of progress; None: standard output.
  """

  env: RslRlVecEnvWrapper
  network_names: ClassVar[tuple[str, ...]] = ("actor", "critic")
  """Names of the networks in configurations and checkpoints, and as attributes of the algorithm."""

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
      raise ConfigError("the environment has no actions to learn")
    self._shapes_seen = env.select(cfg.obs_groups)
    self.agent_cfg = cfg
    self.console = console if console is not None else Console()
    self.log_dir = None if log_dir is None else Path(log_dir)
    self.ranks = Ranks.current()
    """Place of this process in the run."""
    self.env, self.device = env, str(device)
    # Not by rsl-rl's constructor, which connects processes by itself, and only on GPUs.
    processes = vars(self.ranks) | {"global_rank": self.ranks.rank} if self.ranks.world_size > 1 else None
    self.cfg: dict[str, Any] = cfg.to_rsl_rl() | {"torch_compile_mode": None, "multi_gpu": processes}
    algorithm: Any = resolve_callable(self.cfg["algorithm"]["class_name"])
    with contextlib.redirect_stdout(io.StringIO()) as chatter:
      self.alg = algorithm.construct_algorithm(env.get_observations(), env, self.cfg, self.device)
    self.current_learning_iteration = 0
    # Not compiled: a compiled network has other names for its weights.
    self.networks: dict[str, MLPModel] = {name: getattr(self.alg, name) for name in self.network_names}
    """Networks by name."""
    self.alg.compile(cfg.torch_compile_mode)
    if self.console.is_verbose:
      self.console.say(chatter.getvalue().rstrip())
    self._torch_device = torch.device(device)
    self._averages = RankAverages(self.networks, self.ranks, self._torch_device)
    self.statistics = EpisodeStatistics(env.num_envs, device)
    memories = [part for network in self.networks.values() for part in network.modules() if isinstance(part, RNN)]
    self._process = ProcessState(env.unwrapped, self.statistics, memories, self._torch_device)
    self.stopped_by: str | None = None
    """Name of the signal that ended the last `learn` early; None if it ran to its end."""
    self.is_world_state_restored = False
    """True if `load` restored every world."""
    self.after_save: Callable[[Path], None] | None = None
    """Called with every checkpoint of `learn`."""
    self.after_step: Callable[[], None] | None = None
    """Function called after every step of a rollout, for viewers."""
    self.patience = Patience()
    self._elapsed = 0.0
    self._total_steps = 0
    self._last_saved: Path | None = None
    self._updating = 0.0
    """Time of updates within the last rollout [s]."""

  def learn(self, num_learning_iterations: int, init_at_random_ep_len: bool = False) -> None:
    """Run more iterations.

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
    if self.ranks.world_size > 1:
      self.alg.broadcast_parameters()
    with (
      RunLogs(self.log_dir if self.ranks.is_first else None, self.agent_cfg, self.cfg) as logs,
      StopSignals() as stop,
      self.console.live(),
    ):
      started, before = time.perf_counter(), self._elapsed
      while self.current_learning_iteration < end and self.stopped_by is None:
        with self._emergency_checkpoint():
          obs, own = self._iterate(obs)
          self.current_learning_iteration = done = self.current_learning_iteration + 1
          # Ranks agree on the signal, so that they stop together.
          figures, received = self._averages.reduce(own, "SIGHUP" if self.ranks.is_orphan else stop.received)
        self.patience.begin()
        running = time.perf_counter() - started
        self._elapsed = before + running
        report = self._report(figures, end, eta=running / (done - start) * (end - done))
        logs.write(report)
        self.console.show(report)
        self._check_finite(report, figures)
        # Read once: a later signal waits for the next iteration, which saves before it stops.
        self.stopped_by = received if done < end else None
        is_last = done == end or self.stopped_by is not None
        if self.log_dir is not None and (is_last or done % self.agent_cfg.save_interval == 0):
          self._save_with_logs(logs)

  def _iterate(self, obs: TensorDict) -> tuple[TensorDict, Figures]:
    """Return the last observations of a rollout and an update, and the figures of this process."""
    began = time.perf_counter()
    obs = self._collect(obs)
    collected = time.perf_counter()
    losses = self._update(obs)
    std = float(self.alg.get_policy().output_std.detach().float().mean())
    weights = largest_weights(self.networks)
    updated = time.perf_counter()
    figures = {f"Loss/{name}": value for name, value in losses.items()} | {"Policy/mean_std": std}
    figures |= {f"{_WEIGHTS}{name}": value for name, value in weights.items()}
    updating = min(collected - began, self._updating)
    figures["Perf/collection_time"] = collected - began - updating
    figures["Perf/learning_time"] = updated - collected + updating
    figures |= zip(("Train/mean_reward", "Train/mean_episode_length"), self.statistics.means(), strict=False)
    log = self.env.drain_log()
    return obs, figures | {name if "/" in name else f"Episode/{name}": value for name, value in log.items()}

  def _report(self, figures: Figures, end: int, eta: float) -> IterationReport:
    """Return the report of an iteration with the figures of all processes."""
    steps = self.agent_cfg.num_steps_per_env * self.env.num_envs * self.ranks.world_size
    self._total_steps += steps
    seconds = figures["Perf/collection_time"] + figures["Perf/learning_time"]
    scalars = {tag: value for tag, value in figures.items() if not tag.startswith(_WEIGHTS)}
    return IterationReport(
      iteration=self.current_learning_iteration - 1,
      end=end,
      total_steps=self._total_steps,
      elapsed=self._elapsed,
      eta=eta,
      scalars=scalars | {"Perf/total_fps": steps / seconds},
    )

  def _save_with_logs(self, logs: RunLogs) -> None:
    # The disk of the first process, for which the others wait, may be slow.
    with self.patience.suspended():
      self._last_saved = path = self.checkpoint_path()
      self.save(str(path))
      logs.save_file(path)
      if self.after_save is not None:
        self.after_save(path)
      self.ranks.gather(None)

  @contextlib.contextmanager
  def _emergency_checkpoint(self) -> Generator[None]:
    """Save the learner and the worlds of this process if a step or an update fails, and raise the error again."""
    try:
      yield
    except Exception as error:
      if self.log_dir is not None:
        path = self.log_dir / f"emergency_{self.current_learning_iteration}.pt"
        result = f"saved {path}, which --resume takes"
        try:
          checkpoint.write_checkpoint(path, self._state([self._process.state_dict()]))
        except Exception as unsaved:
          result = f"{path.name} not saved: {printable(unsaved)}"
        self.console.say(f"{type(error).__name__} in a step or update; {result}")
      raise

  def _check_finite(self, report: IterationReport, figures: Figures) -> None:
    learned = {tag: value for tag, value in figures.items() if tag.startswith(("Loss/", "Policy/", _WEIGHTS))}
    if broken := [tag.partition("/")[2] for tag, value in learned.items() if not math.isfinite(value)]:
      last = f"; the last checkpoint is {self._last_saved}" if self._last_saved else ""
      found = f"iteration {report.iteration + 1}: {', '.join(broken)} not finite"
      raise DivergedError(f"{found}, so the state is not saved{last}. {report.cause_of_divergence()}")

  def checkpoint_path(self) -> Path:
    """Return the path of a checkpoint of the current iteration."""
    assert self.log_dir is not None
    return self.log_dir / f"model_{self.current_learning_iteration}.pt"

  def save(self, path: str, infos: dict[str, Any] | None = None) -> None:
    """Write a checkpoint; the file appears whole or not at all. Every rank must call it, the first one writes.

    Args:
      path: File to write.
      infos: Plain values to keep with it, returned by `load`.
    """
    own = self._process.state_dict()
    others = self.ranks.collect(b"" if self.ranks.is_first else pack(own))[1:]
    if self.ranks.is_first:
      checkpoint.write_checkpoint(Path(path), self._state([own, *map(unpack, others)], infos))

  def _state(self, ranks: list[dict[str, Any]], infos: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the content of a checkpoint with the states of processes."""
    state = self.alg.save()
    # rsl-rl's own loader continues at "iter", so this is the next iteration, not the last one.
    state |= {"iter": self.current_learning_iteration, "infos": infos}
    state["mjlab"] = {
      "format": checkpoint.FORMAT,
      "num_envs": self.env.num_envs,
      "shapes_seen": self._shapes_seen,
      "elapsed": self._elapsed,
      "total_steps": self._total_steps,
      **ranks[0],
      "other_ranks": ranks[1:],
    }
    return state

  def load(
    self,
    path: str,
    load_cfg: dict[str, bool] | None = None,
    strict: bool = True,
    map_location: str | None = None,
  ) -> dict[str, Any]:
    """Continue from a checkpoint of ours, or from the learner of one of rsl-rl's.

    Into another number of worlds than was saved, only the learner and the counters are restored, with a message.

    Args:
      path: Checkpoint file.
      load_cfg: Parts to load: names of `networks`, "optimizer", "iteration", "rnd"; None: everything, worlds included.
      strict: Require the same names in file and networks.
      map_location: Ignored; tensors are copied to the device of the learner.

    Returns:
      The values saved with it.

    Raises:
      FileError: It cannot be read, or its networks have other sizes or saw observations of other shapes; nothing
        has been changed then.
    """
    del map_location
    file = Path(path)
    with reading("checkpoint", file):
      state = checkpoint.read_checkpoint(file, self.agent_cfg.policy)
      wanted = [part for part in (*self.networks, "optimizer") if load_cfg is None or load_cfg.get(part)]
      self._check(file, state, wanted)
      worlds, infos = state.get("mjlab"), state.get("infos") or {}
      if self.alg.load(state, load_cfg, strict):
        # A file of rsl-rl's names the last iteration done.
        self.current_learning_iteration = int(state["iter"]) + (0 if worlds else 1)
      if "optimizer" in wanted and self.cfg["algorithm"].get("schedule", "fixed") == "fixed":
        # The optimiser's state has the old step size; with a fixed schedule the configuration decides.
        set_learning_rate(self.alg, self.cfg["algorithm"]["learning_rate"])
      if load_cfg is None and worlds:
        self._load_worlds(file, worlds)
      elif load_cfg is None:
        self.console.say(f"{path}: an rsl-rl checkpoint without world state; only the learner was restored.")
        # Curricula of mjlab 1.x depend on it.
        steps = (infos.get("env_state") or {}).get("common_step_counter")
        if steps is not None and (counter := getattr(self.env.unwrapped, "common_step_counter", None)) is not None:
          counter.fill_(steps)
          self.console.say(f"The environment's step counter continues at {steps}.")
      return infos

  def _check(self, path: Path, state: Mapping[str, Any], wanted: Sequence[str]) -> None:
    """Raise FileError unless the wanted parts of a checkpoint fit this learner."""
    if missing := [part for part in wanted if state.get(f"{part}_state_dict") is None]:
      lacks = f"no {' and no '.join(missing)} in it"
      raise FileError(f"checkpoint {path}: {lacks}; a new run can start from its policy (--init-from)")
    for part in wanted:
      saved = state[f"{part}_state_dict"]
      if part == "optimizer":
        checkpoint.refuse(f"checkpoint {path}", checkpoint.optimizer_problems(saved, self.alg.optimizer))
      else:
        self.check_network(path, part, saved, checkpoint.shapes_seen(state, part))
        checkpoint.check_finite(path, part, saved)

  def load_policy(self, path: Path) -> None:
    """Take only the weights of the policy in a checkpoint, of reinforcement learning or distillation.

    Raises:
      FileError: It cannot be read, it saw observations of other shapes, or the network has other sizes; nothing
        has been changed then.
    """
    name = self.agent_cfg.policy
    names = dict.fromkeys((name, "actor", "student"))
    state = checkpoint.read_checkpoint(path, *names)
    found = next(name for name in names if f"{name}_state_dict" in state)
    weights = state[f"{found}_state_dict"]
    self.check_network(path, name, weights, checkpoint.shapes_seen(state, found))
    self.networks[name].load_state_dict(weights)

  def check_network(
    self,
    path: Path,
    name: str,
    weights: Mapping[str, Any],
    shapes: checkpoint.Shapes | None,
    network: torch.nn.Module | None = None,
  ) -> None:
    """Compare a network of a checkpoint, and the observation shapes of its training, with one of this run.

    `network` is a part of the network of this name, such as one of several teachers.

    Raises:
      FileError: They differ.
    """
    present = (network or self.networks[name]).state_dict()
    problems = [
      *checkpoint.shape_problems(self.agent_cfg.obs_groups[name], shapes, self._shapes_seen[name]),
      *checkpoint.network_problems(name, weights, present),
    ]
    fields = f"agent.{name}.hidden_dims and agent.{name}.obs_normalization"
    hint = f". Observations, actions, {fields} must be those of its training"
    checkpoint.refuse(f"checkpoint {path}", problems, hint)

  def _load_worlds(self, path: Path, state: dict[str, Any]) -> None:
    reason = self._process.load([state, *state.get("other_ranks", [])], state["num_envs"], self.ranks)
    if reason:
      self.console.say(f"{path}: world state was not restored: {reason}. Learner and counters were.")
    self.is_world_state_restored = not reason
    self._elapsed = state["elapsed"]
    self._total_steps = state["total_steps"]

  def _collect(self, obs: TensorDict) -> TensorDict:
    # On a CPU physics has its own threads.
    threads = 1 if self._torch_device.type == "cpu" else torch.get_num_threads()
    with set_for_now(torch.get_num_threads, torch.set_num_threads, threads):
      for _ in range(self.agent_cfg.num_steps_per_env):
        obs, rewards, dones = self._step(obs)
        self.statistics.add(rewards, dones)
        if self.after_step is not None:
          self.after_step()
        self.patience.progress()
    if self._torch_device.type == "cuda":
      torch.cuda.synchronize(self._torch_device)
    return obs

  # Not inference mode: the environment could not write later to tensors that it makes there.
  @torch.no_grad()
  def _step(self, obs: TensorDict) -> tuple[TensorDict, torch.Tensor, torch.Tensor]:
    """Make one step of all worlds for the learner; return observations, rewards and dones."""
    obs, rewards, dones, extras = self.env.step(self.alg.act(obs))
    self.alg.process_env_step(obs, rewards, dones, extras)
    return obs, rewards, dones

  def _update(self, obs: TensorDict) -> dict[str, float]:
    with torch.no_grad():
      self.alg.compute_returns(obs)
    held = actor_held(self.alg) if self._is_warming_up else contextlib.nullcontext()
    with held, self._update_precision():
      losses = self.alg.update()
    if self._is_warming_up:
      self._averages.forget(self.networks["actor"])
    return losses | {"learning_rate": self.alg.learning_rate}

  def _update_precision(self) -> contextlib.AbstractContextManager[None]:
    """Set the precision of matrix products on a GPU while entered; the environment needs full float32."""
    get, set_to = torch.get_float32_matmul_precision, torch.set_float32_matmul_precision
    return set_for_now(get, set_to, self.agent_cfg.matmul_precision if self._torch_device.type == "cuda" else get())

  @property
  def _is_warming_up(self) -> bool:
    cfg = self.agent_cfg
    return isinstance(cfg, RslRlOnPolicyRunnerCfg) and self.current_learning_iteration < cfg.critic_warmup
