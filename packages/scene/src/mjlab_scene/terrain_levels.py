"""Tile of a terrain that each world stands on."""

from __future__ import annotations

from typing import Annotated

import torch
from mjlab_core import Limits, Stateful, check_value, where_
from mjlab_terrain import Terrain


class TerrainLevels(Stateful):
  """Tile of each world: a fixed column, and a row that moves with success.

  Args:
    terrain: The terrain that was added to the model.
    env_origins: Origins of the worlds, (num_envs, 3) [m]; updated in place.
    max_init_level: Hardest row that worlds begin on; None for all rows.
    rng: Source of randomness on the device of `env_origins`.

  Raises:
    MjlabError: `max_init_level` is not a row of the terrain.
  """

  def __init__(
    self, terrain: Terrain, env_origins: torch.Tensor, max_init_level: int | None, rng: torch.Generator
  ) -> None:
    self.num_envs = len(env_origins)
    self.num_rows, self.num_columns = terrain.origins.shape[:2]
    highest = self.num_rows - 1 if max_init_level is None else max_init_level
    check_value("scene: max_init_terrain_level", highest, Annotated[int, Limits(ge=0, le=self.num_rows - 1)])
    device = env_origins.device
    self.column_types = tuple(terrain.type_names[kind] for kind in terrain.tile_types[0])
    """Type of the first tile of each column; in a curriculum, all tiles of a column have it."""
    self.tile_size = terrain.tile_size
    """Extent of a tile along x and y [m]."""
    self._rng = rng
    self.env_origins = env_origins
    self._origins = torch.tensor(terrain.origins, dtype=env_origins.dtype, device=device).flatten(0, 1)
    self.levels = self.state_of(torch.randint(highest + 1, (self.num_envs,), generator=rng, device=device))
    """Row of each world, 0 the easiest of a curriculum, (num_envs,)."""
    self.columns = self.state_of(torch.tensor(terrain.columns_of(self.num_envs), device=device))
    """Column of each world, (num_envs,)."""
    self._place(torch.ones(self.num_envs, dtype=torch.bool, device=device))

  def move(self, mask: torch.Tensor, up: torch.Tensor, down: torch.Tensor) -> None:
    """Move masked worlds one row up or down, bool (num_envs,) each; above the hardest row they draw any row."""
    moved = self.levels + up.long() - down.long()
    anywhere = self._draw(self.num_rows)
    moved = torch.where(moved >= self.num_rows, anywhere, moved.clamp(min=0))
    where_(self.levels, mask, moved)
    self._place(mask)

  def randomize(self, mask: torch.Tensor) -> None:
    """Put masked worlds, bool (num_envs,), onto any tile."""
    where_(self.levels, mask, self._draw(self.num_rows))
    where_(self.columns, mask, self._draw(self.num_columns))
    self._place(mask)

  def _draw(self, stop: int) -> torch.Tensor:
    return torch.randint(stop, (self.num_envs,), generator=self._rng, device=self.levels.device)

  def _place(self, mask: torch.Tensor) -> None:
    where_(self.env_origins, mask, self._origins.index_select(0, self.levels * self.num_columns + self.columns))
