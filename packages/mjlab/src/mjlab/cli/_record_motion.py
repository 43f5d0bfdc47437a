"""`record-motion TASK --output FILE.npz [flags]`: record a policy as a motion clip."""

from dataclasses import dataclass
from typing import Any

import mjlab_motions
from mjlab_core import MjlabError, UsageError
from mjlab_core.constraints import NonNegative, Positive
from mjlab_core.names import check_name

from mjlab import environments
from mjlab.cli.shared._command_line import CommandLine, TaskArguments, TaskLine, output_file
from mjlab.cli.shared._policies import PolicyArguments, find_policy


@dataclass(kw_only=True)
class Arguments(PolicyArguments, TaskArguments):
  """All that can be given after the task."""

  output: str | None = None
  """File of the clip: FILE.npz."""
  seconds: Positive = 5.0
  """Length of the clip [s]."""
  skip: NonNegative = 1.0
  """Time before the first frame [s]."""
  entity: str = "robot"
  """Entity to record."""
  license: str = ""
  """Terms of the clip, e.g. Apache-2.0."""
  seed: int = 0
  """Seed of starts and commands."""
  force: bool = False
  """Replace an existing file."""


@CommandLine("record-motion", "TASK --output FILE.npz", Arguments)
def run(wanted: Arguments, line: TaskLine) -> int:
  """Play a policy with the configuration for watching, and write the motion of one robot as a clip."""
  if wanted.output is None:
    raise UsageError("--output is missing: name the clip's file, ending in .npz")
  output = output_file("--output", wanted.output, ".npz", force=wanted.force)
  found = find_policy(wanted, line)
  import torch

  # Again, with the configuration of the run as the default.
  wanted = line.parse(env=environments.for_watching(found.parts))
  wanted.env.scene.num_envs, wanted.env.seed = 1, wanted.seed
  with found.acting(wanted.env, environments.resolve_device(wanted.device)) as (env, policy):
    recorder = _recorder(env, wanted.entity)
    print(f"{line.name}: {found}", flush=True)
    data, origin = env.scene[wanted.entity].data, env.scene.env_origins[0]
    first = round(wanted.skip / env.step_dt)
    with torch.no_grad():
      observations, _ = env.reset(seed=wanted.seed)
      for step in range(first + round(wanted.seconds / env.step_dt) + 1):
        if step >= first:
          recorder.add(data.root_link_pos_w[0] - origin, data.root_link_quat_w[0], data.joint_pos[0])
        observations, _, terminated, truncated, _ = env.step(policy(observations))
        # A clip must not contain the jump into the next episode.
        if bool((terminated | truncated).any()):
          remedy = "try --seed, a shorter --seconds, or a better policy"
          raise MjlabError(f"the episode ended after {(step + 1) * env.step_dt:.2f} s, before the clip did; {remedy}")
    about = f"mjlab, {line.name}, {found}, seed {wanted.seed}"
    motion = recorder.motion(output.stem, source=about, license=wanted.license)
    print(mjlab_motions.check_quality(motion, recorder.kinematics).table())
    mjlab_motions.save_motion(motion, output, mjlab_motions.derived_arrays(motion, recorder.kinematics))
  print(f"wrote {output}: {motion.num_frames} frames at {motion.rate:g} Hz")
  return 0


def _recorder(env: Any, entity: str) -> "mjlab_motions.MotionRecorder":
  check_name("entity", entity, env.scene.entities, "the scene")
  kinematics = mjlab_motions.Kinematics(env.sim.mj_model, env.scene[entity].prefix)
  if kinematics.joint_names != env.scene[entity].joint_names:
    raise MjlabError(f"entity '{entity}' has joints outside of its floating tree")
  return mjlab_motions.MotionRecorder(kinematics, rate=1.0 / env.step_dt)
