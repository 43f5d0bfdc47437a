"""Evaluation of a tracking policy: whole clips, many times."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from mjlab_core import require
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_managers import MetricsTermCfg
from mjlab_rl import Evaluation, Policy, Progress, play_first_episodes, summarize

from mjlab_tracking.mdp import (
  MotionCommandCfg,
  body_orientation_error,
  body_position_error,
  motion,
  mpkpe,
  root_relative_mpkpe,
)

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

UNITS = {
  "mpkpe": "m",
  "r_mpkpe": "m",
  "joint_vel_error": "rad/s",
  "ee_pos_error": "m",
  "ee_ori_error": "rad",
  "survived": "s",
}


@dataclass(kw_only=True)
class TrackingEvaluation:
  """Success over whole clips and errors on the way.

  An episode begins at the first frame of its clip, with the perturbations, noise and randomisation of training but
  without pushes; it succeeds if it reaches the last frame. Errors are means over the steps of an episode, the one that
  ends it included, then over episodes:

  - `mpkpe`: distance of the followed bodies from the reference in the world, mean over bodies;
  - `r_mpkpe`: the same with the reference moved onto the robot's anchor and turned to its heading;
  - `joint_vel_error`: root mean square over joints;
  - `ee_pos_error`, `ee_ori_error`: errors of the end effectors, with the reference laid over the robot at the
    reference's height.
  """

  end_effectors: tuple[str, ...]
  """Bodies with separate errors."""
  repeats: int = 64
  """Episodes of each clip."""
  seed: int = 0
  """Seed of randomisation, perturbations and noise."""
  push: bool = False
  """Push as in training."""
  command: str = "motion"
  """Name of the motion command."""

  def configure(self, cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
    """Return the config that plays every clip as a whole, with one world for each episode."""
    from mjlab_motions import find_clips

    wrong = f"command '{self.command}' is not a motion command; commands: {', '.join(cfg.commands)}"
    term = require(cfg.commands.get(self.command), MotionCommandCfg, wrong)
    term.sampling = "each"
    cfg.scene.num_envs = self.repeats * len(find_clips(term.motion, term.split))
    cfg.seed = self.seed
    cfg.terminations["time_out"] = None
    if not self.push:
      cfg.events["push_robot"] = None

    def metric(func: Callable[..., torch.Tensor], **params: object) -> MetricsTermCfg:
      return MetricsTermCfg(func, params={"command": self.command, **params})

    cfg.metrics = {
      "mpkpe": metric(mpkpe),
      "r_mpkpe": metric(root_relative_mpkpe),
      "joint_vel_error": metric(joint_vel_error),
      "ee_pos_error": metric(body_position_error, bodies=self.end_effectors),
      "ee_ori_error": metric(body_orientation_error, bodies=self.end_effectors),
    }
    return cfg

  def run(self, env: "ManagerBasedRlEnv", policy: Policy, progress: Progress | None = None) -> Evaluation:
    """Run one episode in every world and return the metrics."""
    term = motion(env, self.command)
    names = [name for name in UNITS if name != "survived"]
    # Each world plays the same clip again and again.
    clip = torch.arange(env.num_envs) % term.library.num_clips
    groups = {name: clip == i for i, name in enumerate(term.library.clip_names)}
    played = play_first_episodes(
      env,
      policy,
      lambda: {name: env.metrics_manager.get_value(name) for name in names},
      max_steps=int(term.library.lengths.max()),
      seed=self.seed,
      progress=progress,
    )
    metrics = {
      "success_rate": (played.has_ended & ~played.has_failed).double(),
      **{name: played.mean(name) for name in names},
      "survived": played.length * env.step_dt,
    }
    steps = round(1.0 / env.step_dt)
    alive = (~played.values[names[0]].isnan()).double()
    curves = {"playing": alive, **{name: played.values[name] for name in names}}
    return summarize(metrics, groups, units=UNITS, values=curves, steps_per_second=steps)


def joint_vel_error(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the root mean square over joints of the error of joint velocities, (num_envs,) [rad/s]."""
  term = motion(env, command)
  return (term.joint_vel - term.robot.data.joint_vel).square().mean(-1).sqrt()
