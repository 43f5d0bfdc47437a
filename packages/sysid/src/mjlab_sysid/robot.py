"""Robot of records: a model, held by its base or free, its actuator models, and a pose."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_actuators import ActuatorCfg, ActuatorSet
from mjlab_core.errors import MjlabError
from mjlab_core.names import check_name, match_values_full

IMU = {
  "angular_velocity": mujoco.mjtSensor.mjSENS_GYRO,
  "linear_acceleration": mujoco.mjtSensor.mjSENS_ACCELEROMETER,
}
"""Sensors of an IMU by signal."""
_SCALAR = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True, kw_only=True)
class Robot:
  """A compiled model with its actuator models."""

  model: mujoco.MjModel
  """The model."""
  spec: mujoco.MjSpec
  """Specification that the model was compiled from."""
  actuators: tuple[ActuatorCfg, ...]
  """Actuator models, without delay: records are delayed by the parameter `delay`."""
  delays: Mapping[str, float]
  """Mean delay of the targets by driven joint, as configured [s]; 0 for the others."""
  pose: np.ndarray
  """Positions of joints that no record moves, (nq,) [rad or m]."""
  base: str | None = None
  """Name of the free joint of a base that moves; None if it is held."""
  has_imu: bool = False
  """True if the model has an IMU on a body that moves."""

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

  def actuation(self, ctrl: torch.Tensor) -> ActuatorSet:
    """Return the actuator models of many worlds, which write into `ctrl`, (num_worlds, nu)."""
    return ActuatorSet(self.actuators).build(
      self.model, num_envs=len(ctrl), device=ctrl.device, dtype=ctrl.dtype, ctrl=ctrl
    )


def robot_on_stand(
  spec: mujoco.MjSpec,
  actuators: Sequence[ActuatorCfg],
  *,
  pose: Mapping[str, float] | None = None,
  timestep: float | None = None,
  height: float | None = None,
  floor: float | None = None,
  imu: str | None = None,
) -> Robot:
  """Return a robot with a held base.

  Args:
    spec: Model of the robot, to which `ActuatorSet(actuators).edit_spec` has added the actuators; it is copied.
    actuators: Actuator models in the order of `ctrl`.
    pose: Default positions by joint pattern [rad or m]; 0 elsewhere.
    timestep: Timestep of the simulation that uses the parameters [s]; None for the spec's.
    height: Height of the root body [m]; None for the spec's.
    floor: Height of a floor that the robot may touch [m]; None for no floor.
    imu: Site of the IMU; None for that of the model's first gyro or accelerometer.

  Raises:
    UnknownNameError: A joint or the site does not exist.
    MjlabError: The spec cannot be compiled.
  """
  spec = spec.copy()
  for joint in list(spec.joints):
    if joint.type == mujoco.mjtJoint.mjJNT_FREE:
      base = joint.parent
      spec.delete(joint)
      # MuJoCo lets a body collide with a parent that does not move.
      for child in base.bodies:
        spec.add_exclude(bodyname1=base.name, bodyname2=child.name)
  if height is not None:
    spec.worldbody.first_body().pos[2] = height
  return _robot(spec, actuators, pose, timestep, floor, imu)


def robot_on_ground(
  spec: mujoco.MjSpec,
  actuators: Sequence[ActuatorCfg],
  *,
  pose: Mapping[str, float] | None = None,
  timestep: float | None = None,
  floor: float | None = 0.0,
  imu: str | None = None,
) -> Robot:
  """Return a robot with a free base; its records need `base_position` and `base_orientation`.

  Args and errors are those of `robot_on_stand`.

  Raises:
    MjlabError: The robot has no free joint, or more than one.
  """
  spec = spec.copy()
  free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
  if len(free) != 1:
    raise MjlabError(f"the robot has {len(free)} free joints; a base that moves has one")
  free[0].name = free[0].name or "free"
  return dataclasses.replace(_robot(spec, actuators, pose, timestep, floor, imu), base=free[0].name)


def _robot(
  spec: mujoco.MjSpec,
  actuators: Sequence[ActuatorCfg],
  pose: Mapping[str, float] | None,
  timestep: float | None,
  floor: float | None,
  imu: str | None,
) -> Robot:
  for key in list(spec.keys):
    spec.delete(key)
  if floor is not None:
    # The foot's friction counts, not the floor's.
    spec.worldbody.add_geom(
      name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], pos=[0, 0, floor], friction=[1e-6, 0.0, 0.0]
    )
  if timestep is not None:
    spec.option.timestep = timestep
  site = _site_of_imu(spec, imu)
  # Nothing reads other sensors.
  for sensor in list(spec.sensors):
    spec.delete(sensor)
  model = _compiled(spec)
  # An IMU on a body that is fixed to the world measures no motion.
  has_imu = bool(site) and model.body_weldid[model.site_bodyid[model.site(site).id]] != 0
  if has_imu:
    for name, kind in IMU.items():
      spec.add_sensor(name=f"sysid/{name}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)
    model = _compiled(spec)
  cfgs = tuple(
    dataclasses.replace(cfg, delay_min_lag=0, delay_max_lag=0, delay_hold_prob=0.0, delay_update_period=0)
    for cfg in actuators
  )
  robot = Robot(model=model, spec=spec, actuators=cfgs, delays={}, pose=model.qpos0.copy(), has_imu=has_imu)
  addresses, _ = robot.addresses(robot.joints)
  robot.pose[addresses] = match_values_full(dict(pose or {}), robot.joints, what="joint", owner="pose", default=0.0)
  delays: dict[str, float] = {}
  for cfg in actuators:
    mean = 0.5 * (cfg.delay_min_lag + cfg.delay_max_lag) * model.opt.timestep
    matched: Any = cfg.match(robot.joints) if cfg.transmission_type == "joint" else ()
    delays |= dict.fromkeys(matched, mean)
  return dataclasses.replace(robot, delays=delays)


def _site_of_imu(spec: mujoco.MjSpec, name: str | None) -> str:
  if name is None:
    return next((sensor.objname for sensor in spec.sensors if sensor.type in IMU.values()), "")
  return check_name("site", name, [site.name for site in spec.sites], owner="imu")


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
  try:
    return spec.compile()
  except ValueError as error:
    raise MjlabError(f"the robot does not compile: {error}") from error
