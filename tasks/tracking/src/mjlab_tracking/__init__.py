"""Motion imitation: from any clip to a scored policy."""

from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

if TYPE_CHECKING:
  from mjlab_tracking.editing import concatenate, crop, mirror, smooth, to_ground
  from mjlab_tracking.evaluation import TrackingEvaluation
  from mjlab_tracking.formats import Statement, read_motion
  from mjlab_tracking.g1 import g1_flat, g1_flat_env, g1_flat_no_state_estimation
  from mjlab_tracking.kinematics import Kinematics, derived_arrays
  from mjlab_tracking.library import MotionLibrary, find_clips, load_library, shipped_clips
  from mjlab_tracking.motion import Motion, MotionError, load_motion, save_motion
  from mjlab_tracking.quality import QualityReport, check_quality
  from mjlab_tracking.quality_plot import plot_quality
  from mjlab_tracking.sampling import AdaptiveSamplingCfg, MotionSampler
  from mjlab_tracking.timeline import resample

__all__ = [
  "AdaptiveSamplingCfg",
  "Kinematics",
  "Motion",
  "MotionError",
  "MotionLibrary",
  "MotionSampler",
  "QualityReport",
  "Statement",
  "TrackingEvaluation",
  "check_quality",
  "concatenate",
  "crop",
  "derived_arrays",
  "find_clips",
  "g1_flat",
  "g1_flat_env",
  "g1_flat_no_state_estimation",
  "load_library",
  "load_motion",
  "mirror",
  "plot_quality",
  "read_motion",
  "resample",
  "save_motion",
  "shipped_clips",
  "smooth",
  "to_ground",
]

# Loaded on first use: files and their checks need no environment.
__getattr__, __dir__ = lazy_exports(
  __name__,
  {
    ".editing": "concatenate crop mirror smooth to_ground",
    ".evaluation": "TrackingEvaluation",
    ".formats": "Statement read_motion",
    ".g1": "g1_flat g1_flat_env g1_flat_no_state_estimation",
    ".kinematics": "Kinematics derived_arrays",
    ".library": "MotionLibrary find_clips load_library shipped_clips",
    ".motion": "Motion MotionError load_motion save_motion",
    ".quality": "QualityReport check_quality",
    ".quality_plot": "plot_quality",
    ".sampling": "AdaptiveSamplingCfg MotionSampler",
    ".timeline": "resample",
  },
)
