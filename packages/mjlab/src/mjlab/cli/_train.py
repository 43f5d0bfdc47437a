"""`train TASK [flags]`: build the task, apply the flags, train."""

import contextlib
import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mjlab_rl
from mjlab_core import UnknownNameError, UsageError, nearest
from mjlab_core.constraints import PositiveCount
from mjlab_core.errors import DivergedError
from mjlab_rl import Console, RslRlDistillationRunnerCfg, find_checkpoint, with_agent
from mjlab_rl.runs.manifest import package_versions
from mjlab_viewer import check_address

from mjlab import environments
from mjlab.cli.shared._command_line import CommandLine, Loaded, TaskArguments, TaskLine, as_usage, building, take
from mjlab.cli.shared._launch import launch, restarted_from
from mjlab.cli.shared._policies import manifest_of
from mjlab.cli.shared._watching import watch
from mjlab.registry import list_tasks, load_task, task_file


@dataclass(kw_only=True)
class Arguments(TaskArguments):
  """All that can be given after the task."""

  device: str = "auto"
  """Device of simulation and learning: cpu, cuda:0, or auto for a GPU if there is one."""
  gpus: str | None = None
  """GPUs of each host, with one process each: all, a number, or a list such as 0,1 (one GPU: 0,). With --device cpu a
  number of processes."""
  hosts: str | None = None
  """Hosts to train on, such as a,b, reached by ssh; the current folder must exist on all of them."""
  dry_run: bool = False
  """Print processes, devices, environments and the torchrun command of --gpus and --hosts; train nothing."""
  max_restarts: int = 0
  """With --gpus: how often to start all processes again, from the newest checkpoint, after one has failed."""
  rank_timeout: float = 20.0
  """Time after which several processes end if one of them makes no progress [s]; 0: never."""
  seed: int | None = None
  """Seed of learner and environment; None: the seed of the task."""
  resume: str | None = None
  """Run to continue, with its configuration and the flags given here: latest (of this task; also without a value),
  the name or directory of a run, or a checkpoint file."""
  teacher: tuple[str, ...] = ()
  """Policy to imitate, in distillation tasks: latest (of the teacher's task; also if it is not given), a task (its
  latest run), the name or directory of a run, or a checkpoint file. Several share the environments."""
  init_from: str | None = None
  """Policy to start from, also a distilled one: latest or the name of a run of this task's experiment, a task (its
  latest run), the directory of a run, or a checkpoint file. Only the policy is taken over."""
  log_root: str = "logs"
  """Folder of all runs."""
  viewer: bool = False
  """Show the environments in a browser during training."""
  viewer_host: str = "127.0.0.1"
  """Address that the viewer listens on; 0.0.0.0 lets other machines connect."""
  viewer_port: int = 8080
  """Port of the viewer; the next free one if it is taken."""
  video: bool = False
  """Film four environments at intervals, into the run directory."""
  video_interval: PositiveCount = 2000
  """Steps from the start of one film to the start of the next."""
  video_length: PositiveCount = 200
  """Steps of a film."""
  verbose: bool = False
  """Show all values of every iteration."""
  quiet: bool = False
  """Show errors only."""
  agent: Any = None
  """Configuration of the learner."""


def _load(name: str, words: list[str]) -> Loaded:
  """Load a task with the learner of `--agent NAME`; a bare `--resume` means the latest run.

  Raises:
    UsageError: There is no such learner, or a run with another one is resumed.
  """
  resume, given = take(words, "--resume", nargs="?", const="latest")
  given += [] if resume is None else ["--resume", resume]
  learner, flags = take(given, "--agent")
  task = load_task(name)
  if learner is not None:
    if resume is not None:
      raise UsageError("--agent and --resume exclude each other: a resumed run keeps its learner")
    with as_usage("--agent"):
      task = with_agent(task, learner)
  return task, given, flags


def run(words: list[str]) -> int:
  """Train; return the exit code."""
  if not words or not words[0].startswith("--tyro-"):
    return _train(words)
  from mjlab.cli.shared._flags import print_completion

  tasks = {name: load_task(name) for name in list_tasks()}
  configs = {name: Arguments(agent=task.agent, env=task.env) for name, task in tasks.items()}
  print_completion(configs, prog="train", words=words)
  return 0


@CommandLine(
  "train",
  "TASK",
  Arguments,
  notes="""\
  --agent NAME              Learner: ppo (or what the task has), flashsac or fastsac.
  --agent.PATH VALUE        Any value of the learner, e.g. --agent.max-iterations 10_000.
  --help WORD               After a task: its flags, all or those that have WORD in their names.

train --tyro-print-completion SHELL prints the completion for bash, zsh, tcsh or fish.
""",
  load=_load,
)
def _train(wanted: Arguments, line: TaskLine) -> int:
  """Train a policy."""
  from mjlab_rl.processes.ranks import Ranks

  _check_combinations(wanted)
  if wanted.gpus is not None or wanted.hosts is not None or wanted.dry_run:
    return launch(wanted, line)
  name, task, ranks = line.name, line.task, Ranks.launched()
  console = Console("quiet" if wanted.quiet or not ranks.is_first else "verbose" if wanted.verbose else "normal")
  device = ranks.device(environments.resolve_device(wanted.device))
  experiment = wanted.agent.experiment_name
  restarted = restarted_from(Path(wanted.log_root), experiment)
  checkpoint = restarted
  if checkpoint is None and wanted.resume is not None:
    checkpoint = _checkpoint(wanted.resume, wanted, experiment, name)
  run = None if checkpoint is None else manifest_of(checkpoint, name, console.say)
  default = None
  if run is None:
    default = task.env.scene.num_envs = environments.default_num_envs(device, task.env.scene.num_envs)
  else:
    task = replace(task, env=run.env, agent=run.agent, runner=run.runner, make_env=run.make_env)
  # Again, with the configuration of the run as the default.
  wanted = line.parse(agent=task.agent, env=task.env)
  if restarted is not None:
    wanted.resume, wanted.init_from, wanted.seed = str(restarted), None, None
  if wanted.seed is not None:
    wanted.agent.seed = wanted.env.seed = wanted.seed
  teachers = _teachers(wanted, name)
  beginning = None if wanted.init_from is None else _checkpoint(wanted.init_from, wanted, wanted.agent.experiment_name)
  hint = " (--env.scene.num-envs sets it)" if wanted.env.scene.num_envs == default else ""
  console.say(_place_line(name, wanted.env, device, ranks.world_size, hint))
  known = {"continuing from": checkpoint, "imitating": ", ".join(map(str, teachers)), "starting from": beginning}
  for what, found in known.items():
    if found:
      console.say(f"{what} {found}")
  options = {
    "task": replace(task, env=wanted.env, agent=wanted.agent),
    "device": device,
    "resume": checkpoint,
    "teacher": teachers,
    "init_from": beginning,
    "command": ["train", name, *line.given],
  }
  try:
    return _run(name, wanted, console, is_watched=ranks.is_first, is_from_file=run is not None, **options)
  except DivergedError:
    if ranks.is_first:
      raise
    return 1  # The first process reports it.


def _check_combinations(wanted: Arguments) -> None:
  for flag, kept in (("teacher", "its teacher"), ("init_from", "its policy"), ("seed", "its random numbers")):
    if wanted.resume is not None and getattr(wanted, flag) not in (None, ()):
      raise UsageError(f"--{flag.replace('_', '-')} and --resume exclude each other: a resumed run keeps {kept}")
  if wanted.video and wanted.video_length > wanted.video_interval:
    raise UsageError(f"--video-length must be at most --video-interval, {wanted.video_interval}")


def _run(
  name: str, wanted: Arguments, console: "Console", *, is_watched: bool, is_from_file: bool, **options: Any
) -> int:
  """Train with viewers and films, and print the result; return the exit code."""
  if wanted.viewer:
    check_address(wanted.viewer_host, wanted.viewer_port)
  opened = contextlib.ExitStack()
  is_built = False

  def on_ready(env: "mjlab_rl.RlEnv", directory: Path | None) -> Callable[[], None] | None:
    nonlocal is_built
    is_built = True
    console.say(_environment_line(env))
    console.say(_versions_line())
    if console.is_verbose and (describe := getattr(env, "describe", None)) is not None:
      console.say(describe())
    console.say(f"run directory {directory}")
    is_shown = is_watched and (wanted.viewer or wanted.video)
    return watch(wanted, name, console, opened, env, directory) if is_shown else None

  try:
    result = mjlab_rl.train(
      name=name,
      make_env=environments.standard_env,
      log_root=wanted.log_root,
      console=console,
      code=task_file(name),
      # A viewer can pause the training.
      rank_timeout=None if wanted.viewer else wanted.rank_timeout or None,
      on_ready=on_ready,
      **options,
    )
  except Exception as error:
    if is_built:
      raise
    with building(from_file=is_from_file):
      raise error
  finally:
    opened.close()
  if result.stopped_by is None:
    console.say(f"done: {result.iterations} iterations, {result.checkpoint}")
  else:
    console.say(f"stopped ({result.stopped_by}) after {result.iterations} iterations; saved {result.checkpoint}")
    console.say(f"continue with: {shlex.join(['train', name, '--resume', str(result.directory)])}")
  return 0


def _teachers(wanted: Arguments, task: str) -> list[Path]:
  """Return the checkpoints of the policies to imitate; none if the task imitates none, or if a run is resumed."""
  agent = wanted.agent
  if not isinstance(agent, RslRlDistillationRunnerCfg):
    if wanted.teacher:
      raise UsageError(f"--teacher applies to distillation tasks only; {task} is not one")
    return []
  if wanted.resume is not None:
    return []
  names = wanted.teacher or ("latest",)
  if agent.teacher_task is None and "latest" in names:
    raise UsageError(f"{task} needs a teacher: give its run or checkpoint with --teacher")
  experiment = (agent if agent.teacher_task is None else load_task(agent.teacher_task).agent).experiment_name
  try:
    return [_checkpoint(name, wanted, experiment, agent.teacher_task) for name in names]
  except UnknownNameError as error:
    train_one = f". Train one with `train {agent.teacher_task}`" if names == ("latest",) else ""
    raise UsageError(f"no teacher: {error}{train_one}") from error


def _checkpoint(named: str, wanted: Arguments, experiment: str, task: str | None = None) -> Path:
  """Return the checkpoint that `find_checkpoint` finds for a name, or that of the latest run of a task of this name."""
  if named in list_tasks():
    named, experiment, task = "latest", load_task(named).agent.experiment_name, named
  try:
    return find_checkpoint(named, log_root=Path(wanted.log_root), experiment=experiment, task=task)
  except UnknownNameError as error:
    close = nearest(named, list_tasks(), 1)
    raise UnknownNameError(f"{error}. Nearest task: {close[0]}" if close else str(error)) from error


def _place_line(name: str, env: Any, device: str, processes: int, hint: str) -> str:
  import torch

  count = env.scene.num_envs
  place = f"{environments.cpu_cores()} cores" if device == "cpu" else torch.cuda.get_device_name(device)
  each = f" in each of {processes} processes" if processes > 1 else ""
  return f"{name}: {count} environment{'s' * (count != 1)}{each}{hint} on {device} ({place})"


def _environment_line(env: Any) -> str:
  sim = getattr(env, "sim", None)
  if sim is None:
    return f"environment {type(env).__name__}"
  recorded = {
    "cuda": "every step replayed as one recorded graph",
    "cpu": "physics replayed as recorded graphs, the rest of every step runs eagerly",
  }
  is_recorded = sim.cfg.capture and sim.engine == "warp"
  return f"engine {sim.engine}, {recorded[sim.device.type] if is_recorded else 'every step runs eagerly'}"


def _versions_line() -> str:
  import torch

  versions = dict(package_versions())
  backend = (
    f"CUDA {torch.version.cuda}" if torch.version.cuda else f"ROCm {hip}" if (hip := torch.version.hip) else "CPUs"
  )
  versions["torch"] += f" (built for {backend})"
  wanted = ("mjlab", "mujoco", "mujoco-warp", "torch", "rsl-rl-lib", "python")
  return ", ".join(f"{name} {versions[name]}" for name in wanted if name in versions)
