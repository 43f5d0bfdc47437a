"""How well a policy lifts: how often, how fast, how gently."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_rl import Evaluation, EvaluationError, Policy, Progress, play_first_episodes, summarize

from mjlab_manipulation.mdp import LiftCommandCfg, lift_command

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_MEASURED = ("held", "time_to_success", "lifted", "dropped", "finger_force", "position_error")


@dataclass(kw_only=True)
class LiftEvaluation:
  """One goal for each world, with training's noise and randomisation, by where the object began:

  - `success_rate`: share of episodes in which the object was held at its goal;
  - `time_to_success`: of those, how long it took;
  - `lift_rate`: share in which it was lifted at all; `drop_rate`: share of these in which it fell again;
  - `failure_rate`: share that ended in failure;
  - `peak_force`: greatest force of a finger on the object;
  - `final_error`: from the object to its goal at the end.
  """

  episodes: int = 256
  seconds: float = 10.0
  """Time for each goal [s]."""
  seed: int = 0
  """Of randomisation, starts, goals and noise."""
  command: str = "lift_height"
  """Name of the lift command."""

  def configure(self, cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
    command = cfg.commands.get(self.command)
    if not isinstance(command, LiftCommandCfg):
      raise EvaluationError(f"command '{self.command}' is no lift command; there are: {', '.join(cfg.commands)}")
    missing = [name for name in _MEASURED if cfg.metrics.get(name) is None]
    if missing:
      raise EvaluationError(f"metrics {', '.join(missing)} are measured, and the task has none of that name")
    command.goal_time_range = (self.seconds, self.seconds)
    cfg.episode_length_s = max(cfg.episode_length_s, self.seconds)
    cfg.scene.num_envs, cfg.seed = self.episodes, self.seed
    cfg.curriculum = {}
    return cfg

  def run(self, env: "ManagerBasedRlEnv", policy: Policy, progress: Progress | None = None) -> Evaluation:
    term = lift_command(env, self.command)
    starts: list[torch.Tensor] = []

    def measure() -> dict[str, torch.Tensor]:
      if not starts:
        starts.append((term.object_pos_w - env.scene.env_origins).cpu())
      return {name: env.metrics_manager.get_value(name) for name in _MEASURED}

    played = play_first_episodes(
      env, policy, measure, max_steps=env.max_episode_length, seed=self.seed, progress=progress
    )
    # All but the error only ever grow, so their greatest value is that at the end.
    most = {name: played.values[name].nan_to_num(nan=0.0).amax(0) for name in _MEASURED}
    held, lifted = most["held"] > 0, most["lifted"] > 0
    last = (played.length - 1).clamp(min=0)
    metrics = {
      "success_rate": held.double(),
      "time_to_success": most["time_to_success"].masked_fill(~held, torch.nan),
      "lift_rate": lifted.double(),
      "drop_rate": (most["dropped"] > 0).double().masked_fill(~lifted, torch.nan),
      "failure_rate": played.has_failed.double(),
      "peak_force": most["finger_force"],
      "final_error": played.values["position_error"].gather(0, last[None])[0],
    }
    (start,), region = starts, term.cfg.start
    far, left = start[:, 0] > 0.5 * sum(region.x), start[:, 1] > 0.5 * sum(region.y)
    groups = {"near": ~far, "far": far, "left": left, "right": ~left}
    return summarize(
      metrics,
      groups,
      units={"time_to_success": "s", "peak_force": "N", "final_error": "m"},
      values={"position_error": played.values["position_error"], "held": played.values["held"]},
      steps_per_second=round(1.0 / env.step_dt),
    )
