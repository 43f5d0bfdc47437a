"""Observations that any task can use."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar, cast

import mujoco
import torch
from mjlab_core import MjlabError, quat_conjugate, quat_mul, require, rotvec_from_quat
from mjlab_managers import ManagerTermBase, Reading, SceneEntityCfg, TermSource, sourced
from mjlab_sensors import BuiltinSensor, ImuSensor

from mjlab_envs.mdp.readings import image_of, joints, of_root, selected, sensor_reading

if TYPE_CHECKING:
  from mjlab_sensors import CameraSensor, RayCastSensor

  from mjlab_envs.env import ManagerBasedRlEnv

T = TypeVar("T", bound=Callable[..., Any])

_ROBOT = SceneEntityCfg("robot")

# Sources, for the export of policies


def _is(reading: Callable[..., Reading]) -> Callable[[T], T]:
  """Declare that a term is one reading, which a function of the environment and the parameters returns."""
  return sourced(lambda env, **params: TermSource(readings=(reading(env, **params),)))


def _joint_pos_rel(env: "ManagerBasedRlEnv", *, biased: bool, asset: SceneEntityCfg) -> TermSource:
  del biased  # Encoders of a robot have their own bias.
  if ball := [name for name in env.scene[asset.name].wide_joints if name in cast("tuple[str, ...]", asset.joint_names)]:
    raise MjlabError(f"joint_pos_rel of ball joint '{ball[0]}' has no reading of an encoder, so it cannot be exported")
  default = env.scene[asset.name].data.default_joint_pos[:1]
  return TermSource(readings=(joints(env, asset.name, "position"),), compute=selected(asset.joint_pos_ids, default))


def _joint_vel_rel(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg) -> TermSource:
  default = env.scene[asset.name].data.default_joint_vel[:1]
  return TermSource(readings=(joints(env, asset.name, "velocity"),), compute=selected(asset.joint_vel_ids, default))


def _last_action(env: "ManagerBasedRlEnv", *, term: str | None) -> TermSource:
  manager = env.action_manager
  columns = slice(None) if term is None else manager.term_slices()[term]
  return TermSource(
    readings=(Reading(name="last_action", read=lambda: manager.action),), compute=lambda action: action[:, columns]
  )


def _generated_commands(env: "ManagerBasedRlEnv", *, command: str) -> TermSource:
  return env.command_manager.get_term(command).source()


def _height_scan(env: "ManagerBasedRlEnv", **params: Any) -> Reading:
  return Reading(name=f"terrain/{params['sensor']}", read=lambda: height_scan(env, **params), unit="m")


def _camera_rgb(env: "ManagerBasedRlEnv", *, sensor: str) -> Reading:
  return image_of(env.scene[sensor], "rgb", lambda: camera_rgb(env, sensor=sensor))


def _camera_depth(env: "ManagerBasedRlEnv", *, sensor: str, max_depth: float, miss_value: float | None) -> TermSource:
  def compute(depth: torch.Tensor) -> torch.Tensor:
    return _without_misses(depth, max_depth, miss_value)

  reading = image_of(env.scene[sensor], "depth", lambda: _drawn(env, sensor, "depth"))
  return TermSource(readings=(reading,), compute=compute)


@_is(of_root("estimate/linear_velocity", "m/s", "root_link_lin_vel_b", "linear_velocity"))
def base_lin_vel(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return the linear velocity of the root, in the root frame, (num_envs, 3) [m/s]."""
  return env.scene[asset.name].data.root_link_lin_vel_b


@_is(of_root("imu/gyro", "rad/s", "root_link_ang_vel_b", "angular_velocity"))
def base_ang_vel(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return the angular velocity of the root, in the root frame, (num_envs, 3) [rad/s]."""
  return env.scene[asset.name].data.root_link_ang_vel_b


@_is(of_root("imu/projected_gravity", "", "projected_gravity_b", "projected_gravity"))
def projected_gravity(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return the unit direction of gravity in the root frame, (num_envs, 3)."""
  return env.scene[asset.name].data.projected_gravity_b


class projected_gravity_from_sensor(ManagerTermBase):
  """Return the unit direction of gravity in the axes of a sensor's site, (num_envs, 3).

  The sensor is an IMU, or a native "framezaxis" sensor of the world in the frame of the site.

  Raises:
    MjlabError: the sensor is of another kind.
  """

  env: "ManagerBasedRlEnv"

  def __init__(self, env: "ManagerBasedRlEnv", *, sensor: str) -> None:
    super().__init__(env)
    self._sensor, found = sensor, env.scene[sensor]
    self._is_imu = isinstance(found, ImuSensor)
    is_vertical = False
    if isinstance(found, BuiltinSensor):
      native = env.sim.mj_model.sensor(found.cfg.element or sensor)
      is_axis = native.type[0] == mujoco.mjtSensor.mjSENS_FRAMEZAXIS
      is_vertical = is_axis and native.objid[0] == 0 and native.refid[0] >= 0
    if not (self._is_imu or is_vertical):
      raise MjlabError(
        f"sensor '{sensor}' does not measure the vertical; give an ImuSensorCfg, or BuiltinSensorCfg(sensor_type="
        "'framezaxis', obj=ObjRef(type='xbody', name='world'), ref=ObjRef(type='site', ...))"
      )

  def __call__(self) -> torch.Tensor:
    data = self.env.scene[self._sensor].data
    return data.projected_gravity if self._is_imu else -data


@sourced(_joint_pos_rel)
def joint_pos_rel(env: "ManagerBasedRlEnv", *, biased: bool = False, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return joint positions relative to the default pose, with the encoders' bias if `biased`.

  Shape (num_envs, joints) [rad, m]. A ball joint has three columns, the rotation vector from its default orientation in
  the frame of its child body, as its velocity is.
  """
  entity = env.scene[asset.name]
  data = entity.data
  position = data.joint_pos_biased if biased else data.joint_pos
  if entity.wide_joints:
    names = cast("tuple[str, ...]", asset.joint_names)
    chosen = [entity.indexing.q_of_joint[entity.joint_names.index(name)] for name in names]
    return _with_rotations(position, data.default_joint_pos, chosen)
  return position[:, asset.joint_pos_ids] - data.default_joint_pos[:, asset.joint_pos_ids]


def _with_rotations(position: torch.Tensor, default: torch.Tensor, joints: Sequence[range]) -> torch.Tensor:
  """Return differences of joint positions: of a quaternion, of four columns, the rotation vector."""
  parts = []
  for columns in joints:
    now, before = position[:, columns.start : columns.stop], default[:, columns.start : columns.stop]
    is_ball = len(columns) == 4
    parts.append(rotvec_from_quat(quat_mul(quat_conjugate(before), now)) if is_ball else now - before)
  return torch.cat(parts, -1)


@sourced(_joint_vel_rel)
def joint_vel_rel(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return joint velocities relative to the default ones, (num_envs, joints) [rad/s, m/s]."""
  data = env.scene[asset.name].data
  return data.joint_vel[:, asset.joint_vel_ids] - data.default_joint_vel[:, asset.joint_vel_ids]


@sourced(_last_action)
def last_action(env: "ManagerBasedRlEnv", *, term: str | None = None) -> torch.Tensor:
  """Return the raw action of the last step, of all terms or of one, (num_envs, action dim)."""
  return env.action_manager.action if term is None else env.action_manager.get_term(term).raw_action


@sourced(_generated_commands)
def generated_commands(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return a command, (num_envs, command dim)."""
  return env.command_manager.get_command(command)


@_is(sensor_reading)
def builtin_sensor(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the reading of a native MuJoCo sensor, (num_envs, sensor dim)."""
  return env.scene[sensor].data


@_is(_height_scan)
def height_scan(
  env: "ManagerBasedRlEnv", *, sensor: str, offset: float = 0.0, miss_value: float | None = None
) -> torch.Tensor:
  """Return the height of the frame above the hit point of each ray, less `offset`, (num_envs, num_rays) [m].

  A ray that hits nothing reads `miss_value`, by default the sensor's `max_distance`. Rays are ordered frame by frame.
  """
  scan: RayCastSensor = env.scene[sensor]
  data = scan.data
  below = data.frame_pos_w[..., 2:] - data.hit_pos_w[..., 2].unflatten(1, (scan.num_frames, scan.rays_per_frame))
  miss = scan.cfg.max_distance if miss_value is None else miss_value
  return (below.flatten(1) - offset).masked_fill_(~data.valid, miss)


@_is(_camera_rgb)
def camera_rgb(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the colours of a camera image, from 0 to 1, (num_envs, 3, height, width)."""
  return _drawn(env, sensor, "rgb") / 255.0


@sourced(_camera_depth)
def camera_depth(
  env: "ManagerBasedRlEnv", *, sensor: str, max_depth: float, miss_value: float | None = None
) -> torch.Tensor:
  """Return the depth of a camera image along the optical axis, (num_envs, 1, height, width) [m].

  Depths above `max_depth` read `max_depth`. Pixels that see nothing read `miss_value`, by default `max_depth`.
  """
  return _without_misses(_drawn(env, sensor, "depth"), max_depth, miss_value)


def _without_misses(depth: torch.Tensor, max_depth: float, miss_value: float | None) -> torch.Tensor:
  return torch.where(depth < 0.0, max_depth if miss_value is None else miss_value, depth.clamp(max=max_depth))


def _drawn(env: "ManagerBasedRlEnv", sensor: str, kind: str) -> torch.Tensor:
  camera: CameraSensor = env.scene[sensor]
  others = f"camera '{sensor}' draws {', '.join(camera.cfg.data_types)} only; add {kind!r} to its data_types"
  return require(getattr(camera.data, kind), torch.Tensor, others)
