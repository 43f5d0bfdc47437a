"""Motion clips of floating robots: files, conversion, kinematics, quality, editing, libraries."""

from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

if TYPE_CHECKING:
  from mjlab_motions.clips import ClipEntry, find_clips, shipped_clips
  from mjlab_motions.editing import concatenate, crop, mirror, smooth, to_ground
  from mjlab_motions.ghost import Ghost
  from mjlab_motions.kinematics import Kinematics, derived_arrays
  from mjlab_motions.library import MotionLibrary, load_library
  from mjlab_motions.motion import Motion
  from mjlab_motions.motion_file import load_motion, save_motion
  from mjlab_motions.quality import Finding, QualityReport, check_quality, plot_quality
  from mjlab_motions.reading.formats import read_motion
  from mjlab_motions.reading.statement import JointMap, Statement
  from mjlab_motions.recording import MotionRecorder
  from mjlab_motions.sampling import AdaptiveSamplingCfg, MotionSampler, SamplingMode
  from mjlab_motions.timeline import angular_velocity, derivative, resample

__all__ = [
  "AdaptiveSamplingCfg",
  "ClipEntry",
  "Finding",
  "Ghost",
  "JointMap",
  "Kinematics",
  "Motion",
  "MotionLibrary",
  "MotionRecorder",
  "MotionSampler",
  "QualityReport",
  "SamplingMode",
  "Statement",
  "angular_velocity",
  "check_quality",
  "concatenate",
  "crop",
  "derivative",
  "derived_arrays",
  "find_clips",
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

# Loaded on first use: listing and finding clips needs no torch.
__getattr__, __dir__ = lazy_exports(
  __name__,
  {
    ".clips": "ClipEntry find_clips shipped_clips",
    ".editing": "concatenate crop mirror smooth to_ground",
    ".reading.formats": "read_motion",
    ".ghost": "Ghost",
    ".kinematics": "Kinematics derived_arrays",
    ".library": "MotionLibrary load_library",
    ".motion": "Motion",
    ".motion_file": "load_motion save_motion",
    ".quality": "Finding QualityReport check_quality plot_quality",
    ".recording": "MotionRecorder",
    ".sampling": "AdaptiveSamplingCfg MotionSampler SamplingMode",
    ".reading.statement": "JointMap Statement",
    ".timeline": "angular_velocity derivative resample",
  },
)
