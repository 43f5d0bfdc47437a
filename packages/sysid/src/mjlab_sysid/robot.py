"""A robot on a stand, as its records are explained: a model, its actuator models, and a pose."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_actuators import ActuatorCfg, ActuatorSet
from mjlab_core.errors import MjlabError
from mjlab_core.names import match_values_full

_SCALAR = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True, kw_only=True)
class Robot:
  """A compiled model whose base does not move, with its actuator models."""

  model: mujoco.MjModel
  """The model."""
  actuators: tuple[ActuatorCfg, ...]
  """Actuator models, without delay: records are delayed by the parameter `delay`."""
  delays: Mapping[str, float]
  """Mean delay of the set-points by driven joint, as configured [s]."""
  pose: np.ndarray
  """Positions of what no record moves, (nq,) [rad or m]."""

  @property
  def joints(self) -> tuple[str, ...]:
    """Names of hinges and slides."""
    return tuple(
      self.model.joint(i).name for i in range(self.model.njnt) if mujoco.mjtJoint(self.model.jnt_type[i]) in _SCALAR
    )

  def ranges(self) -> dict[str, tuple[float, float]]:
    """Return the range of each joint [rad or m]; infinite without limits."""
    out = {}
    for name in self.joints:
      joint = self.model.joint(name)
      low, high = joint.range if self.model.jnt_limited[joint.id] else (-np.inf, np.inf)
      out[name] = (float(low), float(high))
    return out

  def addresses(self, joints: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return places of joints in qpos and in qvel."""
    ids = [self.model.joint(name).id for name in joints]
    return self.model.jnt_qposadr[ids].copy(), self.model.jnt_dofadr[ids].copy()

  def actuation(self, num_worlds: int, ctrl: torch.Tensor | None) -> ActuatorSet:
    """Return the actuator models of so many worlds, in float64, which write into `ctrl`, (num_worlds, nu)."""
    return ActuatorSet(self.actuators).build(
      self.model, num_envs=num_worlds, device="cpu", dtype=torch.float64, ctrl=ctrl
    )


def robot_on_stand(
  spec: mujoco.MjSpec,
  actuators: Sequence[ActuatorCfg],
  *,
  pose: Mapping[str, float] | None = None,
  timestep: float | None = None,
  height: float | None = None,
  floor: float | None = None,
) -> Robot:
  """Return a robot whose base is held where it is.

  Args:
    spec: Model of the robot, to which `ActuatorSet(actuators).edit_spec` has added the actuators; it is copied.
    actuators: Actuator models in the order of `ctrl`.
    pose: Default positions by joint pattern [rad or m]; 0 elsewhere.
    timestep: Timestep of the simulation that uses the parameters [s]; None for the spec's.
    height: Height of the root body [m]; None for the spec's.
    floor: Height of a floor that the robot may touch [m]; None for no floor.

  Raises:
    MjlabError: The spec cannot be compiled.
  """
  spec = spec.copy()
  for joint in list(spec.joints):
    if joint.type == mujoco.mjtJoint.mjJNT_FREE:
      base = joint.parent
      spec.delete(joint)
      # MuJoCo lets a body collide with its parent once that does not move.
      for child in base.bodies:
        spec.add_exclude(bodyname1=base.name, bodyname2=child.name)
  for key in list(spec.keys):
    spec.delete(key)
  if height is not None:
    spec.worldbody.first_body().pos[2] = height
  if floor is not None:
    # The foot's friction counts, not the floor's.
    spec.worldbody.add_geom(
      name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], pos=[0, 0, floor], friction=[1e-6, 0.0, 0.0]
    )
  if timestep is not None:
    spec.option.timestep = timestep
  try:
    model = spec.compile()
  except ValueError as error:
    raise MjlabError(f"the robot on its stand does not compile: {error}") from error
  cfgs = tuple(
    dataclasses.replace(cfg, delay_min_lag=0, delay_max_lag=0, delay_hold_prob=0.0, delay_update_period=0)
    for cfg in actuators
  )
  robot = Robot(model=model, actuators=cfgs, delays={}, pose=model.qpos0.copy())
  names = robot.actuation(1, None).driven("joint")
  delays: dict[str, float] = {}
  for cfg in actuators:
    mean = 0.5 * (cfg.delay_min_lag + cfg.delay_max_lag) * model.opt.timestep
    matched: Any = cfg.match(robot.joints) if cfg.transmission_type == "joint" else ()
    delays |= dict.fromkeys(matched, mean)
  found = match_values_full(dict(pose or {}), robot.joints, what="joint", owner="pose", default=0.0)
  addresses, _ = robot.addresses(robot.joints)
  values = model.qpos0.copy()
  values[addresses] = found
  return dataclasses.replace(robot, delays={name: delays.get(name, 0.0) for name in names}, pose=values)
