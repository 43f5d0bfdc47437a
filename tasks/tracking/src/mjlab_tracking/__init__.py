"""Motion imitation: policies that follow clips."""

from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

if TYPE_CHECKING:
  from mjlab_tracking.evaluation import TrackingEvaluation
  from mjlab_tracking.flat import TrackedRobot, agent, flat_env, play
  from mjlab_tracking.g1 import g1_flat, g1_flat_env, g1_flat_no_state_estimation

__all__ = [
  "TrackedRobot",
  "TrackingEvaluation",
  "agent",
  "flat_env",
  "g1_flat",
  "g1_flat_env",
  "g1_flat_no_state_estimation",
  "play",
]

# Loaded on first use, because the environment is heavy.
__getattr__, __dir__ = lazy_exports(
  __name__,
  {
    ".evaluation": "TrackingEvaluation",
    ".flat": "TrackedRobot agent flat_env play",
    ".g1": "g1_flat g1_flat_env g1_flat_no_state_estimation",
  },
)
