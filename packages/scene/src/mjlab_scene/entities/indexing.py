"""Places of an entity's elements in the compiled model, and of its state in the simulation's arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import mujoco
import numpy as np
import torch
from mjlab_core import Index, Limits, MjlabError, as_index, check_value, select, where_
from mjlab_core.mujoco.model_fields import element_names

KINDS = ("body", "joint", "geom", "site", "tendon", "actuator", "camera", "light", "material")
"""Kinds of element that an entity lists by name."""

Selection = slice | torch.Tensor | Sequence[int] | None
"""Elements of one kind of an entity: all (None), a slice, an int64 tensor or a list of entity-local ids."""

Mask = torch.Tensor | None
"""Worlds to write, bool (num_envs,); None for all."""


class Frames(NamedTuple):
  """Places of the frames of one kind, n of them; whole numbers for a single frame."""

  ids: Index | int
  """Ids of the elements."""
  bodies: Index | int
  """Body of each."""
  trees: Index | int
  """Top body of the kinematic tree of each; one row if they share one."""


@dataclass(frozen=True, kw_only=True)
class EntityIndexing:
  """Ids of an entity's elements in the model, global, and columns of its joints in the state."""

  names: dict[str, tuple[str, ...]]
  """Local names by kind of element, in the model's order; free joints left out."""
  ids: dict[str, np.ndarray]
  """Global ids that belong to `names`."""
  index: dict[str, Index]
  """The same ids, ready to select with."""
  root_body: int
  """Global id of the root body."""
  root_q: slice | None
  """Columns of a floating base in qpos, 7."""
  root_v: slice | None
  """Columns of a floating base in qvel, 6."""
  mocap: int | None
  """Row of a base that does not float in mocap_pos and mocap_quat."""
  joint_q: Index
  """Columns of the joints in qpos, the free joint left out; a ball joint has four."""
  joint_v: Index
  """Columns of the joints in qvel, the free joint left out; a ball joint has three."""
  qpos_of_joint: tuple[range, ...]
  """Columns of each joint in qpos."""
  qvel_of_joint: tuple[range, ...]
  """Columns of each joint in qvel."""
  q_of_joint: tuple[range, ...]
  """Columns of each joint in `data.joint_pos`."""
  v_of_joint: tuple[range, ...]
  """Columns of each joint in `data.joint_vel`."""
  ctrl_of_actuator: tuple[range, ...]
  """Columns of each actuator in ctrl."""
  frames: dict[str, Frames]
  """Places of bodies, geoms and sites, by kind; "root" is the root body."""

  @property
  def bodies(self) -> dict[str, Index | int]:
    """Body of each body, geom and site, by kind."""
    return {kind: frames.bodies for kind, frames in self.frames.items()}


def index_entity(model: mujoco.MjModel, prefix: str, root: str, device: torch.device) -> EntityIndexing:
  """Return the places of all elements of `model` whose names start with `prefix`.

  Args:
    model: Compiled model of the scene.
    prefix: Prefix of the entity's names in the model.
    root: Full name of the entity's root body.
    device: Device of index tensors.
  """
  found = {kind: find_elements(model, kind, prefix) for kind in KINDS}
  names = {kind: tuple(of_kind.values()) for kind, of_kind in found.items()}
  ids = {kind: np.array(list(of_kind), dtype=np.int64) for kind, of_kind in found.items()}
  root_body = int(model.body(root).id)
  first = int(model.body_jntadr[root_body])
  is_floating = first >= 0 and model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE
  mocap = int(model.body_mocapid[root_body])
  # Each joint's columns end where those of the next one begin.
  q, v = (
    _ranges(starts, np.diff(starts, append=size))
    for starts, size in ((model.jnt_qposadr, model.nq), (model.jnt_dofadr, model.nv))
  )
  qpos_of_joint, qvel_of_joint = (tuple(of[i] for i in ids["joint"]) for of in (q, v))
  bodies = {"body": ids["body"], "geom": model.geom_bodyid[ids["geom"]], "site": model.site_bodyid[ids["site"]]}

  frames = {"root": Frames(root_body, root_body, int(model.body_rootid[root_body]))}
  for kind, of_kind in bodies.items():
    trees = model.body_rootid[of_kind]
    shared = trees[:1] if len(set(trees.tolist())) == 1 else trees
    frames[kind] = Frames(*(as_index(numbers, device) for numbers in (ids[kind], of_kind, shared)))

  return EntityIndexing(
    names=names,
    ids=ids,
    index={kind: as_index(ids[kind], device) for kind in KINDS},
    root_body=root_body,
    root_q=slice(q[first].start, q[first].stop) if is_floating else None,
    root_v=slice(v[first].start, v[first].stop) if is_floating else None,
    mocap=mocap if mocap >= 0 else None,
    joint_q=as_index(_flat(qpos_of_joint), device),
    joint_v=as_index(_flat(qvel_of_joint), device),
    qpos_of_joint=qpos_of_joint,
    qvel_of_joint=qvel_of_joint,
    q_of_joint=_side_by_side(qpos_of_joint),
    v_of_joint=_side_by_side(qvel_of_joint),
    ctrl_of_actuator=_ranges(model.actuator_ctrladr[ids["actuator"]], model.actuator_ctrlnum[ids["actuator"]]),
    frames=frames,
  )


def find_elements(model: mujoco.MjModel, kind: str, prefix: str = "") -> dict[int, str]:
  """Return local names by global id; the world and free joints left out."""
  names = enumerate(element_names(model, kind))
  found = {i: name.removeprefix(prefix) for i, name in names if name and name.startswith(prefix)}
  left_out = [0] if kind == "body" else []
  if kind == "joint":
    left_out = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).tolist()
  return {i: name for i, name in found.items() if i not in left_out}


def _ranges(starts: Sequence[int] | np.ndarray, widths: Sequence[int] | np.ndarray) -> tuple[range, ...]:
  return tuple(range(int(start), int(start) + int(width)) for start, width in zip(starts, widths, strict=True))


def _side_by_side(ranges: Sequence[range]) -> tuple[range, ...]:
  widths = [len(columns) for columns in ranges]
  return _ranges(np.cumsum([0, *widths])[:-1], widths)


def _flat(ranges: Sequence[range]) -> list[int]:
  return [column for columns in ranges for column in columns]


class ColumnView:
  """Columns of a tensor with one row per world, to be written in the worlds of a mask.

  Args:
    tensor: Shape (num_envs, n, ...); its memory stays where it is.
    columns: Columns of each element.
    owner: Beginning of error messages.
    lack: Error if there are no elements.
    quaternions: True if four columns of an element are a quaternion, to be normalised.
  """

  def __init__(
    self, tensor: torch.Tensor, columns: Sequence[range], owner: str, lack: str = "", *, quaternions: bool = False
  ) -> None:
    self._tensor, self._columns, self._owner, self._lack = tensor, columns, owner, lack
    self._index = as_index(_flat(columns), tensor.device)
    self._view = tensor[:, self._index] if isinstance(self._index, slice) else None
    places = _side_by_side(columns)
    self._quaternions = [slice(p.start, p.stop) for p in places if len(p) == 4] if quaternions else []
    self._shape = (tensor.shape[0], sum(map(len, columns)), *tensor.shape[2:])
    # A kept selection keeps the id of a CUDA tensor from being given to another tensor.
    self._views: dict[tuple[object, ...], tuple[Selection, ColumnView]] = {}

  def of(self, ids: Selection) -> "ColumnView":
    """Return the columns of the elements `ids`. Each selection is resolved once, when it is first used.

    Raises:
      MjlabError: There are no elements, or an id is out of range.
    """
    if not self._columns:
      raise MjlabError(f"{self._owner}: {self._lack}")
    if ids is None:
      return self
    key = _selection_key(ids)
    if key not in self._views:
      columns = [self._columns[i] for i in _chosen_ids(ids, len(self._columns), self._owner)]
      self._views[key] = (ids, ColumnView(self._tensor, columns, self._owner, quaternions=bool(self._quaternions)))
    return self._views[key][1]

  def write(self, value: torch.Tensor, mask: Mask = None) -> None:
    """Write `value` into the columns.

    Args:
      value: Shape (num_envs, k, ...), or (1, k, ...) for all worlds, of any floating-point type.
      mask: Worlds to write, bool (num_envs,); None writes all.

    Raises:
      MjlabError: `value` has another shape.
    """
    if value.shape != self._shape:
      value = self.checked(value)
    if self._quaternions:
      value = value.to(self._tensor.dtype, copy=True)
      for columns in self._quaternions:
        value[:, columns] = _unit_quaternion(value[:, columns])
    if self._view is None:
      if mask is not None:
        kept = select(self._tensor, self._index)
        value = torch.where(mask.reshape(-1, *(1,) * (kept.dim() - 1)), value.to(kept.dtype), kept)
      self._tensor[:, self._index] = value.to(self._tensor.dtype)
    elif mask is None:
      self._view.copy_(value)
    else:
      where_(self._view, mask, value)

  def checked(self, value: torch.Tensor) -> torch.Tensor:
    """Return `value` in the tensor's type; raise MjlabError if its shape does not fit."""
    return fitting(value, self._shape, self._tensor.dtype, self._owner)


def fitting(value: torch.Tensor, shape: tuple[int, ...], dtype: torch.dtype, owner: str) -> torch.Tensor:
  """Return `value` as `dtype`; raise MjlabError unless it has `shape`, or one row for all worlds."""
  if tuple(value.shape[1:]) != shape[1:] or value.shape[0] not in (1, shape[0]):
    wanted = ", ".join(map(str, shape[1:]))
    raise MjlabError(
      f"{owner}: shape {tuple(value.shape)} does not fit ({shape[0]}, {wanted}), one row per world, "
      f"or (1, {wanted}) for all; mjlab_core.rows_of_worlds(values, env_ids, num_envs) makes rows and mask of some"
    )
  return value.to(dtype)


def _unit_quaternion(quaternion: torch.Tensor) -> torch.Tensor:
  """Return quaternions (..., 4) normalised; a zero one becomes the identity, as in MuJoCo."""
  norm = torch.linalg.vector_norm(quaternion, dim=-1, keepdim=True)
  identity = torch.zeros_like(quaternion)
  identity[..., 0] = 1.0
  return torch.where(norm > 1e-10, quaternion / norm, identity)


def _chosen_ids(selection: slice | torch.Tensor | Sequence[int], count: int, owner: str) -> list[int]:
  """Return the ids in [0, count) that `selection` stands for.

  Raises:
    MjlabError: An id is not a whole number or not in range.
  """
  if isinstance(selection, slice):
    return list(range(count)[selection])
  ids = selection.tolist() if isinstance(selection, torch.Tensor) else list(selection)
  check_value(f"{owner}: ids", ids, Annotated[tuple[int, ...], Limits(ge=-count, le=count - 1)])
  return [i % count for i in ids]


def _selection_key(selection: slice | torch.Tensor | Sequence[int]) -> tuple[object, ...]:
  """Return the key of a selection with its present values; those of a CUDA tensor are not read."""
  if isinstance(selection, slice):
    return (selection.start, selection.stop, selection.step)
  if isinstance(selection, torch.Tensor) and selection.is_cuda:
    return ("cuda", id(selection))
  # In text, True differs from 1.
  return (repr(selection.tolist() if isinstance(selection, torch.Tensor) else list(selection)),)
