"""One training run from configuration to checkpoint."""

import contextlib
import copy
import dataclasses
import os
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from mjlab_core import seed_everything
from mjlab_core.errors import ConfigError

from mjlab_rl.bundles.newest_bundle import NewestBundle
from mjlab_rl.config import RslRlDistillationRunnerCfg, TaskCfg
from mjlab_rl.env_protocol import RlEnv
from mjlab_rl.onpolicy.distillation import MjlabDistillationRunner, runner_class
from mjlab_rl.processes.ranks import Ranks
from mjlab_rl.reports.console import Console
from mjlab_rl.runner import MjlabOnPolicyRunner
from mjlab_rl.runs.manifest import RunManifest, encode_manifest, git_state, package_versions, write_manifest
from mjlab_rl.runs.run_directory import create_run_directory
from mjlab_rl.trained_policy import TrainedPolicy, read_trained_policy
from mjlab_rl.vec_env import RslRlVecEnvWrapper


@dataclasses.dataclass(kw_only=True)
class TrainingResult:
  """End of a run."""

  directory: Path | None
  """Run directory; None if nothing was written."""
  iterations: int
  """Iterations in all, including those before a resume."""
  checkpoint: Path | None
  """The last checkpoint."""
  stopped_by: str | None
  """Signal that ended it early, such as "SIGINT"; None if it ran to its end."""


def train(
  task: TaskCfg[Any],
  *,
  name: str,
  make_env: Callable[..., RlEnv],
  device: str = "cpu",
  log_root: str | os.PathLike[str] | None = "logs",
  resume: Path | None = None,
  teacher: Path | Sequence[Path] | None = None,
  init_from: Path | None = None,
  console: Console | None = None,
  command: list[str] | None = None,
  code: Path | None = None,
  rank_timeout: float | None = 20.0,
  on_ready: Callable[[RlEnv, Path | None], Callable[[], None] | None] | None = None,
) -> TrainingResult:
  """Train a task.

  The run directory is made after the environment, so a configuration that cannot be built leaves no files.

  Args:
    task: Task to train; not changed.
    name: Task id, for the manifest.
    make_env: Environment factory, called as make_env(cfg, device=device); `task.make_env` takes precedence.
    device: Device of environment and learner, such as "cuda:0".
    log_root: Folder of all experiments; None: write nothing.
    resume: Checkpoint to continue from, up to `task.agent.max_iterations` in all.
    teacher: Checkpoint of the policy to imitate in a distillation, or of several that share the worlds. A resumed run
      keeps its teachers.
    init_from: Checkpoint of the policy to start from, with its normaliser and standard deviation of actions. The
      optimiser, the critic and the counters start from the beginning.
    console: Output of progress; None: standard output.
    command: Command line, for the manifest.
    code: File of the task's code; its commit goes into the manifest.
    rank_timeout: Time after which several processes end if one of them makes no progress [s]; None: never.
    on_ready: Called with the environment and the run directory before the first iteration. It may return a function,
      which is called after every step.

  Raises:
    ConfigError: The configuration cannot be written to a manifest, or the learner cannot work.
    FileError: A checkpoint does not fit.
  """
  ranks = Ranks.launched()
  device = ranks.device(device)
  console = (console if console is not None else Console()) if ranks.is_first else Console("quiet")
  task = dataclasses.replace(task, env=copy.deepcopy(task.env), agent=copy.deepcopy(task.agent))
  agent, env_cfg = task.agent, task.env
  teachers = [teacher] if isinstance(teacher, Path) else list(teacher or ())
  if resume is not None and (teachers or init_from is not None):
    raise ConfigError(f"a resumed run keeps its {'teacher' if teachers else 'policy'}: {resume}")
  teaching = _teachers(task, teachers, resume)
  beginning = None if init_from is None else read_trained_policy(init_from)
  if beginning is not None:
    beginning.check_beginning(task.env, agent)
  agent.to_rsl_rl()
  kind: type[MjlabOnPolicyRunner] = task.runner or runner_class(agent)
  if teaching and not issubclass(kind, MjlabDistillationRunner):
    raise ConfigError(f"the task's runner is {kind.__name__}; a distillation needs a MjlabDistillationRunner")
  if getattr(env_cfg, "seed", None) is None:
    env_cfg.seed = agent.seed
  manifest = _manifest(task, name, teaching, beginning, resume)
  manifest.device, manifest.command = device, list(command or [])
  manifest.git = None if code is None else git_state(code)
  if log_root is not None:
    encode_manifest(manifest)
  agent.prepare_env(env_cfg)

  with contextlib.ExitStack() as stack:
    stack.enter_context(ranks.joined(device))
    seed_everything(ranks.seed(agent.seed))
    env_cfg.seed = ranks.seed(env_cfg.seed)
    env = (task.make_env or make_env)(env_cfg, device=device)
    stack.callback(env.close)
    runner = kind(RslRlVecEnvWrapper(env, clip_actions=agent.clip_actions), agent, None, device, console=console)
    remaining = _load(runner, resume, teaching, beginning)
    directory: Path | None = None
    if log_root is not None and ranks.is_first:
      directory = create_run_directory(Path(log_root), agent.experiment_name, agent.run_name)
      write_manifest(directory, manifest)
      env.output_dir = directory
      runner.after_save = NewestBundle(env, agent, name, lambda: runner.networks[agent.policy], console)
    # All processes have its name: one that fails saves the learner there.
    runner.log_dir = ranks.gather(directory)[0]
    runner.patience.seconds = rank_timeout
    if on_ready is not None:
      runner.after_step = on_ready(env, directory)
    runner.learn(remaining, init_at_random_ep_len=not runner.is_world_state_restored)
    return TrainingResult(
      directory=directory,
      iterations=runner.current_learning_iteration,
      checkpoint=runner.checkpoint_path() if directory is not None else None,
      stopped_by=runner.stopped_by,
    )


def _teachers(task: TaskCfg[Any], given: Sequence[Path], resume: Path | None) -> list[TrainedPolicy]:
  """Read the teachers of a distillation, or a resumed one, and put their network into the configuration."""
  agent = task.agent
  if not isinstance(agent, RslRlDistillationRunnerCfg):
    if given:
      raise ConfigError(f"teacher {given[0]}: only a RslRlDistillationRunnerCfg has a teacher")
    return []
  if not given and resume is None:
    raise ConfigError("a distillation needs a teacher, the checkpoint of a trained policy")
  if resume is None:
    teaching = [read_trained_policy(path) for path in given]
    agent.num_teachers = len(teaching)
  else:
    teaching = [read_trained_policy(resume, resumed=True)]
    if teaching[0].run is not None and isinstance(teaching[0].run.agent, RslRlDistillationRunnerCfg):
      agent.num_teachers = teaching[0].run.agent.num_teachers
  for found in teaching:
    found.check(task.env, agent)
    agent.teacher = copy.deepcopy(found.network(agent))
  return teaching


def _manifest(
  task: TaskCfg[Any],
  name: str,
  teaching: Sequence[TrainedPolicy],
  beginning: TrainedPolicy | None,
  resume: Path | None,
) -> RunManifest:
  """Return the manifest of a run that begins now."""
  teachers = [found.record for found in teaching if found.record is not None]
  if resume is not None and teaching and teaching[0].run is not None:
    teachers += teaching[0].run.more_teachers
  return RunManifest(
    task=name,
    env=copy.deepcopy(task.env),
    agent=copy.deepcopy(task.agent),
    runner=task.runner,
    make_env=task.make_env,
    play=task.play,
    seed=task.agent.seed,
    created=datetime.now().astimezone().isoformat(timespec="seconds"),
    launch=os.environ.get("TORCHELASTIC_RUN_ID", ""),
    resumed_from=None if resume is None else str(resume.resolve()),
    teacher=teachers[0] if teachers else None,
    more_teachers=teachers[1:],
    init_from=None if beginning is None else beginning.record,
    versions=dict(package_versions()),
  )


def _load(
  runner: MjlabOnPolicyRunner, resume: Path | None, teaching: Sequence[TrainedPolicy], beginning: TrainedPolicy | None
) -> int:
  """Load the checkpoints of a run; return the remaining iterations."""
  if resume is not None:
    runner.load(str(resume))
  elif teaching and isinstance(runner, MjlabDistillationRunner):
    runner.load_teacher(*teaching)
  if beginning is not None:
    runner.load_policy(beginning.path)
  done, most = runner.current_learning_iteration, runner.agent_cfg.max_iterations
  if done >= most:
    raise ConfigError(f"{resume} has {done} iterations: raise --agent.max-iterations, which is {most}")
  return most - done
