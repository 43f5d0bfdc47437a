"""A robot as an entity of a scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Protocol

import mujoco
from mjlab_actuators import ActuatorCfg
from mjlab_core.names import unknown

from mjlab_robots.meshes import MeshMode

if TYPE_CHECKING:
  from mjlab_scene import CollisionCfg, EntityCfg


class SpecFn(Protocol):
  """What `go1_spec` and its like are."""

  def __call__(self, meshes: MeshMode = "auto") -> mujoco.MjSpec: ...


def robot_entity(
  spec_fn: SpecFn,
  *,
  meshes: MeshMode,
  height: float,
  joint_pos: Mapping[str, float],
  actuators: Sequence[ActuatorCfg],
  soft_joint_pos_limit_factor: float,
  collision: str,
  presets: Callable[[], Mapping[str, tuple[CollisionCfg, ...]]],
) -> EntityCfg:
  """A new config, to be changed at will: it shares nothing with the arguments.

  Args:
    spec_fn: Makes the robot's spec.
    meshes: What `spec_fn` is called with.
    height: Of the root body's origin in the default pose [m].
    joint_pos: Default pose by joint pattern [rad].
    actuators: In the order of `ctrl`.
    soft_joint_pos_limit_factor: Soft limits are this share of each joint's range, about its middle.
    collision: Name of a contact preset; "full" is what the MJCF says.
    presets: Makes the others: what differs from the contact parameters in the MJCF.

  Raises:
    ValueError: There is no such preset.
  """
  # Imported here: a spec alone has no use for torch.
  from mjlab_scene import EntityArticulationCfg, EntityCfg, InitialStateCfg

  choices = {"full": (), **presets()}
  if collision not in choices:
    raise ValueError(unknown("collision preset", collision, list(choices)))
  return EntityCfg(
    spec_fn=spec_fn if meshes == "auto" else partial(spec_fn, meshes=meshes),
    init_state=InitialStateCfg(pos=(0.0, 0.0, height), joint_pos=dict(joint_pos)),
    articulation=EntityArticulationCfg(
      actuators=tuple(replace(actuator) for actuator in actuators),
      soft_joint_pos_limit_factor=soft_joint_pos_limit_factor,
    ),
    collisions=choices[collision],
  )
