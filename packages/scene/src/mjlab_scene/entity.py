"""One class for every physical thing in a scene."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import mujoco
import torch
from mjlab_actuators import ActuatorSet
from mjlab_core.masking import fill_, where_

from mjlab_scene.actuator_columns import ActuatorColumns
from mjlab_scene.collision import apply_collisions
from mjlab_scene.element_names import KINDS, name_everything, spec_names
from mjlab_scene.entity_cfg import EntityArticulationCfg, EntityCfg
from mjlab_scene.entity_data import EntityData
from mjlab_scene.entity_names import EntityNames
from mjlab_scene.entity_writes import Columns, EntityWrites
from mjlab_scene.indexing import EntityIndexing, index_entity
from mjlab_scene.initial_state import InitialState, read_initial_state

if TYPE_CHECKING:
  from mjlab_sim import Simulation

MOCAP_BASE = "mocap_base"
"""Body that the scene puts above a fixed base, to place it per world."""


class Entity(EntityNames, EntityWrites):
  """A robot, an object or a fixture: fixed, floating or mocap base, with or without joints.

  Built from its configuration it is only a spec, edited: everything named, contact presets and actuators applied.
  `attach` puts it into a scene, `initialize` ties it to the simulation of that scene; from then on `data` can be read
  and the `write_*` methods used.

  All names are local: what the scene calls "robot/left/elbow" the entity "robot" calls "left/elbow".

  Raises:
    ValueError: anything wrong in the configuration, by name.
  """

  _children = ("data", "actuators")

  def __init__(self, cfg: EntityCfg, name: str) -> None:
    if not name or "/" in name:
      raise ValueError(f"entity name {name!r} must be a word without '/'")
    self.cfg = cfg
    self.name = name
    owner = f"entity '{name}'"
    articulation = EntityArticulationCfg() if cfg.articulation is None else cfg.articulation
    factor = articulation.soft_joint_pos_limit_factor
    if not 0.0 < factor <= 1.0:
      raise ValueError(f"{owner}: soft_joint_pos_limit_factor {factor} must be in (0, 1]")
    self._soft_joint_pos_limit_factor = factor
    self.spec = _make_spec(cfg, owner)
    """The entity alone; attaching moves its contents into the scene."""
    name_everything(self.spec)
    own_root = _find_root(self.spec, owner)
    self.is_floating = own_root is not None and _floats(own_root)
    """Whether the base has a free joint."""
    self._wrapped = own_root is None or not (self.is_floating or own_root.mocap)
    apply_collisions(self.spec, cfg.collisions, owner)
    self.actuators = ActuatorSet(articulation.actuators, owner) if articulation.actuators else None
    """What drives joints, tendons and sites; None if nothing is configured to."""
    if self.actuators is not None:
      self.actuators.edit_spec(self.spec)
      name_everything(self.spec)
    self.initial_state: InitialState = read_initial_state(
      self.spec, cfg.init_state, None if self._wrapped else own_root, self.is_floating, owner
    )
    """Where the entity starts, by local name."""
    self.prefix = f"{name}/"
    """What the scene puts before the entity's names."""
    self.root_body_name: str = MOCAP_BASE if self._wrapped or own_root is None else own_root.name
    """Local name of the body that `root_*` quantities and writes are about."""
    self._names = {kind: spec_names(self.spec, kind) for kind in KINDS}
    if self._wrapped:
      self._names["body"] = (MOCAP_BASE, *self._names["body"])
    self._indexing: EntityIndexing | None = None
    self._data: EntityData | None = None
    self._sim: Simulation | None = None
    self._columns_of: dict[tuple[object, ...], tuple[object, Columns]] = {}
    self._actuator_columns: ActuatorColumns | None = None
    self._written: tuple[int, bool] | None = None

  # Building

  def attach(self, scene: mujoco.MjSpec) -> None:
    """Move the entity into the spec of a scene, under its prefix; its keyframes are left behind."""
    for key in list(self.spec.keys):
      self.spec.delete(key)
    pose = self.initial_state.root_pose
    if self._wrapped:
      base = scene.worldbody.add_body(name=self.prefix + MOCAP_BASE, mocap=True, pos=pose[:3], quat=pose[3:])
      self._attach(scene, base.add_frame())
      return
    self._attach(scene, scene.worldbody.add_frame())
    if not self.is_floating:
      root = scene.body(self.prefix + self.root_body_name)
      root.pos, root.quat = pose[:3], pose[3:]
      root.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT

  def _attach(self, scene: mujoco.MjSpec, frame: mujoco.MjsFrame) -> None:
    with warnings.catch_warnings():
      # Its files are found where they are, also where the scene holds others in memory.
      warnings.filterwarnings("ignore", message="Attaching a child without asset dict")
      scene.attach(self.spec, prefix=self.prefix, frame=frame)

  def initialize(self, sim: Simulation, prefix: str | None = None, rng: torch.Generator | None = None) -> None:
    """Find the entity in the simulation's model and allocate all of its memory.

    Args:
      sim: The simulation of the scene that the entity is attached to.
      prefix: What precedes its names in the model; None for the entity's own prefix.
      rng: Source of randomness, on the simulation's device, for delays.
    """
    self.prefix = self.prefix if prefix is None else prefix
    self.num_envs = sim.num_envs
    self._sim = sim
    indexing = index_entity(sim.mj_model, self.prefix, self.prefix + self.root_body_name, sim.device)
    self._indexing = indexing
    self._names = indexing.names
    self._columns_of.clear()
    data = EntityData(sim, indexing, self.initial_state, self._soft_joint_pos_limit_factor)
    self._data = data
    if self.actuators is not None:
      self._actuator_columns = ActuatorColumns(
        self.actuators, sim, indexing, data, self.initial_state, prefix=self.prefix, rng=rng
      )
    self._written = None
    self.reset(torch.ones(sim.num_envs, dtype=torch.bool, device=sim.device))

  # Running

  def reset(self, mask: torch.Tensor) -> None:
    """Set-points of masked worlds to the default pose, at rest, and delays as if they had always been that.

    The state itself is left to whoever resets it.
    """
    data = self.data
    where_(data.joint_pos_target, mask, data.default_joint_pos)
    fill_(data.joint_vel_target, mask, 0.0)
    fill_(data.joint_effort_target, mask, 0.0)
    if self._actuator_columns is not None:
      self._actuator_columns.reset(mask)
    # The simulation's reset clears controls.
    self._written = None

  def write_default_root_state(self, origins: torch.Tensor | None = None, mask: torch.Tensor | None = None) -> None:
    """Put the root of masked worlds into the initial state, moved by `origins`, (num_envs, 3) [m]."""
    state = self.data.default_root_state
    if origins is not None:
      placed = state[:, :3] + origins.to(state.dtype)
      state = torch.cat((placed, state[:, 3:].expand(placed.shape[0], -1)), dim=-1)
    self.write_root_state(state, mask)

  def write_default_state(self, origins: torch.Tensor | None = None, mask: torch.Tensor | None = None) -> None:
    """Put the root and the joints of masked worlds into the initial state, moved by `origins`, (num_envs, 3) [m]."""
    self.write_default_root_state(origins, mask)
    if self.is_articulated:
      self.write_joint_state(self.data.default_joint_pos, self.data.default_joint_vel, mask)

  def write_ctrl(self) -> None:
    """Turn set-points into controls; to be called exactly once before each substep."""
    columns = self._actuator_columns
    if columns is None:
      return
    if columns.follows_set_points_only:
      # Servos inside MuJoCo hold their set-point: within a decimation there is nothing to write twice.
      # The first substep of a recording writes whatever was written before it: each replay starts from new set-points.
      written = (columns.version, self.sim.is_capturing)
      if written == self._written:
        return
      self._written = written
    columns.compute()

  # What it is

  @property
  def data(self) -> EntityData:
    """What can be known about the entity; RuntimeError before `initialize`."""
    if self._data is None:
      raise RuntimeError(f"entity '{self.name}' is not part of a simulation yet: initialize its scene first")
    return self._data

  @property
  def sim(self) -> Simulation:
    """The simulation that the entity is part of; RuntimeError before `initialize`."""
    if self._sim is None:
      raise RuntimeError(f"entity '{self.name}' is not part of a simulation yet: initialize its scene first")
    return self._sim

  @property
  def indexing(self) -> EntityIndexing:
    """Where the entity is in the model; RuntimeError before `initialize`."""
    if self._indexing is None:
      raise RuntimeError(f"entity '{self.name}' is not part of a simulation yet: initialize its scene first")
    return self._indexing

  @property
  def is_fixed_base(self) -> bool:
    """Whether the base does not float; it is then a mocap body, its own or the scene's."""
    return not self.is_floating

  @property
  def is_mocap(self) -> bool:
    """Whether the model itself makes the root a mocap body."""
    return not self.is_floating and not self._wrapped

  @property
  def is_articulated(self) -> bool:
    """Whether it has joints other than the free one."""
    return bool(self._names["joint"])

  @property
  def wide_joints(self) -> tuple[str, ...]:
    """Joints of several columns, ball joints: beside one, ids of joints are not columns of `data.joint_pos`."""
    ix = self.indexing
    return tuple(name for name, columns in zip(ix.names["joint"], ix.q_of_joint, strict=True) if len(columns) > 1)

  @property
  def is_actuated(self) -> bool:
    """Whether actuators are configured to drive its joints, tendons or sites."""
    return self.actuators is not None

  def _selections(self) -> dict[tuple[object, ...], tuple[object, Columns]]:
    return self._columns_of


def _floats(body: mujoco.MjsBody) -> bool:
  return any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints)


def _make_spec(cfg: EntityCfg, owner: str) -> mujoco.MjSpec:
  try:
    spec = cfg.spec_fn() if callable(cfg.spec_fn) else None
  except (ValueError, OSError) as error:
    raise ValueError(f"{owner}: its model cannot be made: {error}") from error
  if not isinstance(spec, mujoco.MjSpec):
    raise ValueError(f"{owner}: spec_fn must be a function that returns an MjSpec")
  return spec


def _find_root(spec: mujoco.MjSpec, owner: str) -> mujoco.MjsBody | None:
  """The body with the free joint, wherever it is; else a mocap body on top level; else the first body, if any."""
  floating = [body for body in spec.bodies if _floats(body)]
  if len(floating) > 1:
    names = ", ".join(f"'{body.name}'" for body in floating)
    raise ValueError(
      f"{owner}: an entity has at most one free joint, and bodies {names} have one each; make it several"
    )
  top = [body for body in spec.bodies[1:] if body.parent.name == "world"]
  if floating:
    if floating[0] not in top and floating[0].name not in [body.name for body in top]:
      raise ValueError(f"{owner}: body '{floating[0].name}' has a free joint but is not on top level")
    return floating[0]
  mocap = [body for body in top if body.mocap]
  if mocap:
    return mocap[0]
  return top[0] if top else None
