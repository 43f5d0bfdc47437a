"""Rotations, name matching, ring buffers, masked writes, sampling, seeding and state for batched robot learning.

Every public name is importable from here. The imports are lazy, so that `from mjlab_core import nearest` in a command
line does not import torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

if TYPE_CHECKING:
  from mjlab_core.buffers import DelayBuffer, HistoryBuffer
  from mjlab_core.counts import why_no_count
  from mjlab_core.drawing import DebugDraw
  from mjlab_core.frames import combine_frames, heading, subtract_frames, transform_points, velocity_at
  from mjlab_core.masking import fill_, where_
  from mjlab_core.names import (
    NameMatchError,
    UnknownNameError,
    match_names,
    match_values,
    match_values_full,
    nearest,
    unknown,
  )
  from mjlab_core.rotations import (
    cross,
    euler_xyz_from_quat,
    matrix_from_quat,
    normalize,
    quat_apply,
    quat_apply_inverse,
    quat_box_minus,
    quat_box_plus,
    quat_conjugate,
    quat_error_magnitude,
    quat_from_euler_xyz,
    quat_from_matrix,
    quat_from_rotvec,
    quat_integrate,
    quat_inverse,
    quat_mul,
    quat_slerp,
    quat_unique,
    quat_yaw,
    random_quat,
    rotvec_from_quat,
    wrap_to_pi,
  )
  from mjlab_core.sampling import check_bounds, check_range, gaussian, log_uniform, truncated_normal, uniform
  from mjlab_core.seeding import draw_seed, make_generator, seed_everything
  from mjlab_core.state import StateError, Stateful

__all__ = [
  "DebugDraw",
  "DelayBuffer",
  "HistoryBuffer",
  "NameMatchError",
  "StateError",
  "Stateful",
  "UnknownNameError",
  "check_bounds",
  "check_range",
  "combine_frames",
  "cross",
  "draw_seed",
  "euler_xyz_from_quat",
  "fill_",
  "gaussian",
  "heading",
  "log_uniform",
  "make_generator",
  "match_names",
  "match_values",
  "match_values_full",
  "matrix_from_quat",
  "nearest",
  "normalize",
  "quat_apply",
  "quat_apply_inverse",
  "quat_box_minus",
  "quat_box_plus",
  "quat_conjugate",
  "quat_error_magnitude",
  "quat_from_euler_xyz",
  "quat_from_matrix",
  "quat_from_rotvec",
  "quat_integrate",
  "quat_inverse",
  "quat_mul",
  "quat_slerp",
  "quat_unique",
  "quat_yaw",
  "random_quat",
  "rotvec_from_quat",
  "seed_everything",
  "subtract_frames",
  "transform_points",
  "truncated_normal",
  "uniform",
  "unknown",
  "velocity_at",
  "where_",
  "why_no_count",
  "wrap_to_pi",
]

__getattr__, __dir__ = lazy_exports(
  __name__,
  {
    ".buffers": "DelayBuffer HistoryBuffer",
    ".counts": "why_no_count",
    ".drawing": "DebugDraw",
    ".frames": "combine_frames heading subtract_frames transform_points velocity_at",
    ".masking": "fill_ where_",
    ".names": "NameMatchError UnknownNameError match_names match_values match_values_full nearest unknown",
    ".rotations": (
      "cross euler_xyz_from_quat matrix_from_quat normalize quat_apply quat_apply_inverse quat_box_minus quat_box_plus "
      "quat_conjugate quat_error_magnitude quat_from_euler_xyz quat_from_matrix quat_from_rotvec quat_integrate "
      "quat_inverse quat_mul quat_slerp quat_unique quat_yaw random_quat rotvec_from_quat wrap_to_pi"
    ),
    ".sampling": "check_bounds check_range gaussian log_uniform truncated_normal uniform",
    ".seeding": "draw_seed make_generator seed_everything",
    ".state": "StateError Stateful",
  },
)
