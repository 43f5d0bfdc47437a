"""Robots, objects and fixtures of a scene: configuration, and state to read and write in every world."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import mujoco
import torch
from mjlab_actuators import ActuatorCfg, ActuatorSet, Transmission
from mjlab_core import (
  Config,
  Limits,
  MjlabError,
  Stateful,
  check_fields,
  quat_apply,
  quat_apply_inverse,
  require,
)

from mjlab_scene.entities.actuation import Actuation, Quantity
from mjlab_scene.entities.entity_data import EntityData
from mjlab_scene.entities.entity_spec import EntitySpec
from mjlab_scene.entities.indexing import ColumnView, EntityIndexing, Mask, Selection, fitting, index_entity
from mjlab_scene.entities.initial_state import InitialStateCfg
from mjlab_scene.models.collision import CollisionCfg
from mjlab_scene.models.edits import SpecEdit
from mjlab_scene.models.overlay import Overlay, read_overlay

if TYPE_CHECKING:
  from mjlab_sim import Simulation


_NO_JOINTS = "it has no joints"


@dataclass(kw_only=True)
class EntityArticulationCfg(Config):
  """Actuators and joint limits of an entity."""

  actuators: tuple[ActuatorCfg, ...] = ()
  """Actuator groups; a joint, tendon or site is driven by at most one of them."""
  soft_joint_pos_limit_factor: Annotated[float, Limits(gt=0, le=1)] = 1.0
  """Soft position limits span this fraction of the joint's range about its middle, in (0, 1]."""


@dataclass(kw_only=True)
class EntityCfg(Config):
  """One robot, object or fixture.

  The base is floating if the spec holds a free joint (at most one), a mocap body if its root body is one, and fixed
  otherwise; a fixed base is placed per world through a mocap body "mocap_base" that the scene puts above it.
  """

  spec_fn: Callable[[], mujoco.MjSpec]
  """Function that returns a new spec at each call; the entity edits it."""
  init_state: InitialStateCfg = field(default_factory=InitialStateCfg)
  articulation: EntityArticulationCfg | None = None
  """Actuators and joint limits; None: actuators in the model keep the controls that the user writes."""
  edits: tuple[SpecEdit, ...] = ()
  """Changes and additions of textures, materials, meshes, lights and cameras; see `mjlab_scene.models.edits`."""
  collisions: tuple[CollisionCfg, ...] = ()
  """Contact presets; together they define which geoms collide."""
  overlay: str | None = None
  """File of identified values, which replace those above; see `mjlab_scene.models.overlay`."""

  def build(self, name: str) -> Entity:
    """Return the entity of this config, under `name`."""
    return Entity(self, name)


class Entity(EntitySpec, Stateful):
  """A robot, an object or a fixture: fixed, floating or mocap base, with or without joints.

  A new entity is only a spec. `attach` puts it into a scene, and `initialize` ties it to the simulation of that scene.
  Then `data` can be read, and the `write_*` and `set_*` methods can be used.

  Values that are written have one row per world, or a single row for all worlds, in any floating-point type. `mask`,
  bool (num_envs,), selects the worlds to write; None writes all. `*_ids` select elements; None selects all. Derived
  quantities follow on the next read, without a call to forward.

  Raises:
    MjlabError: The configuration has a mistake, a written value has the wrong shape, or the entity has no such element.
  """

  data: EntityData
  """State and the quantities that follow from it."""
  actuation: Actuation
  """Targets and actuator models."""
  sim: Simulation
  """The simulation that the entity is part of."""
  indexing: EntityIndexing
  """Places of the entity's elements in the model."""

  def __init__(self, cfg: EntityCfg, name: str, spec: mujoco.MjSpec | None = None) -> None:
    self.cfg = cfg
    owner = f"entity '{name}'"
    articulation = EntityArticulationCfg() if cfg.articulation is None else cfg.articulation
    check_fields(articulation, owner)
    self._soft_joint_pos_limit_factor = articulation.soft_joint_pos_limit_factor
    spec = _make_spec(cfg, owner) if spec is None else spec
    self.overlay = Overlay(source="none") if cfg.overlay is None else read_overlay(cfg.overlay)
    """Identified values."""
    actuators = self.overlay.edited(articulation.actuators, spec)
    super().__init__(
      name,
      spec,
      init_state=cfg.init_state,
      edits=cfg.edits,
      collisions=cfg.collisions,
      actuators=ActuatorSet(actuators, owner),
    )
    self.overlay.edit_model(self.spec)

  def initialize(self, sim: Simulation, prefix: str | None = None, rng: torch.Generator | None = None) -> None:
    """Find the entity in the simulation's model and allocate all of its memory.

    Args:
      sim: The simulation of the scene that the entity is attached to.
      prefix: Prefix of its names in the model; None for the entity's own prefix.
      rng: Source of randomness, on the simulation's device, for delays.
    """
    self.prefix = self.prefix if prefix is None else prefix
    self.num_envs = sim.num_envs
    self.sim = sim
    self.overlay.check_timestep(sim.timestep)
    self.indexing = ix = index_entity(sim.mj_model, self.prefix, self.prefix + self.root_body_name, sim.device)
    self._set_names(ix.names)
    self.actuation = Actuation(self.actuators, sim, ix, self.initial_state, prefix=self.prefix, rng=rng)
    self.data = EntityData(
      sim, ix, self.initial_state, self.actuation, self._soft_joint_pos_limit_factor, self.overlay.encoder_bias
    )
    self._columns = self._writable()
    self.reset(torch.ones(sim.num_envs, dtype=torch.bool, device=sim.device))

  def __getattr__(self, name: str) -> Any:
    if name in ("data", "actuation", "sim", "indexing"):
      raise RuntimeError(f"{self.owner} is not part of a simulation yet: initialize its scene first")
    raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

  @property
  def wide_joints(self) -> tuple[str, ...]:
    """Ball joints, which have several columns, so that ids of joints are not columns of `data.joint_pos`."""
    ix = self.indexing
    return tuple(name for name, columns in zip(ix.names["joint"], ix.q_of_joint, strict=True) if len(columns) > 1)

  def joint_columns(self, joints: Sequence[int]) -> tuple[list[int], list[int]]:
    """Return the columns of joints in `data.joint_pos`, and those in `data.joint_vel`."""
    ix = self.indexing
    q, v = ([column for joint in joints for column in of[joint]] for of in (ix.q_of_joint, ix.v_of_joint))
    return q, v

  # Running

  def reset(self, mask: torch.Tensor) -> None:
    """Reset targets of masked worlds (num_envs,) to the default pose at rest, and fill delays with them.

    The state itself does not change.
    """
    self.actuation.reset(mask)

  def write_default_root_state(self, origins: torch.Tensor | None = None, mask: Mask = None) -> None:
    """Put the root of masked worlds into the initial state, moved by `origins`, (num_envs, 3) [m]."""
    state = self.data.default_root_state
    if origins is not None:
      placed = state[:, :3] + origins.to(state.dtype)
      state = torch.cat((placed, state[:, 3:].expand(placed.shape[0], -1)), dim=-1)
    self.write_root_state(state, mask)

  def write_default_state(self, origins: torch.Tensor | None = None, mask: Mask = None) -> None:
    """Put the root and the joints of masked worlds into the initial state, moved by `origins`, (num_envs, 3) [m]."""
    self.write_default_root_state(origins, mask)
    if self.is_articulated:
      self.write_joint_state(self.data.default_joint_pos, self.data.default_joint_vel, mask)

  # Root

  def write_root_state(self, state: torch.Tensor, mask: Mask = None) -> None:
    """Set pose and velocity of a floating base, (num_envs, 13), or the pose of any other, (num_envs, 7).

    Position [m], quaternion, linear velocity of the link's origin [m/s] and angular velocity [rad/s], world frame.
    """
    if not self.is_floating:
      self.write_root_pose(state, mask)
      return
    state = self._checked("root state", state, 13)
    self.write_root_pose(state[:, :7], mask)
    self.write_root_velocity(state[:, 7:], mask)

  def write_root_pose(self, pose: torch.Tensor, mask: Mask = None) -> None:
    """Set position [m] and orientation of the root link, world frame, (num_envs, 7); the quaternion is normalised.

    A base that does not float has the pose of its mocap body.
    """
    pose = self._checked("root pose", pose, 7)
    if self.is_floating:
      self._columns["root pose"].write(pose, mask)
    else:
      self._columns["root position"].write(pose[:, :3], mask)
      self._columns["root orientation"].write(pose[:, 3:], mask)

  def write_root_velocity(self, velocity: torch.Tensor, mask: Mask = None) -> None:
    """Set linear velocity of the root link's origin [m/s] and angular velocity [rad/s], world frame, (num_envs, 6)."""
    velocity, quat = self._checked_velocity(velocity)
    angular = quat_apply_inverse(quat, velocity[:, 3:])
    self._columns["root velocity"].write(torch.cat((velocity[:, :3], angular), dim=-1), mask)

  def write_root_velocity_b(self, velocity: torch.Tensor, mask: Mask = None) -> None:
    """Set linear velocity of the root link's origin [m/s] and angular velocity [rad/s], link frame, (num_envs, 6)."""
    velocity, quat = self._checked_velocity(velocity)
    linear = quat_apply(quat, velocity[:, :3])
    self._columns["root velocity"].write(torch.cat((linear, velocity[:, 3:]), dim=-1), mask)

  def write_root_com_velocity(self, velocity: torch.Tensor, mask: Mask = None) -> None:
    """Set linear velocity of the root's mass centre [m/s] and angular velocity [rad/s], world frame, (num_envs, 6)."""
    velocity, quat = self._checked_velocity(velocity)
    arm = quat_apply(quat, self.sim.model.body_ipos[:, self.indexing.root_body])
    linear = velocity[:, :3] - torch.linalg.cross(velocity[:, 3:], arm)
    self.write_root_velocity(torch.cat((linear, velocity[:, 3:]), dim=-1), mask)

  def _checked_velocity(self, velocity: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the velocity of the root with one row per world, and the orientation of the root link."""
    velocity = self._columns["root velocity"].of(None).checked(velocity)
    return velocity.expand(self.num_envs, -1), self.data.root_link_quat_w

  # Joints

  def write_joint_state(
    self,
    position: torch.Tensor,
    velocity: torch.Tensor,
    mask: Mask = None,
    joint_ids: Selection = None,
  ) -> None:
    """Set positions (num_envs, k) [rad or m] and velocities (num_envs, k) [rad/s or m/s] of joints."""
    self.write_joint_position(position, mask, joint_ids)
    self.write_joint_velocity(velocity, mask, joint_ids)

  def write_joint_position(self, position: torch.Tensor, mask: Mask = None, joint_ids: Selection = None) -> None:
    """Set joint positions, (num_envs, k) [rad or m]; a ball joint takes four columns, a quaternion, normalised."""
    self._columns["joint position"].of(joint_ids).write(position, mask)

  def write_joint_velocity(self, velocity: torch.Tensor, mask: Mask = None, joint_ids: Selection = None) -> None:
    """Set joint velocities, (num_envs, k) [rad/s or m/s]; a ball joint takes three columns."""
    self._columns["joint velocity"].of(joint_ids).write(velocity, mask)

  # Targets

  def target_view(self, kind: Transmission, quantity: Quantity, ids: Selection = None) -> ColumnView:
    """Return a view that writes targets: resolve ids once at build, then `write` in every step.

    Args:
      kind: "joint", "tendon" or "site".
      quantity: "position" (the length of a tendon), "velocity" or "effort".
      ids: Elements of that kind.
    """
    return self._columns[f"{kind} {quantity} target"].of(ids)

  def set_joint_position_target(self, target: torch.Tensor, joint_ids: Selection = None, mask: Mask = None) -> None:
    """Set position targets of joints, (num_envs, k) [rad or m]."""
    self.target_view("joint", "position", joint_ids).write(target, mask)

  def set_joint_velocity_target(self, target: torch.Tensor, joint_ids: Selection = None, mask: Mask = None) -> None:
    """Set velocity targets of joints, (num_envs, k) [rad/s or m/s]."""
    self.target_view("joint", "velocity", joint_ids).write(target, mask)

  def set_joint_effort_target(self, target: torch.Tensor, joint_ids: Selection = None, mask: Mask = None) -> None:
    """Set effort targets of joints, (num_envs, k) [N m or N]."""
    self.target_view("joint", "effort", joint_ids).write(target, mask)

  def set_tendon_len_target(self, target: torch.Tensor, tendon_ids: Selection = None, mask: Mask = None) -> None:
    """Set length targets of tendons, (num_envs, k) [m or rad]."""
    self.target_view("tendon", "position", tendon_ids).write(target, mask)

  def set_tendon_vel_target(self, target: torch.Tensor, tendon_ids: Selection = None, mask: Mask = None) -> None:
    """Set velocity targets of tendons, (num_envs, k) [m/s or rad/s]."""
    self.target_view("tendon", "velocity", tendon_ids).write(target, mask)

  def set_tendon_effort_target(self, target: torch.Tensor, tendon_ids: Selection = None, mask: Mask = None) -> None:
    """Set effort targets along tendons, (num_envs, k) [N or N m]."""
    self.target_view("tendon", "effort", tendon_ids).write(target, mask)

  def set_site_pos_target(self, target: torch.Tensor, site_ids: Selection = None, mask: Mask = None) -> None:
    """Set position targets of sites, along their gear from the reference site, (num_envs, k) [m or rad]."""
    self.target_view("site", "position", site_ids).write(target, mask)

  def set_site_vel_target(self, target: torch.Tensor, site_ids: Selection = None, mask: Mask = None) -> None:
    """Set velocity targets of sites along their gear, (num_envs, k) [m/s or rad/s]."""
    self.target_view("site", "velocity", site_ids).write(target, mask)

  def set_site_effort_target(self, target: torch.Tensor, site_ids: Selection = None, mask: Mask = None) -> None:
    """Set effort targets of sites, times their gear the wrench, (num_envs, k) [N or N m]."""
    self.target_view("site", "effort", site_ids).write(target, mask)

  # Forces and controls

  def write_external_wrench(
    self,
    forces: torch.Tensor,
    torques: torch.Tensor,
    body_ids: Selection = None,
    mask: Mask = None,
  ) -> None:
    """Apply forces [N] and torques [N m] to bodies at their centres of mass, world frame, (num_envs, k, 3) each.

    They act in every substep until they are overwritten or the world is reset.
    """
    wrench = torch.cat(torch.broadcast_tensors(forces, torques), dim=-1)
    self._columns["external wrench"].of(body_ids).write(wrench, mask)

  def set_ctrl(self, ctrl: torch.Tensor, mask: Mask = None) -> None:
    """Set the controls of all actuators of the entity, (num_envs, num_ctrl), in the model's order.

    For actuators without a config; controls of configured actuators are written again in the next substep.
    """
    self._columns["control"].of(None).write(ctrl, mask)

  # Columns

  def _writable(self) -> dict[str, ColumnView]:
    """Return the columns that methods write, by name in messages."""
    data, ix, views = self.sim.data, self.indexing, dict[str, ColumnView]()

    def add(name: str, tensor: torch.Tensor, columns: Sequence[range], lack: str = "") -> None:
      is_turn = name in ("joint position", "root pose", "root orientation")
      views[name] = ColumnView(tensor, columns, f"{self.owner}: {name}", lack, quaternions=is_turn)

    add("joint position", data.qpos, ix.qpos_of_joint, _NO_JOINTS)
    add("joint velocity", data.qvel, ix.qvel_of_joint, _NO_JOINTS)
    add("external wrench", data.xfrc_applied, [range(i, i + 1) for i in ix.ids["body"].tolist()])
    add("control", data.ctrl, ix.ctrl_of_actuator, "it has no actuators")
    if ix.root_q is not None:
      start = ix.root_q.start
      add("root pose", data.qpos, (range(start, start + 3), range(start + 3, start + 7)))
    elif ix.mocap is not None:
      add("root position", data.mocap_pos[:, ix.mocap], (range(3),))
      add("root orientation", data.mocap_quat[:, ix.mocap], (range(4),))
    velocity = () if ix.root_v is None else (range(ix.root_v.start, ix.root_v.stop),)
    add("root velocity", data.qvel, velocity, "its base does not float, so it has no velocity to set")
    for (kind, quantity), targets in self.actuation.views.items():
      columns, lack = [range(i, i + 1) for i in range(targets.shape[1])], f"no actuator config drives a {kind} of it"
      if kind == "joint":
        columns, lack = ix.q_of_joint if quantity == "position" else ix.v_of_joint, _NO_JOINTS
      elif not self.actuators.driven(kind):
        columns = []
      add(f"{kind} {quantity} target", targets, columns, lack)
    return views

  def _checked(self, name: str, value: torch.Tensor, columns: int) -> torch.Tensor:
    return fitting(value, (self.num_envs, columns), self.sim.dtype, f"{self.owner}: {name}")


def _make_spec(cfg: EntityCfg, owner: str) -> mujoco.MjSpec:
  try:
    spec = cfg.spec_fn() if callable(cfg.spec_fn) else None
  except (ValueError, OSError) as error:
    raise MjlabError(f"{owner}: its model cannot be made: {error}") from error
  return require(spec, mujoco.MjSpec, f"{owner}: spec_fn must be a function that returns an MjSpec")
