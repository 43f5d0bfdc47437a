"""How well a policy follows clips: every clip from its first frame to its last, many times."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from mjlab_core.rotations import quat_error_magnitude
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_managers import MetricsTermCfg
from mjlab_rl import Evaluation, EvaluationError, Policy, Progress, play_first_episodes, summarize

from mjlab_tracking.mdp import MotionCommandCfg, motion

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

  An episode begins at the first frame of its clip, off by what training allows, with its noise and randomisation but
  without pushes; it succeeds if it reaches the last frame. Errors are means over the steps of an episode, the one that
  ends it included, then over episodes:

  - `mpkpe`: distance of the followed bodies from the reference in the world, mean over bodies;
  - `r_mpkpe`: the same after robot and reference have been laid over one another at the anchor, heading included;
  - `joint_vel_error`: root mean square over joints;
  - `ee_pos_error`, `ee_ori_error`: of the end effectors, with the reference laid over the robot at its own height.
  """

  end_effectors: tuple[str, ...]
  """Bodies whose errors are told apart."""
  repeats: int = 64
  """Episodes of each clip."""
  seed: int = 0
  """Of randomisation, perturbations and noise."""
  push: bool = False
  """Push as in training."""
  command: str = "motion"
  """Name of the motion command."""

  def configure(self, cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
    """Every clip in turn, whole, one world for each episode."""
    from mjlab_tracking.library import find_clips

    term = cfg.commands.get(self.command)
    if not isinstance(term, MotionCommandCfg):
      raise EvaluationError(f"command '{self.command}' is no motion command; there are: {', '.join(cfg.commands)}")
    term.sampling = "each"
    cfg.scene.num_envs = self.repeats * len(find_clips(term.motion, term.split))
    cfg.seed = self.seed
    cfg.terminations["time_out"] = None
    if not self.push:
      cfg.events["push_robot"] = None
    params = {"command": self.command}
    feet = {**params, "bodies": self.end_effectors}
    cfg.metrics = {
      "mpkpe": MetricsTermCfg(mpkpe, params=dict(params)),
      "r_mpkpe": MetricsTermCfg(root_relative_mpkpe, params=dict(params)),
      "joint_vel_error": MetricsTermCfg(joint_vel_error, params=dict(params)),
      "ee_pos_error": MetricsTermCfg(body_position_error, params=dict(feet)),
      "ee_ori_error": MetricsTermCfg(body_orientation_error, params=dict(feet)),
    }
    return cfg

  def run(self, env: "ManagerBasedRlEnv", policy: Policy, progress: Progress | None = None) -> Evaluation:
    """One episode of every world."""
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


def mpkpe(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Mean distance of the followed bodies from the reference in the world, (num_envs,) [m]."""
  term = motion(env, command)
  return torch.linalg.vector_norm(term.body_pos_w - term.robot_body_pos_w, dim=-1).mean(-1)


def root_relative_mpkpe(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """The same with the reference moved onto the robot's anchor and turned to its heading, (num_envs,) [m]."""
  term = motion(env, command)
  lift = (term.robot_anchor_pos_w - term.anchor_pos_w)[:, None, 2:]
  difference = term.body_pos_relative_w - term.robot_body_pos_w
  moved = torch.cat((difference[..., :2], difference[..., 2:] + lift), -1)
  return torch.linalg.vector_norm(moved, dim=-1).mean(-1)


def joint_vel_error(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Root mean square over joints of the error of joint velocities, (num_envs,) [rad/s]."""
  term = motion(env, command)
  return (term.joint_vel - term.robot.data.joint_vel).square().mean(-1).sqrt()


def body_position_error(env: "ManagerBasedRlEnv", *, command: str, bodies: tuple[str, ...]) -> torch.Tensor:
  """Mean distance of some bodies from the reference laid over the robot, (num_envs,) [m]."""
  term = motion(env, command)
  at = [term.cfg.bodies.index(body) for body in bodies]
  difference = term.body_pos_relative_w - term.robot_body_pos_w
  return torch.stack([torch.linalg.vector_norm(difference[:, i], dim=-1) for i in at], 1).mean(-1)


def body_orientation_error(env: "ManagerBasedRlEnv", *, command: str, bodies: tuple[str, ...]) -> torch.Tensor:
  """Mean angle of some bodies to the reference laid over the robot, (num_envs,) [rad]."""
  term = motion(env, command)
  at = [term.cfg.bodies.index(body) for body in bodies]
  angles = [quat_error_magnitude(term.body_quat_relative_w[:, i], term.robot_body_quat_w[:, i]) for i in at]
  return torch.stack(angles, 1).mean(-1)
