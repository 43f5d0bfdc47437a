"""Observations that any task can use."""

from typing import TYPE_CHECKING, cast

import mujoco
import torch
from mjlab_managers import ManagerTermBase, ObservationTermCfg, SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_sensors import CameraSensor, RayCastSensor

  from mjlab_envs.env import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


def base_lin_vel(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Linear velocity of the root, in the root frame, (num_envs, 3) [m/s]."""
  return env.scene[asset.name].data.root_link_lin_vel_b


def base_ang_vel(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Angular velocity of the root, in the root frame, (num_envs, 3) [rad/s]."""
  return env.scene[asset.name].data.root_link_ang_vel_b


def projected_gravity(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Unit direction of gravity in the root frame, (num_envs, 3)."""
  return env.scene[asset.name].data.projected_gravity_b


def joint_pos_rel(env: "ManagerBasedRlEnv", *, biased: bool = False, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Joint positions relative to the default pose, with the encoders' bias if `biased`, (num_envs, joints) [rad, m]."""
  data = env.scene[asset.name].data
  position = data.joint_pos_biased if biased else data.joint_pos
  return position[:, asset.joint_ids] - data.default_joint_pos[:, asset.joint_ids]


def joint_vel_rel(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Joint velocities relative to the default ones, (num_envs, joints) [rad/s, m/s]."""
  data = env.scene[asset.name].data
  return data.joint_vel[:, asset.joint_ids] - data.default_joint_vel[:, asset.joint_ids]


def last_action(env: "ManagerBasedRlEnv", *, term: str | None = None) -> torch.Tensor:
  """Raw action of the last step, of all terms or of one, (num_envs, action dim)."""
  return env.action_manager.action if term is None else env.action_manager.get_term(term).raw_action


def generated_commands(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """A command, (num_envs, command dim)."""
  return env.command_manager.get_command(command)


def builtin_sensor(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Reading of a native MuJoCo sensor, (num_envs, sensor dim)."""
  return env.scene[sensor].data


def height_scan(
  env: "ManagerBasedRlEnv", *, sensor: str, offset: float = 0.0, miss_value: float | None = None
) -> torch.Tensor:
  """Height of its frame above what each ray of a ray-cast sensor hits, less `offset`, (num_envs, num_rays) [m].

  A ray that hits nothing reads `miss_value`, by default the sensor's `max_distance`. Rays are ordered frame by frame.
  """
  scan: RayCastSensor = env.scene[sensor]
  data = scan.data
  below = data.frame_pos_w[..., 2:] - data.hit_pos_w[..., 2].unflatten(1, (scan.num_frames, scan.rays_per_frame))
  miss = scan.cfg.max_distance if miss_value is None else miss_value
  return (below.flatten(1) - offset).masked_fill_(~data.valid, miss)


def camera_rgb(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Colours that a camera sensor sees, from 0 to 1, (num_envs, 3, height, width)."""
  return _drawn(env, sensor, "rgb") / 255.0


def camera_depth(
  env: "ManagerBasedRlEnv", *, sensor: str, max_depth: float, miss_value: float | None = None
) -> torch.Tensor:
  """Depth that a camera sensor sees, along its optical axis, (num_envs, 1, height, width) [m].

  What is farther than `max_depth` reads that; where nothing is seen it is `miss_value`, by default `max_depth` too.
  """
  depth = _drawn(env, sensor, "depth")
  return depth.clamp(max=max_depth).masked_fill_(depth < 0.0, max_depth if miss_value is None else miss_value)


class camera_mask(ManagerTermBase):
  """1 where a camera sensor sees a selected geom of the entity and 0 elsewhere, (num_envs, 1, height, width)."""

  _constants = frozenset({"_is_selected"})

  def __init__(self, cfg: ObservationTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    asset: SceneEntityCfg = cfg.params["asset"]
    model, prefix = env.sim.mj_model, env.scene[asset.name].prefix
    # A resolved selection holds the selected names.
    names = cast("tuple[str, ...]", asset.geom_names)
    # What is not seen is number -1: the last entry.
    self._is_selected = torch.zeros(model.ngeom + 1, device=env.device)
    self._is_selected[[model.geom(prefix + name).id for name in names]] = 1.0

  def __call__(self, env: "ManagerBasedRlEnv", *, sensor: str, asset: SceneEntityCfg) -> torch.Tensor:
    del asset  # Resolved at build.
    number, kind = _drawn(env, sensor, "segmentation").split(1, dim=1)
    number = number.masked_fill(kind != mujoco.mjtObj.mjOBJ_GEOM.value, -1)
    return self._is_selected[number.long()]


def _drawn(env: "ManagerBasedRlEnv", sensor: str, kind: str) -> torch.Tensor:
  camera: CameraSensor = env.scene[sensor]
  image = getattr(camera.data, kind)
  if image is None:
    raise ValueError(f"camera '{sensor}' draws {', '.join(camera.cfg.data_types)} only; add {kind!r} to its data_types")
  return image
