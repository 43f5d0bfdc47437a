"""Terms of rough ground: levels, bounds, and the slope underfoot."""

from typing import TYPE_CHECKING

import torch
from mjlab_managers import CurriculumTermCfg, ManagerTermBase, RewardTermCfg, SceneEntityCfg, TerminationTermCfg
from mjlab_scene import TerrainLevels

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


class terrain_levels(ManagerTermBase):
  """At the end of an episode: one row up after walking half a tile, one down after less than half of what was asked.

  What was asked is the last command's horizontal speed over a full episode. A world above the hardest row draws any.
  Logs the mean and the highest level, and the mean of each type of ground.
  """

  _constants = frozenset({"_on_type"})

  def __init__(self, cfg: CurriculumTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    levels = _levels(env)
    self._types = tuple(dict.fromkeys(levels.column_types))
    on_type = [[float(column == kind) for column in levels.column_types] for kind in self._types]
    self._on_type = torch.tensor(on_type, device=env.device)
    self._far = 0.5 * levels.tile_size[0]

  def __call__(
    self, env: "ManagerBasedRlEnv", mask: torch.Tensor, *, command: str, asset: SceneEntityCfg = _ROBOT
  ) -> dict[str, torch.Tensor]:
    levels = _levels(env)
    walked = torch.linalg.vector_norm(
      env.scene[asset.name].data.root_link_pos_w[:, :2] - env.scene.env_origins[:, :2], dim=-1
    )
    speed = torch.linalg.vector_norm(env.command_manager.get_command(command)[:, :2], dim=-1)
    up = walked > self._far
    down = ~up & (walked < 0.5 * speed * env.max_episode_length_s)
    # An episode that has not begun proves nothing.
    levels.move(mask & (env.episode_length_buf > 0), up, down)
    now = levels.levels.float()
    # Worlds may have been put onto other columns, by an event or by a run that was resumed.
    members = self._on_type.index_select(1, levels.columns)
    by_type = (members * now).sum(1) / members.sum(1).clamp(min=1.0)
    return {"mean": now.mean(), "max": now.max()} | dict(zip(self._types, by_type.unbind(), strict=True))


def randomize_terrain(env: "ManagerBasedRlEnv", mask: torch.Tensor) -> None:
  """Put masked worlds onto any tile of the terrain, with what stands there; events behind this one place the rest."""
  _levels(env).randomize(mask)
  env.scene.place_fixed_bases(mask)


class out_of_terrain_bounds(ManagerTermBase):
  """Whether the root is beyond the terrain, its border included, less `margin` [m], (num_envs,)."""

  _constants = frozenset({"_bounds"})

  def __init__(self, cfg: TerminationTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    levels = _levels(env)
    border = getattr(env.scene.cfg.terrain, "border_width", 0.0)
    sides = (levels.num_rows * levels.tile_size[0], levels.num_columns * levels.tile_size[1])
    reach = [[0.5 * side + border - cfg.params["margin"] for side in sides]]
    self._bounds = torch.tensor(reach, device=env.device, dtype=env.sim.dtype)

  def __call__(self, env: "ManagerBasedRlEnv", *, margin: float = 0.3, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
    del margin  # Resolved at build.
    return (env.scene[asset.name].data.root_link_pos_w[:, :2].abs() > self._bounds).any(-1)


class upright_on_terrain(ManagerTermBase):
  """exp(-|t_xy|^2 / std^2), t the ground's normal in the root frame, (num_envs,).

  The normal is that of the plane z = a x + b y + c that fits every sixth hit of a height scan best; it is vertical
  where fewer than three rays hit, or all hits lie on a line.
  """

  def __init__(self, cfg: RewardTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._sensor = env.scene[cfg.params["sensor"]]

  def __call__(
    self, env: "ManagerBasedRlEnv", *, std: float, sensor: str, asset: SceneEntityCfg = _ROBOT
  ) -> torch.Tensor:
    del sensor  # Resolved at build.
    scan = self._sensor.data
    normal = plane_normal(scan.hit_pos_w[:, ::6], scan.valid[:, ::6])
    root = env.scene[asset.name]
    matrix = env.sim.data.xmat[:, root.indexing.root_body]
    tilt = (matrix[:, :, :2] * normal[:, :, None]).sum(1)
    return torch.exp(tilt.square().sum(-1) / -(std**2))


def plane_normal(points: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
  """Upward unit normal of the least-squares plane z = a x + b y + c through valid points (N, P, 3), (N, 3)."""
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
  levels = env.scene.terrain_levels
  if levels is None:
    raise ValueError("the terrain has no tiles; give the scene a TerrainGridCfg")
  return levels
