"""Evaluation of a cartpole policy: its return on the scale of 0 to 1000."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_managers import MetricsTermCfg
from mjlab_rl import Evaluation, Policy, Progress, play_first_episodes, summarize

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

UPRIGHT = 0.95
"""Cosine of the pole's angle from which on it counts as upright."""


@dataclass(kw_only=True)
class CartpoleEvaluation:
  """`return`: sum of rewards that are 1 at best, 1000 in a full episode; `upright`: share of time."""

  episodes: int = 100
  seed: int = 0
  """Seed of starts."""

  def configure(self, cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
    cfg.scene.num_envs, cfg.seed = self.episodes, self.seed
    cfg.metrics = {"upright": MetricsTermCfg(is_upright)}
    return cfg

  def run(self, env: "ManagerBasedRlEnv", policy: Policy, progress: Progress | None = None) -> Evaluation:
    played = play_first_episodes(
      env,
      policy,
      lambda: {"upright": env.metrics_manager.get_value("upright")},
      max_steps=env.max_episode_length,
      seed=self.seed,
      progress=progress,
    )
    scale = env.step_dt if env.cfg.scale_rewards_by_dt else 1.0
    metrics = {"return": played.total / scale, "upright": played.mean("upright")}
    second = round(1.0 / env.step_dt)
    return summarize(metrics, {}, units={}, values={"upright": played.values["upright"]}, steps_per_second=second)


def is_upright(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return 1 where the pole is within 18 degrees of upright, (num_envs,)."""
  pole = env.scene["cartpole"]
  angle = pole.data.joint_pos[:, pole.joint_names.index("hinge")]
  return (angle.cos() > UPRIGHT).float()
