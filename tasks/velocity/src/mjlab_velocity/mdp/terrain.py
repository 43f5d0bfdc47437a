"""Terms of rough ground: levels, bounds, and slope of the ground."""

from typing import TYPE_CHECKING

import torch
from mjlab_core import require
from mjlab_managers import ManagerTermBase, SceneEntityCfg
from mjlab_scene import TerrainLevels

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


class terrain_levels(ManagerTermBase):
  """Level of each world: one row up after half a tile in an episode, one down after less than half the commanded way.

  The commanded way is the last command's horizontal speed over a full episode. Above the hardest row, the row is
  random. Logs the mean and the highest level, and the mean of each type of ground.
  """

  env: "ManagerBasedRlEnv"

  def __init__(self, env: "ManagerBasedRlEnv", *, command: str, asset: SceneEntityCfg = _ROBOT) -> None:
    super().__init__(env)
    self._command, self._entity = command, env.scene[asset.name]
    levels = _levels(env)
    self._types = tuple(dict.fromkeys(levels.column_types))
    on_type = [[float(column == kind) for column in levels.column_types] for kind in self._types]
    self._on_type = torch.tensor(on_type, device=env.device)
    self._far = 0.5 * levels.tile_size[0]

  def __call__(self, mask: torch.Tensor) -> dict[str, torch.Tensor]:
    env, levels = self.env, _levels(self.env)
    walked = torch.linalg.vector_norm(self._entity.data.root_link_pos_w[:, :2] - env.scene.env_origins[:, :2], dim=-1)
    speed = torch.linalg.vector_norm(env.command_manager.get_command(self._command)[:, :2], dim=-1)
    up = walked > self._far
    down = ~up & (walked < 0.5 * speed * env.max_episode_length_s)
    # Episodes that have not begun do not count.
    levels.move(mask & (env.episode_length_buf > 0), up, down)
    now = levels.levels.float()
    # Events and resumed runs may have changed the columns of worlds.
    members = self._on_type.index_select(1, levels.columns)
    by_type = (members * now).sum(1) / members.sum(1).clamp(min=1.0)
    return {"mean": now.mean(), "max": now.max()} | dict(zip(self._types, by_type.unbind(), strict=True))


def randomize_terrain(env: "ManagerBasedRlEnv", mask: torch.Tensor) -> None:
  """Move masked worlds to random tiles, with their fixed entities; later events place the others."""
  _levels(env).randomize(mask)
  env.scene.place_fixed_bases(mask)


class out_of_terrain_bounds(ManagerTermBase):
  """True where the root is less than `margin` [m] inside the outer edge of the terrain, or beyond, (num_envs,)."""

  def __init__(self, env: "ManagerBasedRlEnv", *, margin: float = 0.3, asset: SceneEntityCfg = _ROBOT) -> None:
    super().__init__(env)
    self._entity = env.scene[asset.name]
    levels = _levels(env)
    border = getattr(env.scene.cfg.terrain, "border_width", 0.0)
    sides = (levels.num_rows * levels.tile_size[0], levels.num_columns * levels.tile_size[1])
    reach = torch.tensor([[0.5 * side + border for side in sides]], device=env.device, dtype=env.sim.dtype)
    self._reach, self._margin = reach, margin

  def __call__(self) -> torch.Tensor:
    return (self._entity.data.root_link_pos_w[:, :2].abs() > self._reach - self._margin).any(-1)


class upright_on_terrain(ManagerTermBase):
  """exp(-|t_xy|^2 / std^2), t the ground's normal in the root frame, (num_envs,).

  The normal belongs to the least-squares plane through every sixth hit of a height scan. It is vertical if fewer than
  three rays hit, or if all hits lie on a line.
  """

  env: "ManagerBasedRlEnv"

  def __init__(self, env: "ManagerBasedRlEnv", *, std: float, sensor: str, asset: SceneEntityCfg = _ROBOT) -> None:
    super().__init__(env)
    self._sensor, self._entity, self._std = env.scene[sensor], env.scene[asset.name], std

  def __call__(self) -> torch.Tensor:
    scan = self._sensor.data
    normal = plane_normal(scan.hit_pos_w[:, ::6], scan.valid[:, ::6])
    matrix = self.env.sim.data.xmat[:, self._entity.indexing.root_body]
    tilt = (matrix[:, :, :2] * normal[:, :, None]).sum(1)
    return torch.exp(tilt.square().sum(-1) / -(self._std**2))


def plane_normal(points: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
  """Return the upward unit normal of the least-squares plane through valid points, (N, P, 3) to (N, 3)."""
  weight = valid.to(points.dtype)[..., None]
  count = weight.sum(1).clamp(min=1.0)
  centred = (points - ((points * weight).sum(1) / count)[:, None]) * weight
  x, y, z = centred.unbind(-1)
  xx, xy, yy, xz, yz = (p.sum(-1) for p in (x * x, x * y, y * y, x * z, y * z))
  determinant = xx * yy - xy * xy
  # Relative, so that it does not depend on the size of the scan: 0 on a line, 1 on a square.
  is_plane = determinant > 1e-4 * (xx + yy).square().clamp(min=1e-12)
  safe = torch.where(is_plane, determinant, torch.ones_like(determinant))
  a = torch.where(is_plane, (yy * xz - xy * yz) / safe, torch.zeros_like(safe))
  b = torch.where(is_plane, (xx * yz - xy * xz) / safe, torch.zeros_like(safe))
  normal = torch.stack([-a, -b, torch.ones_like(a)], -1)
  return normal / torch.linalg.vector_norm(normal, dim=-1, keepdim=True)


def _levels(env: "ManagerBasedRlEnv") -> TerrainLevels:
  return require(env.scene.terrain_levels, TerrainLevels, "the terrain has no tiles; give the scene a TerrainGridCfg")
