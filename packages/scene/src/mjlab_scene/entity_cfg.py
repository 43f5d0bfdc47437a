"""What an entity is made of: a spec, an initial state, actuators and contact presets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
from mjlab_actuators import ActuatorCfg

from mjlab_scene.collision import CollisionCfg

if TYPE_CHECKING:
  from mjlab_scene.entity import Entity


@dataclass(kw_only=True)
class InitialStateCfg:
  """The state an entity is reset to, relative to the origin of its world.

  Patterns are matched as a whole against names; a pattern that matches nothing is an error. A joint that no pattern
  names keeps the model's reference position (zero unless the model says otherwise) and zero velocity.
  """

  pos: tuple[float, float, float] | None = None
  """Position of the root body [m]; None: the keyframe's if `joint_pos` is None, else the model's (fixed base: zero)."""
  rot: tuple[float, float, float, float] | None = None
  """Orientation of the root body, unit quaternion (w, x, y, z); None: as for `pos`."""
  lin_vel: tuple[float, float, float] = (0.0, 0.0, 0.0)
  """Linear velocity of the root link's origin, world frame [m/s]; floating base only."""
  ang_vel: tuple[float, float, float] = (0.0, 0.0, 0.0)
  """Angular velocity of the root link, world frame [rad/s]; floating base only."""
  joint_pos: Mapping[str, float | tuple[float, float, float, float]] | None = field(default_factory=dict)
  """Joint positions by pattern [rad or m], a quaternion for a ball joint; None takes the model's first keyframe."""
  joint_vel: Mapping[str, float | tuple[float, float, float]] = field(default_factory=dict)
  """Joint velocities by pattern [rad/s or m/s], three numbers for a ball joint."""
  ctrl: Mapping[str, float] = field(default_factory=dict)
  """Controls of the scene's keyframe by actuator pattern; a position servo defaults to its joint's initial position."""


@dataclass(kw_only=True)
class EntityArticulationCfg:
  """How an entity is driven and its joints are limited."""

  actuators: tuple[ActuatorCfg, ...] = ()
  """Actuator groups; a joint, tendon or site is driven by at most one of them."""
  soft_joint_pos_limit_factor: float = 1.0
  """Soft position limits span this fraction of the joint's range about its middle, in (0, 1]."""


@dataclass(kw_only=True)
class EntityCfg:
  """One robot, object or fixture.

  The base is floating if the spec holds a free joint (at most one), a mocap body if its root body is one, and fixed
  otherwise; a fixed base is placed per world through a mocap body "mocap_base" that the scene puts above it.
  """

  spec_fn: Callable[[], mujoco.MjSpec]
  """Returns a new spec each time it is called; the entity edits it."""
  init_state: InitialStateCfg = field(default_factory=InitialStateCfg)
  articulation: EntityArticulationCfg | None = None
  """None: nothing is actuated by mjlab; actuators in the model keep the controls that the user writes."""
  collisions: tuple[CollisionCfg, ...] = ()
  """Contact presets; together they say which geoms collide."""

  def build(self, name: str) -> Entity:
    """The entity this describes, under `name`."""
    from mjlab_scene.entity import Entity

    return Entity(self, name)
