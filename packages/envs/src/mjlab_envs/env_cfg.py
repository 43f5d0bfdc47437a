"""Configuration of a manager-based environment."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

from mjlab_core import Config, Limits, NonNegative, PositiveCount, field_problems
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

if TYPE_CHECKING:
  from mjlab_viewer import CameraCfg, PictureCfg


def _default_events() -> dict[str, EventTermCfg | None]:
  return {"reset_scene_to_default": EventTermCfg(reset_scene_to_default, mode="reset")}


@dataclass(kw_only=True)
class ViewerCfg(Config):
  """Camera and size of pictures; None takes the viewer's default."""

  body: str | None = None
  """Full name of the body that the camera follows."""
  lookat: tuple[float, float, float] | None = None
  """Fixed point of the world to look at instead [m]."""
  distance: float | None = None
  """Distance of the camera [m]."""
  azimuth: float | None = None
  """Direction of view about the vertical [deg]; 0 looks along +x."""
  elevation: float | None = None
  """Direction of view above the horizon [deg]; negative values look down."""
  width: int | None = None
  """Width of a picture [px]."""
  height: int | None = None
  """Height of a picture [px]."""

  def camera(self) -> "CameraCfg":
    """Return the camera; needs mjlab-viewer."""
    from mjlab_viewer import CameraCfg

    return CameraCfg(**self._given("body", "lookat", "distance", "azimuth", "elevation"))

  def picture(self) -> "PictureCfg":
    """Return size and camera of a picture; needs mjlab-viewer."""
    from mjlab_viewer import PictureCfg

    return PictureCfg(camera=self.camera(), **self._given("width", "height"))

  def _given(self, *names: str) -> dict[str, Any]:
    return {name: value for name in names if (value := getattr(self, name)) is not None}


@dataclass(kw_only=True)
class ManagerBasedRlEnvCfg(Config):
  """Configuration of an environment. A term set to None is left out."""

  decimation: PositiveCount
  """Physics steps per environment step."""
  scene: SceneCfg
  episode_length_s: NonNegative = 0.0
  """Length of a full episode [s]; 0 is without end."""
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
  seed: Annotated[int, Limits(ge=-(2**63), lt=2**64)] | None = None
  """Seed of the environment's generator; None draws one, see `ManagerBasedRlEnv.seed`."""
  auto_reset: bool = True
  """Reset worlds whose episode ended within the step that ended it."""
  capture_terminal_observations: bool = False
  """Observe ended worlds once more before they are reset, for `extras["final_obs"]` of a step; needs auto_reset.

  Costs a second evaluation of all observations. Commands and events of the step are not yet in them."""
  scale_rewards_by_dt: bool = True
  """Multiply rewards by the duration of a step, so that weights are rates."""
  compile_terms: bool = False
  """Compile observations, rewards, terminations and metrics with torch.compile, which takes time at the first step.

  Results are equal within float rounding. Terms that cast rays, draw random numbers or read the device stay as they
  are."""
  is_finite_horizon: bool = False
  """True if the time limit is part of the task; values are then not bootstrapped at a time-out."""

  viewer: ViewerCfg = field(default_factory=ViewerCfg)
  """Camera and size of pictures of this environment."""

  def problems(self) -> list[str]:
    """Return the mistakes in these values, one sentence each."""
    found = field_problems(self)
    if self.capture_terminal_observations and not self.auto_reset:
      found.append("capture_terminal_observations is for auto_reset; without it, steps return terminal observations")
    timed = [name for name, term in self.terminations.items() if term is not None and term.time_out]
    if timed and not self.episode_length_s > 0:
      found.append(f"termination '{timed[0]}' is a time-out, so episode_length_s must be positive")
    return found
