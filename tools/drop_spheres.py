"""Drop spheres on every type of terrain and count those that end inside it: `uv run python tools/drop_spheres.py`.

Spheres fall with a random horizontal velocity and roll until they rest. The physics is MuJoCo C. A sphere is inside the
ground if its lowest point is more than 2 cm below the surface that a ray from above meets. Under a tread of open stairs
it may lie, no deeper than the rise, if it fits through the riser. The table is Markdown.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from mjlab_terrain import TerrainGridCfg, TileCfg, TiltedGridCfg, all_types

TOLERANCE = 0.02
"""Depth below the surface that counts as contact [m]."""


def variants() -> dict[str, TileCfg]:
  """Return every type with its shipped settings, and the steep or borderless ones where caves would open first."""
  types = all_types()
  out = dict(types)
  out["tilted_grid, tilt 40"] = TiltedGridCfg(tilt=(0.0, 40.0), height=(0.0, 0.3))
  out["open_stairs, down"] = dataclasses.replace(types["open_stairs"], inverted=True)
  out["stairs_up, holes"] = dataclasses.replace(types["stairs_up"], holes=True)
  out["stairs_down, holes"] = dataclasses.replace(types["stairs_down"], holes=True)
  out["random_grid, holes"] = dataclasses.replace(types["random_grid"], holes=True)
  for name in ("stepping_stones", "narrow_beams", "nested_rings"):
    out[f"{name}, no border"] = dataclasses.replace(types[name], border=0.0)
  return out


def drop(cfg: TileCfg, radius: float, count: int, *, difficulty: float = 1.0, seed: int = 0) -> np.ndarray:
  """Return how far the lowest point of each sphere ends above the surface, (count,) [m]; nan for those off the terrain.

  Tiles of the type lie beside level ones, so that spheres also cross the borders of tiles.
  """
  grid = TerrainGridCfg(
    types={"it": cfg, "flat": all_types()["flat"]},
    rows=2,
    columns=2,
    difficulty=(difficulty, difficulty),
    border_width=2.0,
    seed=seed,
  )
  spec = mujoco.MjSpec()
  terrain = grid.add_to(spec)
  spec.option.timestep = 0.004
  rng = np.random.default_rng(seed)
  # Most spheres start above the type, some above its level neighbours.
  reach = np.array(grid.tile_size) * (1.0, 0.6)
  start = rng.uniform(-1.0, 1.0, (count, 2)) * reach - (0.0, 0.5 * grid.tile_size[1] * 0.8)
  for x, y in start:
    body = spec.worldbody.add_body(pos=(x, y, terrain.height_range[1] + radius + 0.3))
    body.add_freejoint()
    body.add_geom(
      type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(radius, 0.0, 0.0), mass=1.0, group=3,
      contype=0, conaffinity=1, condim=6, friction=(0.6, 0.002, 0.002),
    )  # fmt: skip
  model = spec.compile()
  data = mujoco.MjData(model)
  data.qvel.reshape(-1, 6)[:, :2] = rng.uniform(-1.5, 1.5, (count, 2))
  mujoco.mj_step(model, data, nstep=1500)
  # Spheres that fall from an edge at this moment slow down, for a fast impact is deeper than the tolerance.
  data.qvel[:] = 0.0
  mujoco.mj_step(model, data, nstep=40)
  return np.array([p[2] - radius - _ground(model, data, p) for p in data.qpos.reshape(-1, 7)[:, :3]])


def _ground(model: mujoco.MjModel, data: mujoco.MjData, point: np.ndarray) -> float:
  """Return the height of the surface at a point [m]; nan where there is no ground."""
  above, down = np.array((*point[:2], 20.0)), np.array((0.0, 0.0, -1.0))
  only_ground = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
  distance = mujoco.mj_ray(model, data, above, down, only_ground, 1, -1, np.zeros(1, dtype=np.int32))
  return 20.0 - distance if distance >= 0.0 else np.nan


def main(argv: Sequence[str] | None = None) -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("names", nargs="*", help="rows of the table; default: all")
  parser.add_argument("--count", type=int, default=600, help="spheres of each radius")
  parser.add_argument("--radii", type=float, nargs="+", default=(0.04, 0.12), help="[m]")
  parser.add_argument("--difficulty", type=float, default=1.0)
  parser.add_argument("--seed", type=int, default=0)
  args = parser.parse_args(argv)
  rows = variants()
  print(f"| terrain at difficulty {args.difficulty:g} | " + " | ".join(f"{100 * r:g} cm" for r in args.radii) + " |")
  print("|---|" + "---|" * len(args.radii))
  for name in args.names or rows:
    cells = []
    for radius in args.radii:
      clearance = drop(rows[name], radius, args.count, difficulty=args.difficulty, seed=args.seed)
      inside = clearance < -TOLERANCE
      cells.append(f"{inside.sum()} of {np.isfinite(clearance).sum()} (lowest {100 * np.nanmin(clearance):.1f} cm)")
    print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
  main()
