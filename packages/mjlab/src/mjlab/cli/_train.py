"""`train TASK [flags]`: build the task, apply the flags, train."""

import dataclasses
import itertools
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjlab import making
from mjlab.cli._config_flags import replaced
from mjlab.cli._errors import BuildError, UsageError
from mjlab.cli._policies import manifest_of
from mjlab.cli._task_command import load_named_task, run_with_task
from mjlab.registry import list_tasks, load_task, task_file

if TYPE_CHECKING:
  from mjlab_rl import RlEnv, TaskCfg


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """All that can be given after the task."""

  device: str = "auto"
  """Where to simulate and learn: cpu, cuda:0, or auto for a GPU where there is one."""
  seed: int | None = None
  """Seed of learner and environment; None: that of the task."""
  resume: str | None = None
  """Run to continue, with its configuration and the flags given here: latest (of this task, also without a value),
  the name or directory of a run, or a checkpoint file."""
  teacher: str | None = None
  """Policy to imitate, in tasks that distil one: latest (of the task that teaches; also None), a task (its latest), the
  name or directory of a run, or a checkpoint file."""
  init_from: str | None = None
  """Policy to begin as, of a student too: latest or the name of a run of this task's experiment, a task (its latest),
  the directory of a run, or a checkpoint file. All but the policy begins anew."""
  log_root: str = "logs"
  """Folder of all runs."""
  viewer: bool = False
  """Show the worlds in a browser while training."""
  viewer_host: str = "127.0.0.1"
  """Address that the viewer listens on; 0.0.0.0 lets other machines in."""
  viewer_port: int = 8080
  """Port of the viewer, the next free one if it is taken."""
  video: bool = False
  """Film four worlds now and then, into the run directory."""
  video_interval: int = 2000
  """Steps from the beginning of one film to that of the next."""
  video_length: int = 200
  """Steps of a film."""
  verbose: bool = False
  """Show all values of every iteration."""
  quiet: bool = False
  """Show errors only."""
  traceback: bool = False
  """Show where an error came from."""
  agent: Any = None
  """Configuration of the learner."""
  env: Any = None
  """Configuration of the environment."""


def run(arguments: list[str]) -> int:
  """Train; returns the exit code."""
  if arguments and arguments[0].startswith("--tyro-"):
    _print_completion(arguments)
    return 0
  return run_with_task(
    "train",
    arguments,
    _train,
    Arguments,
    purpose="Trains a policy.",
    configs=lambda task: {"agent": task.agent, "env": task.env},
    more=_MORE,
  )


_MORE = """\
  --agent.PATH      Any value of the learner, e.g. --agent.max-iterations 10_000.
  --help WORD       After a task: its flags, all or those whose name contains WORD.

train --tyro-print-completion SHELL prints the completion for bash, zsh, tcsh or fish.
"""


def _print_completion(arguments: list[str]) -> None:
  from mjlab.cli._flag_parser import print_completion

  tasks = {name: load_task(name) for name in list_tasks()}
  configs = {name: Arguments(agent=task.agent, env=task.env) for name, task in tasks.items()}
  print_completion(configs, prog="train", arguments=arguments)


def _with_latest(given: list[str]) -> list[str]:
  """The same with `--resume latest` for a bare `--resume`."""
  words: list[str] = []
  for word, following in itertools.zip_longest(given, given[1:], fillvalue="--"):
    words += [word, "latest"] if word == "--resume" and following.startswith("--") else [word]
  return words


def _train(name: str, task: "TaskCfg[Any]", given: list[str]) -> int:
  from mjlab_rl import Console

  from mjlab.cli._flag_parser import parse

  given = _with_latest(given)
  # Once to learn from what to start, once more upon that.
  wanted = parse(Arguments(agent=task.agent, env=task.env), given)
  if wanted.verbose and wanted.quiet:
    raise UsageError("--verbose and --quiet exclude each other")
  if wanted.teacher is not None and wanted.resume is not None:
    raise UsageError("--teacher and --resume exclude each other: a run that is continued has its teacher")
  if wanted.init_from is not None and wanted.resume is not None:
    raise UsageError("--init-from and --resume exclude each other: a run that is continued has its policy")
  if wanted.seed is not None and wanted.resume is not None:
    raise UsageError("--seed and --resume exclude each other: a run that is continued goes on with its random numbers")
  console = Console("quiet" if wanted.quiet else "verbose" if wanted.verbose else "normal")
  device = making.resolve_device(wanted.device)
  checkpoint = _checkpoint(wanted, name)
  run = None if checkpoint is None else manifest_of(checkpoint, name, console.say)
  if run is None:
    default = making.default_worlds(device, task.env.scene.num_envs)
    task = dataclasses.replace(task, env=replaced(task.env, ("scene", "num_envs"), default))
  else:
    default = None
    task = dataclasses.replace(task, env=run.env, agent=run.agent, runner=run.runner, make_env=run.make_env)
  wanted = parse(Arguments(agent=task.agent, env=task.env), given)
  teacher = _teacher(wanted, name)
  beginning = _beginning(wanted)
  if wanted.seed is not None:
    wanted.agent = replaced(wanted.agent, ("seed",), wanted.seed)
    wanted.env = replaced(wanted.env, ("seed",), wanted.seed)

  worlds = wanted.env.scene.num_envs
  hint = " (--env.scene.num-envs sets it)" if worlds == default else ""
  where = f"{device} ({making.cpu_cores()} cores)" if device == "cpu" else f"{device} ({_gpu_name(device)})"
  console.say(f"{name}: {worlds} world{'s' * (worlds != 1)}{hint} on {where}")
  if checkpoint is not None:
    console.say(f"continuing from {checkpoint}")
  if teacher is not None:
    console.say(f"learning from {teacher}")
  if beginning is not None:
    console.say(f"beginning as {beginning}")

  watchers = Watchers(wanted)
  # Seconds, for those whose command line was right.
  from mjlab_rl import train

  is_built = False

  def on_ready(env: "RlEnv", directory: Path | None) -> None:
    nonlocal is_built
    is_built = True
    console.say(_environment_line(env))
    console.say(_versions_line())
    if console.is_verbose and (describe := getattr(env, "describe", None)) is not None:
      console.say(describe())
    console.say(f"run directory {directory}")

  try:
    result = train(
      dataclasses.replace(task, env=wanted.env, agent=wanted.agent),
      name=name,
      make_env=making.standard_env,
      device=device,
      log_root=wanted.log_root,
      resume=checkpoint,
      teacher=teacher,
      init_from=beginning,
      console=console,
      command=["train", name, *given],
      code=task_file(name),
      on_ready=on_ready,
      watch=watchers.open if wanted.viewer or wanted.video else None,
    )
  except (ValueError, OSError) as error:
    if is_built:
      raise
    raise BuildError(str(error)) from error
  finally:
    watchers.close()
  if result.stopped_by is not None:
    console.say(f"stopped ({result.stopped_by}) after {result.iterations} iterations; saved {result.checkpoint}")
    console.say(f"continue with: {shlex.join(['train', name, '--resume', str(result.directory)])}")
  else:
    console.say(f"done: {result.iterations} iterations, {result.checkpoint}")
  return 0


class Watchers:
  """Those who look on while a policy is trained."""

  def __init__(self, wanted: Arguments) -> None:
    if wanted.viewer:
      from mjlab_viewer import check_address

      check_address(wanted.viewer_host, wanted.viewer_port)
    if wanted.video and not 1 <= wanted.video_length <= wanted.video_interval:
      raise UsageError(
        f"--video-length {wanted.video_length}: films of so many steps cannot begin every {wanted.video_interval} "
        "(--video-interval)"
      )
    self._wanted = wanted
    self._open: list[Any] = []

  def open(self, env: Any, directory: Path | None) -> Callable[[], None]:
    """Open what is wanted; returns what is to be called after every step."""
    from mjlab_viewer import BrowserViewer, TrainingVideo

    wanted = self._wanted
    calls: list[Callable[[], None]] = []
    if wanted.viewer:
      viewer = BrowserViewer(env, host=wanted.viewer_host, port=wanted.viewer_port)
      print(f"watch at {viewer.url}", flush=True)
      self._open.append(viewer)
      calls.append(viewer.update)
    if wanted.video and directory is not None:
      interval, length = wanted.video_interval, wanted.video_length
      video = TrainingVideo(env, directory / "videos", interval=interval, length=length)
      self._open.append(video)
      calls.append(video.after_step)

    def after_step() -> None:
      for call in calls:
        call()

    return after_step

  def close(self) -> None:
    """Close what was opened."""
    while self._open:
      self._open.pop().close()


def _checkpoint(wanted: Arguments, task: str) -> Path | None:
  if wanted.resume is None:
    return None
  from mjlab_rl import find_checkpoint

  return find_checkpoint(
    wanted.resume, log_root=Path(wanted.log_root), experiment=wanted.agent.experiment_name, task=task
  )


def _teacher(wanted: Arguments, task: str) -> Path | None:
  """The checkpoint of the policy to imitate; None where none is, or where the run that is continued has its own."""
  from mjlab_rl import RslRlDistillationRunnerCfg

  agent = wanted.agent
  if not isinstance(agent, RslRlDistillationRunnerCfg):
    if wanted.teacher is not None:
      raise UsageError(f"--teacher: {task} imitates nobody; `list-envs distill` lists the tasks that do")
    return None
  if wanted.resume is not None:
    return None
  if agent.teacher_task is None:
    if wanted.teacher in (None, "latest"):
      raise UsageError(f"{task} imitates a policy: name its run or checkpoint with --teacher")
    experiment = agent.experiment_name
  else:
    experiment = load_named_task(agent.teacher_task).agent.experiment_name
  try:
    return _trained(wanted.teacher or "latest", wanted, experiment, agent.teacher_task)
  except FileNotFoundError as error:
    train_one = f". Train one with `train {agent.teacher_task}`" if wanted.teacher in (None, "latest") else ""
    raise UsageError(f"no teacher: {error}{train_one}") from error


def _beginning(wanted: Arguments) -> Path | None:
  """The checkpoint of the policy to begin as; None where none is."""
  return None if wanted.init_from is None else _trained(wanted.init_from, wanted, wanted.agent.experiment_name)


def _trained(named: str, wanted: Arguments, experiment: str, task: str | None = None) -> Path:
  """The checkpoint that `named` means, as `find_checkpoint` says, or of a task its latest."""
  from mjlab_core import nearest
  from mjlab_rl import RunNotFoundError, find_checkpoint

  if named in list_tasks():
    named, task, experiment = "latest", named, load_task(named).agent.experiment_name
  try:
    return find_checkpoint(named, log_root=Path(wanted.log_root), experiment=experiment, task=task)
  except RunNotFoundError as error:
    close = nearest(named, list_tasks(), 1)
    raise RunNotFoundError(f"{error}. Nearest task: {close[0]}" if close else str(error)) from error


def _gpu_name(device: str) -> str:
  import torch

  return torch.cuda.get_device_name(device)


def _environment_line(env: Any) -> str:
  sim = getattr(env, "sim", None)
  if sim is None:
    return f"environment {type(env).__name__}"
  how = "every step run eagerly"
  if sim.cfg.capture and sim.engine == "warp":
    how = "physics replayed as recorded graphs and the rest of every step run eagerly"
    if sim.device.type == "cuda":
      how = "every step replayed as one recorded graph"
  return f"engine {sim.engine}, {how}"


def _versions_line() -> str:
  from mjlab_rl.manifest import package_versions

  versions = package_versions()
  wanted = ("mjlab", "mujoco", "mujoco-warp", "torch", "rsl-rl-lib", "python")
  return ", ".join(f"{name} {versions[name]}" for name in wanted if name in versions)
