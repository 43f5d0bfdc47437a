"""`train TASK [flags]`: build the task, apply the flags, train."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjlab.cli._errors import BuildError, UsageError

if TYPE_CHECKING:
  from mjlab_rl import Console, RlEnv, RunManifest, TaskCfg

_USAGE = "usage: train TASK [flags]"
_OPTIONS = """\
  --device auto|cpu|cuda:N   where to simulate and learn; auto: a GPU where there is one (default: auto)
  --seed INT                 seed of learner and environment (default: that of the task)
  --resume [RUN]             continue: latest (the default), the name or directory of a run, or a checkpoint file,
                             with the configuration of that run and the flags given here
  --log-root DIR             folder of all runs (default: logs)
  --no-capture               run every step eagerly, for debugging
  --verbose | --quiet        all values of every iteration | errors only
  --traceback                show where an error came from
  --help [WORD]              this text with all options of the task | only those whose name contains WORD
"""
_CONFIG = """\
  --env.PATH VALUE           any value of the environment's configuration, e.g. --env.scene.num-envs 8192
  --agent.PATH VALUE         any value of the learner's configuration, e.g. --agent.max-iterations 10_000
"""
# Words that each option takes: none, one, or none or one.
_ARITY = {
  "device": "1", "seed": "1", "resume": "?", "log-root": "1", "no-capture": "0", "verbose": "0", "quiet": "0",
  "traceback": "0", "help": "?",
}  # fmt: skip


@dataclasses.dataclass(kw_only=True)
class _Arguments:
  words: list[str]
  task: str
  options: dict[str, str | None]
  overrides: list[tuple[str, list[str]]]


def run(arguments: list[str]) -> int:
  """Train; returns the exit code."""
  if not arguments or arguments[0] in ("-h", "--help"):
    if not arguments:
      raise UsageError(f"no task given. {_USAGE}; list-envs lists the tasks.")
    print(_general_help(), end="")
    return 0
  parsed = _parse(arguments)
  from mjlab.registry import load_task

  if parsed.task.startswith("-"):
    raise UsageError(f"the task comes first. {_USAGE}")
  task = _task(parsed.task, load_task)
  if "help" in parsed.options:
    print(_task_help(parsed.task, task, parsed.options["help"]))
    return 0
  return _train(parsed, task)


def _task(name: str, load: Any) -> "TaskCfg[Any]":
  from mjlab.registry import list_tasks

  if name not in list_tasks():
    from mjlab_core import unknown

    raise UsageError(unknown("task", name, list_tasks()))
  return load(name)


def _general_help() -> str:
  from mjlab.registry import list_tasks

  tasks = "".join(f"  {name}\n" for name in list_tasks()) or "  (none is installed)\n"
  return f"{_USAGE}\n\nTrains a policy.\n\ntasks:\n{tasks}\nflags:\n{_OPTIONS}{_CONFIG}"


def _task_help(name: str, task: "TaskCfg[Any]", word: str | None) -> str:
  from mjlab.cli._config_flags import describe, flags, unknown_flag

  known = [*flags(task.agent, "agent"), *flags(task.env, "env")]
  if word is None:
    return f"usage: train {name} [flags]\n\nflags:\n{_OPTIONS}\n{describe(known)}"
  pattern = word.strip("-").replace("_", "-").lower()
  shown = [flag for flag in known if pattern in flag.name.lower()]
  if not shown:
    raise UsageError(unknown_flag(pattern, [flag.name for flag in known]))
  return describe(shown)


def _parse(arguments: list[str]) -> _Arguments:
  task, *rest = arguments
  options: dict[str, str | None] = {}
  overrides: list[tuple[str, list[str]]] = []
  index = 0
  while index < len(rest):
    word = "--help" if rest[index] == "-h" else rest[index]
    index += 1
    if not word.startswith("--"):
      raise UsageError(f"'{word}': not a flag. {_USAGE}")
    name, equals, value = word[2:].partition("=")
    words = [value] if equals else []
    if not equals:
      while index < len(rest) and not rest[index].startswith("--") and rest[index] != "-h":
        words.append(rest[index])
        index += 1
    if name.partition(".")[0] in ("env", "agent") and "." in name:
      overrides.append((name, words))
    else:
      options[_option(name, words)] = words[0] if words else None
  return _Arguments(words=arguments, task=task, options=options, overrides=overrides)


def _option(name: str, words: list[str]) -> str:
  option = name.replace("_", "-")
  arity = _ARITY.get(option)
  if arity is None:
    # What it may have meant among the task's own flags is known only once the task is loaded.
    return _unknown_option(option)
  if arity == "0" and words:
    raise UsageError(f"--{option}: takes no value, got {' '.join(words)}")
  if (arity == "1" and len(words) != 1) or len(words) > 1:
    raise UsageError(f"--{option}: takes one value, got {' '.join(words) or 'nothing'}")
  return option


def _unknown_option(option: str) -> str:
  from mjlab_core import nearest

  common = {"num-envs": "env.scene.num-envs", "max-iterations": "agent.max-iterations", "run-name": "agent.run-name"}
  close = [common[option]] if option in common else nearest(option, [*_ARITY, "env", "agent"])[:1]
  hint = f" Did you mean --{close[0]}?" if close else ""
  raise UsageError(f"--{option}: no such option.{hint}")


def _train(arguments: _Arguments, task: "TaskCfg[Any]") -> int:
  from mjlab_rl import Console, train

  from mjlab.cli._config_flags import override
  from mjlab.making import cpu_cores, default_worlds, resolve_device, standard_env

  options = arguments.options
  if "verbose" in options and "quiet" in options:
    raise UsageError("--verbose and --quiet exclude each other")
  console = Console("quiet" if "quiet" in options else "verbose" if "verbose" in options else "normal")
  log_root = Path(options.get("log-root") or "logs")
  device = resolve_device(options.get("device") or "auto")

  def apply_flags(base: "TaskCfg[Any]") -> "TaskCfg[Any]":
    env = override(base.env, "env", arguments.overrides)
    agent = override(base.agent, "agent", arguments.overrides)
    if "seed" in options:
      agent = dataclasses.replace(agent, seed=_integer("seed", options["seed"]))
      env = dataclasses.replace(env, seed=agent.seed)
    if "no-capture" in options:
      env = override(env, "env", [("env.sim.capture", ["false"])])
    return dataclasses.replace(base, env=env, agent=agent)

  changed = apply_flags(task)
  checkpoint: Path | None = None
  run: RunManifest | None = None
  if "resume" in options:
    from mjlab_rl import find_checkpoint

    checkpoint = find_checkpoint(
      options["resume"] or "latest", log_root=log_root, experiment=changed.agent.experiment_name
    )
    run = _manifest(checkpoint, arguments.task, console)
    if run is not None:
      saved = dataclasses.replace(task, env=run.env, agent=run.agent, runner=run.runner, make_env=run.make_env)
      changed = apply_flags(saved)

  worlds = f"{changed.env.scene.num_envs} worlds"
  if run is None and not any(name.replace("_", "-") == "env.scene.num-envs" for name, _ in arguments.overrides):
    # A copy of the scene: the task's own parts may be shared.
    count = default_worlds(device, changed.env.scene.num_envs)
    changed.env = override(changed.env, "env", [("env.scene.num-envs", [str(count)])])
    worlds = f"{count} worlds (--env.scene.num-envs sets it)"
  where = f"{device} ({cpu_cores()} cores)" if device == "cpu" else f"{device} ({_gpu_name(device)})"
  console.say(f"{arguments.task}: {worlds} on {where}")
  if checkpoint is not None:
    console.say(f"continuing from {checkpoint}")

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
      changed,
      name=arguments.task,
      make_env=standard_env,
      device=device,
      log_root=log_root,
      resume=checkpoint,
      console=console,
      command=["train", *arguments.words],
      on_ready=on_ready,
    )
  except (ValueError, OSError) as error:
    if is_built:
      raise
    raise BuildError(str(error)) from error
  if result.stopped_by is not None:
    console.say(f"stopped ({result.stopped_by}) after {result.iterations} iterations; saved {result.checkpoint}")
    console.say(f"continue with: train {arguments.task} --resume {result.directory}")
  else:
    console.say(f"done: {result.iterations} iterations, {result.checkpoint}")
  return 0


def _manifest(checkpoint: Path, task: str, console: "Console") -> "RunManifest | None":
  """Configuration of the run of a checkpoint; None where it is another task's, or has none."""
  from mjlab_rl import load_run

  try:
    run = load_run(checkpoint)
  except FileNotFoundError:
    console.say(f"{checkpoint.parent} has no manifest: the configuration of the task is used.")
    return None
  if run.task != task:
    console.say(f"the checkpoint is of {run.task}: the configuration of {task} is used.")
    return None
  return run


def _integer(name: str, text: str | None) -> int:
  try:
    return int(text or "")
  except ValueError:
    raise UsageError(f"--{name}: expected INT, got {text}") from None


def _gpu_name(device: str) -> str:
  import torch

  return torch.cuda.get_device_name(device)


def _environment_line(env: Any) -> str:
  sim = getattr(env, "sim", None)
  if sim is None:
    return f"environment {type(env).__name__}"
  is_recorded = sim.device.type == "cuda" and sim.cfg.capture
  return f"engine {sim.engine}, every step {'replayed as one recorded graph' if is_recorded else 'run eagerly'}"


def _versions_line() -> str:
  from mjlab_rl.manifest import package_versions

  versions = package_versions()
  wanted = ("mjlab", "mujoco", "mujoco-warp", "torch", "rsl-rl-lib", "python")
  return ", ".join(f"{name} {versions[name]}" for name in wanted if name in versions)
