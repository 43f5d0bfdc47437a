"""Terms about the tiles of a terrain."""

from typing import TYPE_CHECKING

import torch
from mjlab_core import Range, check_name, require
from mjlab_managers import ManagerTermBase, SceneEntityCfg
from mjlab_scene import TerrainLevels

from mjlab_envs.mdp.events import reset_root_state_uniform

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


class reset_root_state_from_flat_patches(reset_root_state_uniform):
  """As `reset_root_state_uniform`, on one of the flat patches of the world's tile, drawn at random.

  `patches` is a name of `TerrainGridCfg.flat_patches`. On a plane, which has no tiles, the origin of the world takes
  their place.
  """

  def __init__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    patches: str,
    pose_range: dict[str, Range] | None = None,
    velocity_range: dict[str, Range] | None = None,
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    super().__init__(env, pose_range=pose_range or {}, velocity_range=velocity_range, asset=asset)
    self._patches: torch.Tensor | None = None
    terrain = env.scene.terrain
    if terrain is not None and env.scene.terrain_levels is not None:
      check_name("set of flat patches", patches, terrain.flat_patches, "terrain")
      points = torch.tensor(terrain.flat_patches[patches], device=env.device, dtype=env.sim.dtype)
      self._per_tile = points.shape[2]
      self._patches = points.flatten(0, 2)

  def origins(self) -> torch.Tensor:
    env, levels = self.env, self.env.scene.terrain_levels
    if self._patches is None or levels is None:
      return super().origins()
    nth = torch.randint(self._per_tile, (env.num_envs,), generator=env.rng, device=env.device)
    tile = levels.levels * levels.num_columns + levels.columns
    return self._patches.index_select(0, tile * self._per_tile + nth)


class terrain_edge_reached(ManagerTermBase):
  """Return True where the root is beyond a fraction of the way from its tile's centre to an edge, (num_envs,).

  The tile is the one on which the world began.

  Raises:
    MjlabError: the terrain has no tiles.
  """

  env: "ManagerBasedRlEnv"

  def __init__(
    self, env: "ManagerBasedRlEnv", *, threshold_fraction: float = 0.95, asset: SceneEntityCfg = _ROBOT
  ) -> None:
    super().__init__(env)
    missing = "the terrain has no tiles; give the scene a TerrainGridCfg"
    levels = require(env.scene.terrain_levels, TerrainLevels, missing)
    self._entity, self._fraction = env.scene[asset.name], threshold_fraction
    middle = (0.5 * (levels.num_rows - 1), 0.5 * (levels.num_columns - 1))
    self._size, self._middle = torch.tensor((levels.tile_size, middle), device=env.device, dtype=env.sim.dtype)

  def __call__(self) -> torch.Tensor:
    levels = self.env.scene.terrain_levels
    assert levels is not None
    place = torch.stack((levels.levels, levels.columns), -1).to(self._size.dtype)
    centre = (place - self._middle) * self._size
    away = (self._entity.data.root_link_pos_w[:, :2] - centre).abs()
    return (away > 0.5 * self._fraction * self._size).any(-1)
