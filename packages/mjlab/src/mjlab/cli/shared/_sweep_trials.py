"""Trials of `sweep`, in processes of Ray Tune. Needs the extra `sweep`."""

import os
import random
import shutil
import socket
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mjlab_rl
import msgspec
from mjlab_core import MjlabError
from mjlab_rl import Console

from mjlab import environments
from mjlab.cli.shared._sweep_space import Range, Scalar, Space, Sweep, Trial, trial_flags
from mjlab.registry import load_task

if TYPE_CHECKING:
  from mjlab_rl.reports.scalar_log import IterationReport

# Statistics of use are not sent, and processes have the environment of this one, also under `uv run`.
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
# Otherwise Ray prints its own tables.
os.environ.setdefault("RAY_AIR_NEW_OUTPUT", "0")

import ray  # pyright: ignore[reportMissingImports]  # ty: ignore[import-not-found]
from ray import tune  # pyright: ignore[reportMissingImports]  # ty: ignore[import-not-found]
from ray.tune.schedulers import (  # pyright: ignore[reportMissingImports]  # ty: ignore[import-not-found]
  ASHAScheduler,
  PopulationBasedTraining,
)
from ray.tune.search.basic_variant import (  # pyright: ignore[reportMissingImports]  # ty: ignore[import-not-found]
  BasicVariantGenerator,
)

# A restarted trial numbers its checkpoints from zero, so Ray may put one into the folder of another.
_CHECKPOINT, _REPORT = "model.pt", "report.json"
# Time for a cluster to answer [s].
_REACHED = 10.0


class _Progress(tune.Callback):
  """One line for every trial that ends."""

  def on_trial_complete(self, iteration: int, trials: list[Any], trial: Any, **info: Any) -> None:
    ended = sum(other is trial or other.status in ("TERMINATED", "ERROR") for other in trials)
    reward = (trial.last_result or {}).get("reward")
    print(f"trial {trial.trial_id} ended: reward {reward}; {ended} of {len(trials)} are done", flush=True)

  def on_trial_error(self, iteration: int, trials: list[Any], trial: Any, **info: Any) -> None:
    print(f"trial {trial.trial_id} failed: {trial.error_file}", flush=True)


def run_trials(sweep: Sweep, folder: Path, address: str | None, *, is_resumed: bool) -> list[Trial]:
  """Run or continue the trials of a sweep; return their results.

  Raises:
    MjlabError: There is no such cluster.
  """
  random.seed(sweep.seed)  # From which pbt draws.
  _connect(address)
  try:
    function = tune.with_parameters(train_trial, sweep=msgspec.json.encode(sweep), folder=folder)
    trainable = tune.with_resources(function, {"cpu": sweep.cpus, "gpu": sweep.gpus})
    if is_resumed and tune.Tuner.can_restore(str(folder)):
      tuner = tune.Tuner.restore(str(folder), trainable, resume_errored=True)
    else:
      tuner = _tuner(sweep, trainable, folder)
    return [_result(found, sweep.space) for found in tuner.fit()]
  finally:
    ray.shutdown()


def _connect(address: str | None) -> None:
  """Connect to a cluster, or start Ray on this machine."""
  host, _, port = (address or "").removeprefix("ray://").rpartition(":")
  try:
    if port.isdigit():
      # Ray itself tries for minutes.
      socket.create_connection((host, int(port)), _REACHED).close()
    own: dict[str, Any] = {"include_dashboard": False} if address is None else {}
    ray.init(address=address or "local", log_to_driver=False, configure_logging=False, **own)
  except (OSError, ValueError) as error:
    # Errors of the operating system have a number; they do not concern tokens.
    is_refused = getattr(error, "errno", None) is None and "RAY_AUTH_MODE" not in os.environ
    token = "; a cluster with a token needs RAY_AUTH_MODE=token" if port.isdigit() and is_refused else ""
    raise MjlabError(f"--address {address}: {error}{token}") from error


def _tuner(sweep: Sweep, trainable: Any, folder: Path) -> Any:
  """Return the tuner of a new sweep."""
  return tune.Tuner(
    trainable,
    param_space={name: _domain(values) for name, values in sweep.space.values.items()},
    tune_config=tune.TuneConfig(
      metric="reward",
      mode="max",
      num_samples=sweep.trials,
      scheduler=_scheduler(sweep),
      search_alg=BasicVariantGenerator(random_state=sweep.seed),
      # The libraries of a process that ends a trial, or a part of one, serve the next.
      reuse_actors=True,
      trial_name_creator=lambda trial: trial.trial_id,
      trial_dirname_creator=lambda trial: trial.trial_id,
    ),
    run_config=tune.RunConfig(
      name=folder.name,
      storage_path=str(folder.parent),
      verbose=0,
      callbacks=[_Progress()],
      checkpoint_config=tune.CheckpointConfig(num_to_keep=4),
    ),
  )


def _domain(values: list[Scalar] | Range) -> Any:
  if not isinstance(values, Range):
    return tune.choice(values)
  return (tune.loguniform if values.log else tune.uniform)(values.low, values.high)


def _interval(sweep: Sweep) -> int:
  """Return the iterations between two decisions about a trial."""
  return max(1, sweep.max_iterations // 10)


def _scheduler(sweep: Sweep) -> Any:
  """Return the scheduler; pbt gets the domains of the named values only, so that it changes no other."""
  if sweep.scheduler == "asha":
    return ASHAScheduler("iteration", max_t=sweep.max_iterations, grace_period=_interval(sweep))
  if sweep.scheduler == "pbt":
    domains = ((name, sweep.space.values[name]) for name in sweep.space.perturb)
    changed = {name: _domain(values) if isinstance(values, Range) else values for name, values in domains}
    return PopulationBasedTraining(
      "iteration", perturbation_interval=_interval(sweep), hyperparam_mutations=changed, quantile_fraction=0.25
    )
  return None


def _result(found: Any, space: Space) -> Trial:
  metrics = found.metrics or {}
  values = {name: (found.config or {}).get(name, "") for name in space.values}
  state = "failed" if found.error else "done" if metrics.get("done") else "stopped"
  name = metrics.get("trial_id") or Path(found.path).name
  return Trial(name, values, metrics.get("reward", float("nan")), metrics.get("iteration", 0), state)


def train_trial(values: dict[str, Scalar], sweep: bytes, folder: Path) -> None:
  """Train one trial, from the checkpoint that Ray gives it if there is one, in a folder of its name."""
  from mjlab.cli.shared._flags import parse

  wanted = msgspec.json.decode(sweep, type=Sweep)
  device = environments.resolve_device("cuda" if wanted.gpus else "cpu")
  task = load_task(wanted.task)
  task.env.scene.num_envs = environments.default_num_envs(device, task.env.scene.num_envs)
  task = parse(task, [*wanted.flags, *trial_flags(values)])
  task.agent.save_interval, task.agent.logger = _interval(wanted), "none"
  console, reports = Console("quiet"), _Reports()
  console.on_report.append(reports.keep)

  def on_ready(env: Any, directory: Path | None) -> Callable[[], None]:
    reports.directory = directory
    for name in wanted.space.perturb:
      if name.startswith("env.rewards."):
        # The restored worlds have the weights of the trial that they come from.
        env.reward_manager.weight(name.split(".")[2].replace("-", "_")).fill_(float(values[name]))
    return reports.send

  with tempfile.TemporaryDirectory() as place:
    resume = None
    if (checkpoint := tune.get_checkpoint()) is not None:
      resume = Path(checkpoint.to_directory(place)) / _CHECKPOINT
      copied = msgspec.json.decode(resume.with_name(_REPORT).read_bytes(), type=dict[str, int | float])
      if copied["iteration"] >= task.agent.max_iterations:
        # In pbt a trial may copy one that has ended.
        tune.report(copied)
        return
    mjlab_rl.train(
      task,
      name=wanted.task,
      make_env=environments.standard_env,
      device=device,
      log_root=folder / tune.get_context().get_trial_id(),
      resume=resume,
      console=console,
      on_ready=on_ready,
    )
    reports.send()


class _Reports:
  """Reports to Ray, each with the checkpoint that is written after it.

  Ray may end or copy a trial at any report; without that checkpoint the iterations since the one before would be lost.
  """

  def __init__(self) -> None:
    self.directory: Path | None = None
    """Run directory."""
    self._pending: dict[str, float] | None = None

  def keep(self, report: "IterationReport") -> None:
    """Keep the reward of an iteration."""
    if report.mean_reward is not None:
      iteration = report.iteration + 1
      self._pending = {"reward": report.mean_reward, "iteration": iteration, "steps": report.total_steps}

  def send(self) -> None:
    """Report the kept values to Ray, with the checkpoint of that iteration if there is one."""
    if (metrics := self._pending) is None or self.directory is None:
      return
    self._pending = None
    path = self.directory / f"model_{metrics['iteration']}.pt"
    if not path.exists():
      tune.report(metrics)
      return
    with tempfile.TemporaryDirectory() as place:
      shutil.copy(path, Path(place) / _CHECKPOINT)
      (Path(place) / _REPORT).write_bytes(msgspec.json.encode(metrics))
      tune.report(metrics, checkpoint=tune.Checkpoint.from_directory(place))
