"""One training run from configuration to checkpoint."""

import copy
import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from mjlab_core import seed_everything

from mjlab_rl.config import ConfigError, RslRlBaseRunnerCfg, RslRlDistillationRunnerCfg
from mjlab_rl.console import Console
from mjlab_rl.distillation import MjlabDistillationRunner, runner_class
from mjlab_rl.env_protocol import RlEnv
from mjlab_rl.manifest import RunManifest, encode_manifest, git_state, package_versions, write_manifest
from mjlab_rl.run_directory import create_run_directory
from mjlab_rl.runner import MjlabOnPolicyRunner
from mjlab_rl.task import TaskCfg
from mjlab_rl.trained_policy import TrainedPolicy, read_trained_policy
from mjlab_rl.vec_env import RslRlVecEnvWrapper


@dataclass(kw_only=True)
class TrainingResult:
  """How a run ended."""

  directory: Path | None
  """Run directory; None where nothing was written."""
  iterations: int
  """Iterations done in all, those before a resume included."""
  checkpoint: Path | None
  """The last checkpoint."""
  stopped_by: str | None
  """Signal that ended it early, such as "SIGINT"; None where it ran to its end."""


def train(
  task: TaskCfg[Any],
  *,
  name: str,
  make_env: Callable[..., RlEnv],
  device: str = "cpu",
  log_root: str | os.PathLike[str] | None = "logs",
  resume: Path | None = None,
  teacher: Path | None = None,
  init_from: Path | None = None,
  console: Console | None = None,
  command: list[str] | None = None,
  code: Path | None = None,
  on_ready: Callable[[RlEnv, Path | None], None] | None = None,
  watch: Callable[[RlEnv, Path | None], Callable[[], None]] | None = None,
) -> TrainingResult:
  """Train a task.

  The run directory is made once the environment stands, so a configuration that cannot be built leaves nothing behind.

  Args:
    task: What to train; not changed.
    name: Task id, for the manifest.
    make_env: Builds the environment, called as make_env(cfg, device=device); `task.make_env` wins.
    device: Device of environment and learner, such as "cuda:0".
    log_root: Folder of all experiments; None: write nothing.
    resume: Checkpoint to continue from, up to `task.agent.max_iterations` in all.
    teacher: Checkpoint of the policy to imitate, where `task.agent` distils one; a run that is resumed has its own.
    init_from: Checkpoint whose policy, by reinforcement or distilled, this one is in the beginning, with its normaliser
      and the deviation of its actions; all else begins anew.
    console: Where progress is shown; None: standard output.
    command: Command line, for the manifest.
    code: A file of the task's own code, whose commit goes into the manifest.
    on_ready: Called with the environment and the run directory before the first iteration.
    watch: Called with them then, too; what it returns is called after every step.

  Raises:
    ManifestError: The configuration cannot be written down.
    ConfigError: The learner configuration cannot work.
    CheckpointError: A checkpoint does not fit.
  """
  console = console if console is not None else Console()
  env_cfg, agent = copy.deepcopy(task.env), copy.deepcopy(task.agent)
  teaching = _teacher(agent, env_cfg, teacher, resume)
  beginning = _beginning(agent, env_cfg, init_from, resume)
  agent.to_rsl_rl()
  if getattr(env_cfg, "seed", None) is None:
    env_cfg.seed = agent.seed
  manifest = RunManifest(
    task=name,
    env=copy.deepcopy(env_cfg),
    agent=copy.deepcopy(agent),
    runner=task.runner,
    make_env=task.make_env,
    play=task.play,
    seed=agent.seed,
    device=device,
    created=datetime.now().astimezone().isoformat(timespec="seconds"),
    command=list(command or []),
    resumed_from=None if resume is None else str(resume.resolve()),
    teacher=None if teaching is None else teaching.record,
    init_from=None if beginning is None else beginning.record,
    versions=package_versions(),
    git=None if code is None else git_state(code),
  )
  if log_root is not None:
    encode_manifest(manifest)

  seed_everything(agent.seed)
  env = (task.make_env or make_env)(env_cfg, device=device)
  try:
    wrapped = RslRlVecEnvWrapper(env, clip_actions=agent.clip_actions)
    kind: type[MjlabOnPolicyRunner] = task.runner or runner_class(agent)
    runner = kind(wrapped, agent, None, device, console=console)
    if resume is not None:
      runner.load(str(resume))
    if beginning is not None:
      runner.load_policy(beginning.path)
    if teaching is not None:
      if not isinstance(runner, MjlabDistillationRunner):
        raise ConfigError(f"the task's runner is {kind.__name__}, which is no MjlabDistillationRunner")
      runner.load_teacher(teaching)
    remaining = agent.max_iterations - runner.current_learning_iteration
    if remaining <= 0:
      raise ConfigError(
        f"{resume} has {runner.current_learning_iteration} iterations, agent.max_iterations is {agent.max_iterations}; "
        "nothing is left to do. Raise --agent.max-iterations."
      )
    directory: Path | None = None
    if log_root is not None:
      directory = create_run_directory(Path(log_root), agent.experiment_name, agent.run_name)
      write_manifest(directory, manifest)
      runner.log_dir = env.output_dir = directory
    if on_ready is not None:
      on_ready(env, directory)
    if watch is not None:
      runner.after_step = watch(env, directory)
    runner.learn(remaining, init_at_random_ep_len=not runner.is_world_state_restored)
    return TrainingResult(
      directory=directory,
      iterations=runner.current_learning_iteration,
      checkpoint=runner.checkpoint_path() if directory is not None else None,
      stopped_by=runner.stopped_by,
    )
  finally:
    env.close()


def _teacher(agent: RslRlBaseRunnerCfg, env: Any, teacher: Path | None, resume: Path | None) -> TrainedPolicy | None:
  """The teacher of a distillation; `agent` is told what its network is."""
  if not isinstance(agent, RslRlDistillationRunnerCfg):
    if teacher is not None:
      raise ConfigError(f"a teacher is given, {teacher}, but the learner is no RslRlDistillationRunnerCfg")
    return None
  if teacher is not None and resume is not None:
    raise ConfigError(f"a teacher is given, {teacher}, but {resume} has its own")
  path = teacher or resume
  if path is None:
    raise ConfigError("a distillation needs a teacher: the checkpoint of a trained policy")
  found = read_trained_policy(path, resumed=resume is not None)
  found.check(env, agent)
  agent.teacher = copy.deepcopy(found.network(agent))
  return found


def _beginning(
  agent: RslRlBaseRunnerCfg, env: Any, init_from: Path | None, resume: Path | None
) -> TrainedPolicy | None:
  """The trained policy that this one is in the beginning."""
  if init_from is None:
    return None
  if resume is not None:
    raise ConfigError(f"a policy to begin as is given, {init_from}, but {resume} has its own")
  found = read_trained_policy(init_from)
  found.check_beginning(env, agent)
  return found
