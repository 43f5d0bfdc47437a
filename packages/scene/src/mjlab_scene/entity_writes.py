"""Writing an entity's state: the whole batch in, the masked worlds written, everything in place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import TYPE_CHECKING, Literal

import torch
from mjlab_actuators import ActuatorSet
from mjlab_core.masking import where_
from mjlab_core.rotations import quat_apply, quat_apply_inverse
from mjlab_core.state import Stateful

from mjlab_scene.indexing import EntityIndexing, Index, as_index

if TYPE_CHECKING:
  from mjlab_sim import Simulation

  from mjlab_scene.entity_data import EntityData

Selection = slice | torch.Tensor | Sequence[int] | None
"""Which joints or bodies of an entity: all (None), a slice, a LongTensor or a list of entity-local ids."""


@dataclass(frozen=True)
class Columns:
  """Where a selection of joints or bodies is."""

  local: Index
  """Columns among those of all the entity's joints."""
  state: Index
  """The same columns in qpos or qvel."""
  count: int
  quaternions: tuple[slice, ...]
  """Which of the given values are quaternions."""


class EntityWrites(Stateful):
  """The writing half of `Entity`.

  Every value has one row per world, or a single row that serves all, in any floating-point type. `mask`, bool
  (num_envs,), says which worlds are written; None writes all. Derived quantities follow by themselves: nobody needs to
  call forward.

  Raises:
    ValueError: a value has the wrong number of worlds or columns, or the entity has nothing of the kind to write.
  """

  name: str
  actuators: ActuatorSet | None

  @property
  def data(self) -> EntityData:
    """What can be known about the entity."""
    raise NotImplementedError

  @property
  def sim(self) -> Simulation:
    """The simulation that the entity is part of."""
    raise NotImplementedError

  @property
  def indexing(self) -> EntityIndexing:
    """Where the entity is in the model."""
    raise NotImplementedError

  # Root

  def write_root_state(self, state: torch.Tensor, mask: torch.Tensor | None = None) -> None:
    """Set pose and velocity of a floating base, (num_envs, 13), or the pose of any other, (num_envs, 7).

    Position [m], quaternion, linear velocity of the link's origin [m/s] and angular velocity [rad/s], world frame.
    """
    if self.indexing.root_q is None:
      self.write_root_pose(state, mask)
      return
    state = self._checked(state, (13,), "write_root_state")
    self.write_root_pose(state[:, :7], mask)
    self.write_root_velocity(state[:, 7:], mask)

  def write_root_pose(self, pose: torch.Tensor, mask: torch.Tensor | None = None) -> None:
    """Set position [m] and orientation of the root link, world frame, (num_envs, 7); the quaternion is normalised."""
    pose = self._checked(pose, (7,), "write_root_pose")
    ix = self.indexing
    quat = _unit(pose[:, 3:])
    if ix.root_q is not None:
      _write(self.sim.data.qpos[:, ix.root_q], mask, torch.cat((pose[:, :3], quat), dim=-1))
    else:
      assert ix.mocap is not None
      _write(self.sim.data.mocap_pos[:, ix.mocap], mask, pose[:, :3])
      _write(self.sim.data.mocap_quat[:, ix.mocap], mask, quat)

  def write_mocap_pose(self, pose: torch.Tensor, mask: torch.Tensor | None = None) -> None:
    """Set position [m] and orientation of a base that does not float, world frame, (num_envs, 7)."""
    if self.indexing.mocap is None:
      raise ValueError(f"entity '{self.name}': write_mocap_pose: its base floats; use write_root_pose")
    self.write_root_pose(pose, mask)

  def write_root_velocity(self, velocity: torch.Tensor, mask: torch.Tensor | None = None) -> None:
    """Set linear velocity of the root link's origin [m/s] and angular velocity [rad/s], world frame, (num_envs, 6)."""
    view, velocity = self._root_velocity(velocity, "write_root_velocity")
    angular = quat_apply_inverse(self.data.root_link_quat_w, velocity[:, 3:])
    _write(view, mask, torch.cat((velocity[:, :3].expand(self.num_envs, 3), angular), dim=-1))

  def write_root_velocity_b(self, velocity: torch.Tensor, mask: torch.Tensor | None = None) -> None:
    """Set linear velocity of the root link's origin [m/s] and angular velocity [rad/s], link frame, (num_envs, 6)."""
    view, velocity = self._root_velocity(velocity, "write_root_velocity_b")
    linear = quat_apply(self.data.root_link_quat_w, velocity[:, :3])
    _write(view, mask, torch.cat((linear, velocity[:, 3:].expand(self.num_envs, 3)), dim=-1))

  def write_root_com_velocity(self, velocity: torch.Tensor, mask: torch.Tensor | None = None) -> None:
    """Set linear velocity of the root's mass centre [m/s] and angular velocity [rad/s], world frame, (num_envs, 6)."""
    view, velocity = self._root_velocity(velocity, "write_root_com_velocity")
    quat = self.data.root_link_quat_w
    arm = quat_apply(quat, self.sim.model.body_ipos[:, self.indexing.root_body])
    linear = velocity[:, :3] - torch.linalg.cross(velocity[:, 3:].expand_as(arm), arm)
    _write(view, mask, torch.cat((linear, quat_apply_inverse(quat, velocity[:, 3:])), dim=-1))

  def _root_velocity(self, velocity: torch.Tensor, what: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Where a root velocity is written, and `velocity` in that precision."""
    if self.indexing.root_v is None:
      raise ValueError(f"entity '{self.name}': {what}: its base does not float, so it has no velocity to set")
    velocity = self._checked(velocity, (6,), what)
    return self.sim.data.qvel[:, self.indexing.root_v], velocity

  # Joints

  def write_joint_state(
    self,
    position: torch.Tensor,
    velocity: torch.Tensor,
    mask: torch.Tensor | None = None,
    joint_ids: Selection = None,
  ) -> None:
    """Set positions (num_envs, k) [rad or m] and velocities (num_envs, k) [rad/s or m/s] of joints."""
    self.write_joint_position(position, mask, joint_ids)
    self.write_joint_velocity(velocity, mask, joint_ids)

  def write_joint_position(
    self, position: torch.Tensor, mask: torch.Tensor | None = None, joint_ids: Selection = None
  ) -> None:
    """Set joint positions, (num_envs, k) [rad or m]; a ball joint takes four columns, a quaternion, normalised."""
    columns = self._joint_columns("position", joint_ids, "write_joint_position")
    position = self._checked(position, (columns.count,), "write_joint_position")
    if columns.quaternions:
      position = position.clone()
      for block in columns.quaternions:
        position[:, block] = _unit(position[:, block])
    _write_columns(self.sim.data.qpos, columns.state, mask, position)

  def write_joint_velocity(
    self, velocity: torch.Tensor, mask: torch.Tensor | None = None, joint_ids: Selection = None
  ) -> None:
    """Set joint velocities, (num_envs, k) [rad/s or m/s]; a ball joint takes three columns."""
    columns = self._joint_columns("velocity", joint_ids, "write_joint_velocity")
    velocity = self._checked(velocity, (columns.count,), "write_joint_velocity")
    _write_columns(self.sim.data.qvel, columns.state, mask, velocity)

  def set_joint_position_target(
    self, target: torch.Tensor, joint_ids: Selection = None, mask: torch.Tensor | None = None
  ) -> None:
    """Set position set-points of joints, (num_envs, k) [rad or m]."""
    self._set_target(self.data.joint_pos_target, "position", target, joint_ids, mask, "set_joint_position_target")

  def set_joint_velocity_target(
    self, target: torch.Tensor, joint_ids: Selection = None, mask: torch.Tensor | None = None
  ) -> None:
    """Set velocity set-points of joints, (num_envs, k) [rad/s or m/s]."""
    self._set_target(self.data.joint_vel_target, "velocity", target, joint_ids, mask, "set_joint_velocity_target")

  def set_joint_effort_target(
    self, target: torch.Tensor, joint_ids: Selection = None, mask: torch.Tensor | None = None
  ) -> None:
    """Set effort set-points of joints, (num_envs, k) [N m or N]."""
    self._set_target(self.data.joint_effort_target, "velocity", target, joint_ids, mask, "set_joint_effort_target")

  # Tendons and sites

  def set_tendon_len_target(
    self, target: torch.Tensor, tendon_ids: Selection = None, mask: torch.Tensor | None = None
  ) -> None:
    """Set length set-points of tendons, (num_envs, k) [m or rad]."""
    self._set_other("tendon", self.data.tendon_len_target, target, tendon_ids, mask, "set_tendon_len_target")

  def set_tendon_vel_target(
    self, target: torch.Tensor, tendon_ids: Selection = None, mask: torch.Tensor | None = None
  ) -> None:
    """Set velocity set-points of tendons, (num_envs, k) [m/s or rad/s]."""
    self._set_other("tendon", self.data.tendon_vel_target, target, tendon_ids, mask, "set_tendon_vel_target")

  def set_tendon_effort_target(
    self, target: torch.Tensor, tendon_ids: Selection = None, mask: torch.Tensor | None = None
  ) -> None:
    """Set effort set-points along tendons, (num_envs, k) [N or N m]."""
    self._set_other("tendon", self.data.tendon_effort_target, target, tendon_ids, mask, "set_tendon_effort_target")

  def set_site_pos_target(
    self, target: torch.Tensor, site_ids: Selection = None, mask: torch.Tensor | None = None
  ) -> None:
    """Set position set-points of sites from their reference site along their gear, (num_envs, k) [m or rad]."""
    self._set_other("site", self.data.site_pos_target, target, site_ids, mask, "set_site_pos_target")

  def set_site_vel_target(
    self, target: torch.Tensor, site_ids: Selection = None, mask: torch.Tensor | None = None
  ) -> None:
    """Set velocity set-points of sites along their gear, (num_envs, k) [m/s or rad/s]."""
    self._set_other("site", self.data.site_vel_target, target, site_ids, mask, "set_site_vel_target")

  def set_site_effort_target(
    self, target: torch.Tensor, site_ids: Selection = None, mask: torch.Tensor | None = None
  ) -> None:
    """Set effort set-points of sites, times their gear the wrench, (num_envs, k) [N or N m]."""
    self._set_other("site", self.data.site_effort_target, target, site_ids, mask, "set_site_effort_target")

  def _set_other(
    self,
    kind: Literal["tendon", "site"],
    buffer: torch.Tensor,
    target: torch.Tensor,
    ids: Selection,
    mask: torch.Tensor | None,
    what: str,
  ) -> None:
    driven = () if self.actuators is None else self.actuators.driven(kind)
    if not driven:
      raise ValueError(f"entity '{self.name}': {what}: no actuator config drives a {kind} of it")
    columns = self._rows(kind, ids, what)
    target = self._checked(target, (columns.count,), what)
    _write_columns(buffer, columns.local, mask, target)

  def _set_target(
    self,
    buffer: torch.Tensor,
    kind: str,
    target: torch.Tensor,
    joint_ids: Selection,
    mask: torch.Tensor | None,
    what: str,
  ) -> None:
    columns = self._joint_columns(kind, joint_ids, what)
    target = self._checked(target, (columns.count,), what)
    _write_columns(buffer, columns.local, mask, target)

  # Forces and controls

  def write_external_wrench(
    self,
    forces: torch.Tensor,
    torques: torch.Tensor,
    body_ids: Selection = None,
    mask: torch.Tensor | None = None,
  ) -> None:
    """Apply forces [N] and torques [N m] to bodies at their centres of mass, world frame, (num_envs, k, 3) each.

    They act in every substep until they are overwritten or the world is reset.
    """
    rows = self._rows("body", body_ids, "write_external_wrench")
    forces = self._checked(forces, (rows.count, 3), "write_external_wrench, forces")
    torques = self._checked(torques, (rows.count, 3), "write_external_wrench, torques")
    wrench = torch.cat(torch.broadcast_tensors(forces, torques), dim=-1)
    _write_columns(self.sim.data.xfrc_applied, rows.state, mask, wrench)

  def set_ctrl(self, ctrl: torch.Tensor, mask: torch.Tensor | None = None) -> None:
    """Set the controls of all actuators of the entity, (num_envs, num_ctrl), in the model's order.

    For actuators that no actuator config drives; those that one does are written again in the next substep.
    """
    index = self.indexing.ctrl
    count = index.stop - index.start if isinstance(index, slice) else index.numel()
    if count == 0:
      raise ValueError(f"entity '{self.name}': set_ctrl: it has no actuators")
    ctrl = self._checked(ctrl, (count,), "set_ctrl")
    _write_columns(self.sim.data.ctrl, index, mask, ctrl)

  # Columns

  def _joint_columns(self, kind: str, joint_ids: Selection, what: str) -> Columns:
    ix = self.indexing
    if not ix.q_of_joint:
      raise ValueError(f"entity '{self.name}': {what}: it has no joints")
    ranges, state = (ix.q_of_joint, ix.joint_q) if kind == "position" else (ix.v_of_joint, ix.joint_v)

    def resolve(joints: list[int]) -> Columns:
      columns, quaternions = [], []
      for joint in joints:
        if kind == "position" and len(ranges[joint]) == 4:
          quaternions.append(slice(len(columns), len(columns) + 4))
        columns.extend(ranges[joint])
      return _columns(columns, state, tuple(quaternions), self.sim.device)

    return self._resolve(kind, joint_ids, len(ranges), resolve, what)

  def _rows(self, kind: str, ids: Selection, what: str) -> Columns:
    state, count = self.indexing.index[kind], len(self.indexing.names[kind])
    return self._resolve(kind, ids, count, lambda rows: _columns(rows, state, (), self.sim.device), what)

  def _resolve(
    self, kind: str, selection: Selection, count: int, resolve: Callable[[list[int]], Columns], what: str
  ) -> Columns:
    """Columns of a selection, worked out once for each selection that is ever used: ids are read on the host."""
    cache = self._selections()
    if selection is None:
      selection = slice(None)
    if isinstance(selection, slice):
      key = (kind, selection.start, selection.stop, selection.step)
    elif isinstance(selection, torch.Tensor) and selection.is_cuda:
      key = (kind, id(selection))
    else:
      if isinstance(selection, torch.Tensor):
        selection = selection.tolist()
      # As text, True is not 1.
      key = (kind, repr(list(selection)))
    found = cache.get(key)
    if found is None:
      numbers = selection.tolist() if isinstance(selection, torch.Tensor) else selection
      chosen = range(count)[numbers] if isinstance(numbers, slice) else list(numbers)
      if any(isinstance(i, bool) or not isinstance(i, Integral) for i in chosen):
        raise ValueError(f"entity '{self.name}': {what}: ids must be whole numbers, got {chosen}")
      if any(not -count <= i < count for i in chosen):
        raise ValueError(f"entity '{self.name}': {what}: ids {list(chosen)} must be within {count}")
      # Holding a tensor keeps its id from being given to another one.
      found = cache[key] = (selection, resolve([i % count for i in chosen]))
    return found[1]

  def _selections(self) -> dict[tuple[object, ...], tuple[object, Columns]]:
    raise NotImplementedError

  def _checked(self, value: torch.Tensor, columns: tuple[int, ...], what: str) -> torch.Tensor:
    """`value` in the precision of the state, which differs between engines."""
    if value.shape[1:] != columns or value.shape[0] not in (1, self.num_envs):
      wanted = ", ".join(map(str, columns))
      raise ValueError(
        f"entity '{self.name}': {what}: shape {tuple(value.shape)} does not fit ({self.num_envs}, {wanted}), "
        f"one row per world, or (1, {wanted}) for all"
      )
    return value.to(self.sim.dtype)


def _unit(quaternion: torch.Tensor) -> torch.Tensor:
  """Normalised; a zero quaternion becomes the identity, as in MuJoCo."""
  norm = torch.linalg.vector_norm(quaternion, dim=-1, keepdim=True)
  identity = torch.zeros_like(quaternion)
  identity[..., 0] = 1.0
  return torch.where(norm > 1e-10, quaternion / norm, identity)


def _write(view: torch.Tensor, mask: torch.Tensor | None, value: torch.Tensor) -> None:
  if mask is None:
    view.copy_(value)
  else:
    where_(view, mask, value)


def _write_columns(buffer: torch.Tensor, columns: Index, mask: torch.Tensor | None, value: torch.Tensor) -> None:
  if isinstance(columns, slice):
    _write(buffer[:, columns], mask, value)
    return
  if mask is not None:
    kept = buffer.index_select(1, columns)
    value = torch.where(mask.reshape(-1, *(1,) * (kept.dim() - 1)), value.to(kept.dtype), kept)
  buffer[:, columns] = value.to(buffer.dtype)


def _columns(columns: Sequence[int], state: Index, quaternions: tuple[slice, ...], device: torch.device) -> Columns:
  local = as_index(columns, device)
  if isinstance(state, slice):
    in_state = as_index([state.start + column for column in columns], device)
  else:
    in_state = as_index(state[torch.tensor(columns, dtype=torch.long, device=device)].tolist(), device)
  return Columns(local, in_state, len(columns), quaternions)
