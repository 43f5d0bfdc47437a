"""Where an entity's elements are in the compiled model, and where its state is in the simulation's arrays."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import torch

from mjlab_scene.element_names import KINDS
from mjlab_scene.initial_state import POSITION_WIDTH, VELOCITY_WIDTH

Index = slice | torch.Tensor
"""Selects along one dimension: a slice where ids are contiguous, so that selecting gives a view, else a LongTensor."""

_OBJECT = {
  "body": mujoco.mjtObj.mjOBJ_BODY,
  "joint": mujoco.mjtObj.mjOBJ_JOINT,
  "geom": mujoco.mjtObj.mjOBJ_GEOM,
  "site": mujoco.mjtObj.mjOBJ_SITE,
  "tendon": mujoco.mjtObj.mjOBJ_TENDON,
  "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
  "camera": mujoco.mjtObj.mjOBJ_CAMERA,
  "light": mujoco.mjtObj.mjOBJ_LIGHT,
  "material": mujoco.mjtObj.mjOBJ_MATERIAL,
}
_COUNT = {"body": "nbody", "joint": "njnt", "geom": "ngeom", "site": "nsite", "tendon": "ntendon"}
_COUNT |= {"actuator": "nactuator", "camera": "ncam", "light": "nlight", "material": "nmat"}


def as_index(ids: Sequence[int] | np.ndarray, device: torch.device | str) -> Index:
  """`ids` as a slice if they are contiguous and ascending, else as a LongTensor on `device`."""
  numbers = [int(i) for i in ids]
  if not numbers:
    return slice(0, 0)
  if numbers == list(range(numbers[0], numbers[0] + len(numbers))):
    return slice(numbers[0], numbers[-1] + 1)
  return torch.tensor(numbers, dtype=torch.long, device=device)


def select(array: torch.Tensor, index: Index) -> torch.Tensor:
  """`array[:, index]`: a view for a slice, a copy for a tensor."""
  return array[:, index] if isinstance(index, slice) else array.index_select(1, index)


@dataclass(frozen=True)
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
  q_of_joint: tuple[range, ...]
  """Columns of each joint within `joint_q`."""
  v_of_joint: tuple[range, ...]
  """Columns of each joint within `joint_v`."""
  ctrl: Index
  """Columns of the actuators in ctrl."""
  geom_body: Index
  """Body of each geom."""
  site_body: Index
  """Body of each site."""
  root_of_body: Index
  """Top body of the kinematic tree of each body; one row if they share one."""
  root_of_geom: Index
  root_of_site: Index

  @property
  def scalar_joints(self) -> bool:
    """True if every joint has one position and one velocity, so that joint ids are columns."""
    return all(len(columns) == 1 for columns in self.q_of_joint)


def index_entity(model: mujoco.MjModel, prefix: str, root: str, device: torch.device) -> EntityIndexing:
  """Find all elements of `model` whose names start with `prefix`; `root` is the full name of the root body."""
  names: dict[str, tuple[str, ...]] = {}
  ids: dict[str, np.ndarray] = {}
  for kind in KINDS:
    found = [
      (i, name.removeprefix(prefix))
      for i in range(int(getattr(model, _COUNT[kind])))
      if (name := mujoco.mj_id2name(model, _OBJECT[kind].value, i)) and name.startswith(prefix)
      if not (kind == "joint" and model.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE)
      if not (kind == "body" and i == 0)
    ]
    names[kind] = tuple(name for _, name in found)
    ids[kind] = np.array([i for i, _ in found], dtype=np.int64)

  root_body = model.body(root).id
  root_q = root_v = None
  joint = int(model.body_jntadr[root_body])
  if joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
    root_q = slice(int(model.jnt_qposadr[joint]), int(model.jnt_qposadr[joint]) + 7)
    root_v = slice(int(model.jnt_dofadr[joint]), int(model.jnt_dofadr[joint]) + 6)
  mocap = int(model.body_mocapid[root_body])

  q_columns: list[int] = []
  v_columns: list[int] = []
  q_of_joint: list[range] = []
  v_of_joint: list[range] = []
  for i in ids["joint"]:
    kind = mujoco.mjtJoint(int(model.jnt_type[i]))
    nq, nv = POSITION_WIDTH[kind], VELOCITY_WIDTH[kind]
    q_of_joint.append(range(len(q_columns), len(q_columns) + nq))
    v_of_joint.append(range(len(v_columns), len(v_columns) + nv))
    q_columns.extend(range(int(model.jnt_qposadr[i]), int(model.jnt_qposadr[i]) + nq))
    v_columns.extend(range(int(model.jnt_dofadr[i]), int(model.jnt_dofadr[i]) + nv))
  ctrl = [
    column
    for i in ids["actuator"]
    for column in range(int(model.actuator_ctrladr[i]), int(model.actuator_ctrladr[i]) + int(model.actuator_ctrlnum[i]))
  ]

  def roots(bodies: np.ndarray) -> Index:
    tops = model.body_rootid[bodies]
    return as_index(tops[:1] if len(set(tops.tolist())) == 1 else tops, device)

  geom_body, site_body = model.geom_bodyid[ids["geom"]], model.site_bodyid[ids["site"]]
  return EntityIndexing(
    names=names,
    ids=ids,
    index={kind: as_index(ids[kind], device) for kind in KINDS},
    root_body=int(root_body),
    root_q=root_q,
    root_v=root_v,
    mocap=mocap if mocap >= 0 else None,
    joint_q=as_index(q_columns, device),
    joint_v=as_index(v_columns, device),
    q_of_joint=tuple(q_of_joint),
    v_of_joint=tuple(v_of_joint),
    ctrl=as_index(ctrl, device),
    geom_body=as_index(geom_body, device),
    site_body=as_index(site_body, device),
    root_of_body=roots(ids["body"]),
    root_of_geom=roots(geom_body),
    root_of_site=roots(site_body),
  )
