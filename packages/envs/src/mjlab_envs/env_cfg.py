"""What a manager-based environment is made of."""

import math
from dataclasses import dataclass, field

from mjlab_core.counts import why_no_count
from mjlab_managers import (
  ActionTermCfg,
  CommandTermCfg,
  CurriculumTermCfg,
  EventTermCfg,
  MetricsTermCfg,
  ObservationGroupCfg,
  RecorderTermCfg,
  RewardTermCfg,
  TerminationTermCfg,
)
from mjlab_scene import SceneCfg
from mjlab_sim import SimulationCfg

from mjlab_envs.mdp.events import reset_scene_to_default


def _default_events() -> dict[str, EventTermCfg | None]:
  return {"reset_scene_to_default": EventTermCfg(reset_scene_to_default, mode="reset")}


@dataclass(kw_only=True)
class ManagerBasedRlEnvCfg:
  """An environment as plain instances; a variant is a changed copy. A term set to None is left out."""

  decimation: int
  """Physics steps per environment step."""
  scene: SceneCfg
  episode_length_s: float = 0.0
  """Length of a full episode [s]."""
  sim: SimulationCfg = field(default_factory=SimulationCfg)
  observations: dict[str, ObservationGroupCfg | None] = field(default_factory=dict)
  actions: dict[str, ActionTermCfg | None] = field(default_factory=dict)
  commands: dict[str, CommandTermCfg | None] = field(default_factory=dict)
  rewards: dict[str, RewardTermCfg | None] = field(default_factory=dict)
  terminations: dict[str, TerminationTermCfg | None] = field(default_factory=dict)
  events: dict[str, EventTermCfg | None] = field(default_factory=_default_events)
  """Replacing the dict drops the default, which resets the scene to its default state."""
  curriculum: dict[str, CurriculumTermCfg | None] = field(default_factory=dict)
  metrics: dict[str, MetricsTermCfg | None] = field(default_factory=dict)
  recorders: dict[str, RecorderTermCfg | None] = field(default_factory=dict)
  seed: int | None = None
  """Seed of the environment's generator; None draws one, which `ManagerBasedRlEnv.seed` tells."""
  auto_reset: bool = True
  """Reset worlds whose episode ended within the step that ended it."""
  scale_rewards_by_dt: bool = True
  """Multiply rewards by the duration of a step, so that weights are rates."""
  is_finite_horizon: bool = False
  """Whether the end of time is part of the task, so that nothing is bootstrapped from it."""

  def problems(self) -> list[str]:
    """What is wrong with these numbers, one sentence each."""
    found: list[str] = []
    for name, count in (("decimation", self.decimation), ("scene.num_envs", self.scene.num_envs)):
      if wrong := why_no_count(count, 1):
        found.append(f"{name} {wrong}")
    if self.episode_length_s < 0:
      found.append(f"episode_length_s must not be negative, got {self.episode_length_s}")
    elif not math.isfinite(self.episode_length_s):
      found.append(f"episode_length_s must be finite, got {self.episode_length_s}; 0 is without end")
    if self.seed is not None and (wrong := why_no_count(self.seed, -(2**63))):
      found.append(f"seed {wrong}")
    elif self.seed is not None and self.seed >= 2**64:
      found.append(f"seed must fit into 64 bits, got {self.seed}")
    timed = [name for name, term in self.terminations.items() if term is not None and term.time_out]
    if timed and not self.episode_length_s > 0:
      found.append(f"termination '{timed[0]}' is a time-out, so episode_length_s must be positive")
    return found
