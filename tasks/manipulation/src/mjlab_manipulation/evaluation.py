"""Evaluation of a lifting policy: success, time and forces."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from mjlab_core import ConfigError, require
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_rl import Evaluation, Policy, Progress, play_first_episodes, summarize
from mjlab_scene import VariantEntity

from mjlab_manipulation.mdp import LiftCommand, LiftCommandCfg, lift_command

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

MAX_WIDTHS = 6
"""Largest number of object widths with separate groups."""

_MEASURED = ("held", "lifted", "dropped", "finger_force", "position_error")


@dataclass(kw_only=True)
class LiftEvaluation:
  """Evaluation with one goal for each world and the noise and randomisation of training.

  Groups are the objects, their widths, and their places at the start. Metrics:

  - `success_rate`: share of episodes in which the object was held at its goal;
  - `time_to_success`: time until then, of these episodes;
  - `lift_rate`: share in which it was lifted; `drop_rate`: share of these in which it fell again;
  - `failure_rate`: share that ended in failure;
  - `peak_force`: greatest force of a finger on the object;
  - `final_error`: distance of the object from its goal at the end.
  """

  episodes: int = 256
  seconds: float = 10.0
  """Time for each goal [s]."""
  seed: int = 0
  """Seed of randomisation, starts, goals and noise."""
  command: str = "lift_height"
  """Name of the lift command."""

  def configure(self, cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
    wrong = f"command '{self.command}' is not a lift command; commands: {', '.join(cfg.commands)}"
    command = require(cfg.commands.get(self.command), LiftCommandCfg, wrong)
    terms = {name: term for name in _MEASURED if (term := cfg.metrics.get(name)) is not None}
    if missing := [name for name in _MEASURED if name not in terms]:
      raise ConfigError(f"the evaluation needs metrics {', '.join(missing)}, which the task does not have")
    hold = terms["held"].params.get("hold", 0.0)
    if hold > self.seconds:
      raise ConfigError(f"success must be held for {hold:g} s, but a goal lasts {self.seconds:g} s")
    command.goal_time_range = (self.seconds, self.seconds)
    cfg.episode_length_s = max(cfg.episode_length_s, self.seconds)
    cfg.scene.num_envs, cfg.seed = self.episodes, self.seed
    cfg.curriculum = {}
    return cfg

  def run(self, env: "ManagerBasedRlEnv", policy: Policy, progress: Progress | None = None) -> Evaluation:
    term = lift_command(env, self.command)
    groups: dict[str, torch.Tensor] = {}
    played = play_first_episodes(
      env,
      policy,
      lambda: {name: env.metrics_manager.get_value(name) for name in _MEASURED},
      max_steps=env.max_episode_length,
      seed=self.seed,
      begin=lambda: groups.update(_groups(env, term)),
      progress=progress,
    )
    # The maximum over an episode; stages only rise, so theirs is the value at the end.
    most = {name: played.values[name].nan_to_num(nan=0.0).amax(0) for name in _MEASURED}
    held, lifted = most["held"] > 0, most["lifted"] > 0
    steps_to_success = (played.values["held"] == 0).sum(0) + 1
    last = (played.length - 1).clamp(min=0)
    metrics = {
      "success_rate": held.double(),
      "time_to_success": (steps_to_success * env.step_dt).masked_fill(~held, torch.nan),
      "lift_rate": lifted.double(),
      "drop_rate": (most["dropped"] > 0).double().masked_fill(~lifted, torch.nan),
      "failure_rate": played.has_failed.double(),
      "peak_force": most["finger_force"],
      "final_error": played.values["position_error"].gather(0, last[None])[0],
    }
    return summarize(
      metrics,
      groups,
      units={"time_to_success": "s", "peak_force": "N", "final_error": "m"},
      values={"position_error": played.values["position_error"], "held": played.values["held"]},
      steps_per_second=round(1.0 / env.step_dt),
    )


def _groups(env: "ManagerBasedRlEnv", term: LiftCommand) -> dict[str, torch.Tensor]:
  """Return groups of worlds with a similar object or start, bool (num_envs,) by name."""
  place, region = (term.object_pos_w - env.scene.env_origins).cpu(), term.cfg.start
  far, left = place[:, 0] > 0.5 * sum(region.x), place[:, 1] > 0.5 * sum(region.y)
  groups = {"near": ~far, "far": far, "left": left, "right": ~left}
  for number, name in enumerate(term.cfg.objects):
    is_meant, entity = (term.target == number).cpu(), env.scene[name]
    if isinstance(entity, VariantEntity):
      kinds = enumerate(entity.variant_names)
      groups |= {kind: is_meant & (entity.variant == i).cpu() for i, kind in kinds}
    else:
      groups[name] = is_meant
  # The fingers span the smallest edge.
  return groups | _by_width(term.object_size.amin(1).cpu())


def _by_width(width: torch.Tensor) -> dict[str, torch.Tensor]:
  """Return a group for each width [m] if there are few, else for each third of the worlds."""
  millimetres = (width * 1e3).round()
  found = millimetres.unique().tolist()
  if len(found) <= MAX_WIDTHS:
    return {f"{mm:.0f} mm": millimetres == mm for mm in found}
  low, high = (width.double().quantile(share / 3) for share in (1, 2))
  edges = f"{low * 1e3:.1f}", f"{high * 1e3:.1f}"
  thirds = {
    f"to {edges[0]} mm": width <= low,
    f"{edges[0]} to {edges[1]} mm": (width > low) & (width <= high),
    f"above {edges[1]} mm": width > high,
  }
  # A third is empty if many widths are equal.
  return {name: members for name, members in thirds.items() if members.any()}
