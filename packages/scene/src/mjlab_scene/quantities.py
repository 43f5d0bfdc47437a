"""Quantities that follow from the state of a simulation, computed at most once for each state."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

import torch
from mjlab_core import Index, quat_mul, select

from mjlab_scene.entities.indexing import EntityIndexing, Frames

if TYPE_CHECKING:
  from mjlab_sim import Simulation


class QuantityCache:
  """Values of an object's `cached_quantity` properties, valid for one version of the simulation's state."""

  def __init__(self, sim: Simulation) -> None:
    self._sim = sim
    self._version: tuple[int, bool] | None = None
    self._values: dict[str, torch.Tensor] = {}

  def get(self, name: str, compute: Callable[[Any], torch.Tensor], owner: Any) -> torch.Tensor:
    """Return the value under `name`, computed from `owner` if this state has none yet."""
    # A recording must contain what it computes, and a replay must not use what was computed while recording.
    version = (self._sim.version, self._sim.is_capturing)
    if version != self._version:
      self._values.clear()
      self._version = version
    value = self._values.get(name)
    if value is None:
      value = compute(owner)
      self._values[name] = value
    return value


def cached_quantity(compute: Callable[[Any], torch.Tensor]) -> torch.Tensor:
  """Decorate a method without arguments, of an object that has a `QuantityCache` as `cache`, to be a cached property.

  All readers of a state may share the tensor, so it must not be written to.
  """
  name = getattr(compute, "__name__", "")

  def read(owner: Any) -> torch.Tensor:
    return owner.cache.get(name, compute, owner)

  return cast("torch.Tensor", property(read, doc=compute.__doc__))


def forwarded(path: str) -> torch.Tensor:
  """Return a property that reads a part of its object: `forwarded("_links.pos")` reads `self._links.pos`."""
  return cast("torch.Tensor", property(operator.attrgetter(path)))


def rows(tensor: torch.Tensor, places: Index | int) -> torch.Tensor:
  """Return the rows of elements, (num_envs, n, ...), or (num_envs, ...) of a single one."""
  return tensor[:, places] if isinstance(places, int) else select(tensor, places)


class FrameQuantities:
  """Poses and velocities of frames of an entity, world frame.

  Args:
    sim: The simulation.
    frames: Places of n frames, or of a single one, whose quantities lack the dimension n.
    position: Array of positions in `sim.data`.
    turn: Model field with the orientation of a frame in its body; None for the frame of the body itself.
  """

  def __init__(self, sim: Simulation, frames: Frames, position: str, turn: str | None = None) -> None:
    self.cache = QuantityCache(sim)
    self._sim, self._frames, self._position, self._turn = sim, frames, position, turn

  @cached_quantity
  def pose(self) -> torch.Tensor:
    """Position and orientation, (num_envs, n, 7) [m, 1]."""
    return torch.cat((self.pos, self.quat), dim=-1)

  @cached_quantity
  def pos(self) -> torch.Tensor:
    """Position of the origin, (num_envs, n, 3) [m]."""
    return rows(getattr(self._sim.data, self._position), self._frames.ids)

  @cached_quantity
  def quat(self) -> torch.Tensor:
    """Orientation, (num_envs, n, 4) [1]."""
    body = rows(self._sim.data.xquat, self._frames.bodies)
    return body if self._turn is None else quat_mul(body, rows(getattr(self._sim.model, self._turn), self._frames.ids))

  @cached_quantity
  def vel(self) -> torch.Tensor:
    """Velocity at the origin, linear then angular, (num_envs, n, 6) [m/s, rad/s]."""
    return torch.cat((self.lin_vel, self.ang_vel), dim=-1)

  @cached_quantity
  def lin_vel(self) -> torch.Tensor:
    """Linear velocity at the origin, (num_envs, n, 3) [m/s].

    MuJoCo gives the velocity of each body at the centre of mass of its kinematic tree.
    """
    twist = rows(self._sim.data.cvel, self._frames.bodies)
    arm = self.pos - rows(self._sim.data.subtree_com, self._frames.trees)
    return twist[..., 3:] + torch.linalg.cross(twist[..., :3], arm)

  @cached_quantity
  def ang_vel(self) -> torch.Tensor:
    """Angular velocity, (num_envs, n, 3) [rad/s]."""
    return rows(self._sim.data.cvel, self._frames.bodies)[..., :3]


class Root:
  """Pose and velocity of an entity's root body: in the world, and in its own frame as sensors on it see them.

  A base that does not float has no velocity.
  """

  def __init__(self, sim: Simulation, indexing: EntityIndexing) -> None:
    self.cache = QuantityCache(sim)
    self._sim, self._body = sim, indexing.root_body
    self.com = FrameQuantities(sim, indexing.frames["root"], "xipos", "body_iquat")
    zeros = torch.zeros((sim.num_envs, 6), dtype=sim.dtype, device=sim.device)
    self.lin_vel, self.ang_vel_b = zeros[:, :3], zeros[:, 3:]
    self._pose: torch.Tensor | None = None
    if indexing.root_q is not None and indexing.root_v is not None:
      self._pose = sim.data.qpos[:, indexing.root_q]
      self.pos, self.quat = self._pose[:, :3], self._pose[:, 3:]
      velocity = sim.data.qvel[:, indexing.root_v]
      self.lin_vel, self.ang_vel_b = velocity[:, :3], velocity[:, 3:]
    else:
      assert indexing.mocap is not None
      self.pos, self.quat = sim.data.mocap_pos[:, indexing.mocap], sim.data.mocap_quat[:, indexing.mocap]
    self._floats = self._pose is not None
    x, y, z = sim.mj_model.opt.gravity.tolist()
    self._straight_down = x == 0.0 and y == 0.0 and z <= 0.0
    self._default_gravity = _direction(sim.default_field("opt.gravity"))

  @property
  def pose(self) -> torch.Tensor:
    """Pose of the link, world frame, (num_envs, 7) [m, 1]; a view if the base floats."""
    return self._mocap_pose if self._pose is None else self._pose

  @cached_quantity
  def _mocap_pose(self) -> torch.Tensor:
    return torch.cat((self.pos, self.quat), dim=-1)

  @cached_quantity
  def vel(self) -> torch.Tensor:
    """Velocity of the link at its origin, world frame, (num_envs, 6) [m/s, rad/s]."""
    return torch.cat((self.lin_vel, self.ang_vel), dim=-1)

  @cached_quantity
  def ang_vel(self) -> torch.Tensor:
    """Angular velocity, world frame, (num_envs, 3) [rad/s]."""
    return (self._xmat * self.ang_vel_b.unsqueeze(-2)).sum(-1) if self._floats else self.ang_vel_b

  @cached_quantity
  def lin_vel_b(self) -> torch.Tensor:
    """Linear velocity of the link at its origin, root link frame, (num_envs, 3) [m/s]."""
    return self._into_root(self.lin_vel)

  @cached_quantity
  def com_lin_vel_b(self) -> torch.Tensor:
    """Linear velocity at the centre of mass, root link frame, (num_envs, 3) [m/s]."""
    return self._into_root(self.com.lin_vel)

  @cached_quantity
  def projected_gravity(self) -> torch.Tensor:
    """Unit vector along gravity, root link frame, (num_envs, 3) [1]."""
    if self._straight_down and not self._sim.is_expanded("opt.gravity"):
      return -self._xmat[:, 2]
    return self._into_root(self.gravity)

  @cached_quantity
  def heading(self) -> torch.Tensor:
    """Angle from the world's x axis to the root link's, about the vertical, (num_envs,) [rad]."""
    return torch.atan2(self._xmat[:, 1, 0], self._xmat[:, 0, 0])

  @property
  def gravity(self) -> torch.Tensor:
    """Unit vector along gravity, world frame, (1, 3), or (num_envs, 3) once gravity is randomised [1]."""
    return self._gravity if self._sim.is_expanded("opt.gravity") else self._default_gravity

  @cached_quantity
  def _gravity(self) -> torch.Tensor:
    return _direction(self._sim.model.opt.gravity)

  @cached_quantity
  def _xmat(self) -> torch.Tensor:
    return self._sim.data.xmat[:, self._body]

  def _into_root(self, vector: torch.Tensor) -> torch.Tensor:
    return (self._xmat * vector.unsqueeze(-1)).sum(-2)


def _direction(gravity: torch.Tensor) -> torch.Tensor:
  norm = torch.linalg.vector_norm(gravity, dim=-1, keepdim=True)
  down = torch.zeros_like(gravity)
  down[:, 2] = -1.0
  return torch.where(norm > 0, gravity / norm.clamp_min(1e-12), down)
