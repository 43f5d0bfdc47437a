"""Curriculum of terrain in a separate model, and 200 spheres that fall on it, in plain MuJoCo.

It needs nothing but this package:
`uv run --no-project --with ./packages/terrain python packages/terrain/examples/drop_spheres.py`.
"""

import mujoco
import numpy as np
from mjlab_terrain import PyramidStairsCfg, SteppingStonesCfg, TerrainGridCfg, WavesCfg

NUM_SPHERES, RADIUS = 200, 0.1


def main() -> None:
  spec = mujoco.MjSpec.from_string('<mujoco model="mine"><option timestep="0.005"/></mujoco>')
  terrain = TerrainGridCfg(
    tile_size=(8.0, 8.0),
    rows=10,
    layout="curriculum",
    seed=0,
    types={
      "stairs": PyramidStairsCfg(step_height=(0.02, 0.2), share=0.5),
      "waves": WavesCfg(share=0.3),
      "stones": SteppingStonesCfg(share=0.2),
    },
  ).add_to(spec)

  rng = np.random.default_rng(0)
  for k, origin in enumerate(terrain.env_origins(NUM_SPHERES, spacing=0.0)):
    place = origin + np.array((*rng.uniform(-3.0, 3.0, 2), 1.5))
    body = spec.worldbody.add_body(name=f"sphere_{k}", pos=place)
    body.add_freejoint()
    # Rolling friction, so that they come to rest.
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0], mass=1.0, condim=6, friction=[1, 0.01, 0.01])
  model = spec.compile()
  data = mujoco.MjData(model)
  mujoco.mj_step(model, data, nstep=600)

  height = data.qpos.reshape(-1, 7)[:, 2] - RADIUS
  lowest, highest = terrain.height_range
  on_ground = (height > lowest - 0.01) & (height < highest + 0.01)
  print(f"{terrain.origins.shape[:2]} tiles of {', '.join(terrain.type_names)} in {len(terrain.geom_names)} geoms")
  print(
    f"{on_ground.sum()} of {NUM_SPHERES} spheres on the ground, between {height.min():.2f} and {height.max():.2f} m"
  )
  if not on_ground.all():
    raise SystemExit("Some spheres fell through.")


if __name__ == "__main__":
  main()
