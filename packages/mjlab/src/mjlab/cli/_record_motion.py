"""`record-motion TASK --output FILE.npz [flags]`: what a policy does becomes a clip that another can be taught."""

import dataclasses
import textwrap
from pathlib import Path
from typing import Any

from mjlab_core import unknown

from mjlab import making
from mjlab.cli._config_flags import flags
from mjlab.cli._errors import BuildError, UsageError
from mjlab.cli._policies import Baseline, as_trained, find_run, make_policy
from mjlab.registry import list_tasks, load_task


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """All that can be given after the task."""

  output: str | None = None
  """File of the clip, ending in .npz."""
  seconds: float = 5.0
  """Length of the clip."""
  skip: float = 1.0
  """Time before its first frame [s], for the robot to find its feet."""
  run: str = "latest"
  """Whose policy: latest (of this task), the name or directory of a run, or a checkpoint file."""
  baseline: Baseline | None = None
  """Instead of a run: no action at all, or standard normal ones."""
  entity: str = "robot"
  """Whose motion."""
  license: str = ""
  """Terms of the clip, e.g. Apache-2.0."""
  seed: int = 0
  """Of starts and commands."""
  overwrite: bool = False
  """Replace a file that is there."""
  device: str = "auto"
  """Where to simulate: cpu, cuda:0, or auto for a GPU where there is one."""
  log_root: str = "logs"
  """Folder of all runs."""
  traceback: bool = False
  """Show where an error came from."""
  env: Any = None
  """Configuration of the environment, as for watching."""


def run(arguments: list[str]) -> int:
  """Record; returns the exit code."""
  if not arguments:
    raise UsageError("no task given. usage: record-motion TASK --output FILE.npz [flags]")
  name, *given = arguments
  if name in ("-h", "--help"):
    print(_help(), end="")
    return 0
  if name not in list_tasks():
    raise UsageError(unknown("task", name, list_tasks()))
  making.share_cores()
  from mjlab_rl import Console
  from mjlab_tracking import MotionError, check_quality, derived_arrays, save_motion
  from mjlab_tracking.recording import MotionRecorder

  from mjlab.cli._flag_parser import parse

  task, console = load_task(name), Console("normal")
  wanted = parse(Arguments(env=task.env), given)
  if wanted.output is None or Path(wanted.output).suffix != ".npz":
    raise UsageError(f"--output {wanted.output}: name the clip's file, ending in .npz")
  output = Path(wanted.output)
  if output.exists() and not wanted.overwrite:
    raise UsageError(f"{output} is there already; --overwrite replaces it")
  checkpoint = None
  if wanted.baseline is None:
    checkpoint = find_run(wanted.run, log_root=wanted.log_root, name=name, task=task)
    task = as_trained(checkpoint, name, task, console)
  watched = task.env if task.play is None else task.play(task.env)
  wanted = parse(Arguments(env=watched), given)
  wanted.env.scene.num_envs, wanted.env.seed = 1, wanted.seed
  device = making.resolve_device(wanted.device)
  try:
    env = (task.make_env or making.standard_env)(wanted.env, device=device)
  except (ValueError, OSError) as error:
    raise BuildError(str(error)) from error
  try:
    import torch

    policy, what = make_policy(task, env, checkpoint, wanted.baseline, device)
    recorder = MotionRecorder(env, entity=wanted.entity)
    console.say(f"{name}: {what}")
    first = round(wanted.skip / env.step_dt)
    with torch.no_grad():
      observations, _ = env.reset(seed=wanted.seed)
      for step in range(first + round(wanted.seconds / env.step_dt) + 1):
        if step >= first:
          recorder.note()
        observations, _, terminated, truncated, _ = env.step(policy(observations))
        # A clip must not hold the leap into the next episode.
        if bool((terminated | truncated).any()):
          raise MotionError(
            f"the episode ended after {(step + 1) * env.step_dt:.2f} s, before the clip did; nothing was written. Try "
            "--seed, a shorter --seconds, or a better policy."
          )
    about = f"mjlab, {name}, {what}, seed {wanted.seed}"
    motion = recorder.motion(output.stem, source=about, license=wanted.license)
    print(check_quality(motion, recorder.kinematics).table())
    save_motion(motion, output, derived_arrays(motion, recorder.kinematics))
  finally:
    env.close()
  print(f"wrote {output}: {motion.num_frames} frames at {motion.rate:g} Hz")
  return 0


def _help() -> str:
  options = [f"  --{flag.name:<12}{flag.about}" for flag in flags(Arguments())]
  return "\n".join(
    [
      "usage: record-motion TASK --output FILE.npz [flags]\n",
      "Plays a policy, as for watching, and writes what one robot does as a motion file.\n\nflags:",
      *(textwrap.fill(option, 100, subsequent_indent=" " * 16) for option in options),
      "  --env.PATH    Any value of the environment.\n",
    ]
  )
