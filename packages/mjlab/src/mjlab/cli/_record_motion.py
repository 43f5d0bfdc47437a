"""`record-motion TASK --output FILE.npz [flags]`: what a policy does becomes a clip that another can be taught."""

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjlab import making
from mjlab.cli._errors import UsageError
from mjlab.cli._policies import Agent, find_policy, make_policy
from mjlab.cli._task_command import build_env, run_with_task

if TYPE_CHECKING:
  from mjlab_rl import TaskCfg

_PURPOSE = "Plays a policy, as for watching, and writes what one robot does as a motion file (--output FILE.npz)."


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """All that can be given after the task."""

  output: str | None = None
  """File of the clip, ending in .npz."""
  seconds: float = 5.0
  """Length of the clip."""
  skip: float = 1.0
  """Time before its first frame [s], for the robot to find its feet."""
  checkpoint: str = "latest"
  """Whose policy: latest (the newest run of this task), the name or directory of a run, a checkpoint, or an exported
  policy (.onnx)."""
  agent: Agent = "trained"
  """Who acts: a trained policy, nobody, or chance."""
  entity: str = "robot"
  """Whose motion."""
  license: str = ""
  """Terms of the clip, e.g. Apache-2.0."""
  seed: int = 0
  """Of starts and commands."""
  force: bool = False
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
  usage = "--output FILE.npz "
  return run_with_task("record-motion", arguments, _record, Arguments, purpose=_PURPOSE, usage=usage)


def _record(name: str, task: "TaskCfg[Any]", given: list[str]) -> int:
  from mjlab.cli._flag_parser import parse

  wanted = parse(Arguments(env=task.env), given)
  if wanted.output is None:
    raise UsageError("--output is missing: name the clip's file, ending in .npz")
  if Path(wanted.output).suffix != ".npz":
    raise UsageError(f"--output {wanted.output}: the clip's file must end in .npz")
  output = Path(wanted.output)
  if output.exists() and not wanted.force:
    raise UsageError(f"{output} is there already; --force replaces it")
  if not 0 < wanted.seconds < math.inf:
    raise UsageError(f"--seconds must be positive and finite, got {wanted.seconds:g}")
  if not 0 <= wanted.skip < math.inf:
    raise UsageError(f"--skip must be finite and not negative, got {wanted.skip:g}")
  if not output.absolute().parent.is_dir():
    raise UsageError(f"--output: there is no folder {output.parent}")
  source, parts = find_policy(wanted, name, task)
  import torch
  from mjlab_tracking import MotionError, check_quality, derived_arrays, save_motion
  from mjlab_tracking.recording import MotionRecorder

  wanted = parse(Arguments(env=parts.env if parts.play is None else parts.play(parts.env)), given)
  wanted.env.scene.num_envs, wanted.env.seed = 1, wanted.seed
  device = making.resolve_device(wanted.device)
  env = build_env(parts, wanted.env, device)
  try:
    policy = make_policy(wanted.agent, source, env, parts)
    what = f"{wanted.agent} actions" if source is None else str(source)
    recorder = MotionRecorder(env, entity=wanted.entity)
    print(f"{name}: {what}", flush=True)
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
