"""Rotations, name matching, ring buffers, masked writes, sampling, seeding and state for batched robot learning.

Every public name is importable from here. The imports are lazy, so that `from mjlab_core import nearest` in a command
line does not import torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

if TYPE_CHECKING:
  from mjlab_core.buffers import DelayBuffer, HistoryBuffer
  from mjlab_core.config import FORMER_FIELDS, Config
  from mjlab_core.constraints import (
    Ascending,
    Bounds,
    Count,
    Finite,
    Items,
    Limits,
    NonNegative,
    NonNegativeRange,
    Positive,
    PositiveCount,
    Range,
    Share,
    check_fields,
    check_value,
    field_problem,
    field_problems,
    require,
  )
  from mjlab_core.errors import (
    ConfigError,
    DivergedError,
    FileError,
    MjlabError,
    RenderingError,
    UnknownNameError,
    UsageError,
  )
  from mjlab_core.indexing import Index, as_index, as_slice, fill_, rows_of_worlds, select, where_
  from mjlab_core.io.files import AtomicWrite, printable, reading, remove_leftovers, safe_name
  from mjlab_core.mujoco.contacts import Contacts, host_contacts
  from mjlab_core.mujoco.drawing import DebugDraw
  from mjlab_core.mujoco.model_fields import ModelFields
  from mjlab_core.names import (
    check_name,
    match_names,
    match_values,
    match_values_full,
    nearest,
    unknown,
  )
  from mjlab_core.rotations import (
    combine_frames,
    cross,
    euler_xyz_from_quat,
    heading,
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
    quat_mul,
    quat_slerp,
    quat_unique,
    quat_yaw,
    random_quat,
    rotvec_from_quat,
    subtract_frames,
    wrap_to_pi,
  )
  from mjlab_core.sampling import (
    call_where,
    draw_seed,
    gaussian,
    log_uniform,
    make_generator,
    seed_everything,
    truncated_normal,
    uniform,
  )
  from mjlab_core.state import Stateful, StatefulDict

__all__ = [
  "FORMER_FIELDS",
  "Ascending",
  "AtomicWrite",
  "Bounds",
  "Config",
  "ConfigError",
  "Contacts",
  "Count",
  "DebugDraw",
  "DelayBuffer",
  "DivergedError",
  "FileError",
  "Finite",
  "HistoryBuffer",
  "Index",
  "Items",
  "Limits",
  "MjlabError",
  "ModelFields",
  "NonNegative",
  "NonNegativeRange",
  "Positive",
  "PositiveCount",
  "Range",
  "RenderingError",
  "Share",
  "Stateful",
  "StatefulDict",
  "UnknownNameError",
  "UsageError",
  "as_index",
  "as_slice",
  "call_where",
  "check_fields",
  "check_name",
  "check_value",
  "combine_frames",
  "cross",
  "draw_seed",
  "euler_xyz_from_quat",
  "field_problem",
  "field_problems",
  "fill_",
  "gaussian",
  "heading",
  "host_contacts",
  "log_uniform",
  "make_generator",
  "match_names",
  "match_values",
  "match_values_full",
  "matrix_from_quat",
  "nearest",
  "normalize",
  "printable",
  "quat_apply",
  "quat_apply_inverse",
  "quat_box_minus",
  "quat_box_plus",
  "quat_conjugate",
  "quat_error_magnitude",
  "quat_from_euler_xyz",
  "quat_from_matrix",
  "quat_from_rotvec",
  "quat_mul",
  "quat_slerp",
  "quat_unique",
  "quat_yaw",
  "random_quat",
  "reading",
  "remove_leftovers",
  "require",
  "rotvec_from_quat",
  "rows_of_worlds",
  "safe_name",
  "seed_everything",
  "select",
  "subtract_frames",
  "truncated_normal",
  "uniform",
  "unknown",
  "where_",
  "wrap_to_pi",
]

__getattr__, __dir__ = lazy_exports(
  __name__,
  {
    ".buffers": "DelayBuffer HistoryBuffer",
    ".config": "FORMER_FIELDS Config",
    ".constraints": (
      "Ascending Bounds Count Finite Items Limits NonNegative NonNegativeRange Positive PositiveCount Range Share "
      "check_fields check_value field_problem field_problems require"
    ),
    ".mujoco.contacts": "Contacts host_contacts",
    ".mujoco.drawing": "DebugDraw",
    ".errors": "ConfigError DivergedError FileError MjlabError RenderingError UnknownNameError UsageError",
    ".io.files": "AtomicWrite printable reading remove_leftovers safe_name",
    ".indexing": "Index as_index as_slice fill_ rows_of_worlds select where_",
    ".mujoco.model_fields": "ModelFields",
    ".names": "check_name match_names match_values match_values_full nearest unknown",
    ".rotations": (
      "combine_frames heading subtract_frames cross euler_xyz_from_quat "
      "matrix_from_quat normalize quat_apply quat_apply_inverse quat_box_minus quat_box_plus quat_conjugate "
      "quat_error_magnitude quat_from_euler_xyz quat_from_matrix quat_from_rotvec "
      "quat_mul quat_slerp quat_unique quat_yaw random_quat rotvec_from_quat wrap_to_pi"
    ),
    ".sampling": ("call_where draw_seed gaussian log_uniform make_generator seed_everything truncated_normal uniform"),
    ".state": "Stateful StatefulDict",
  },
)
