"""Public ways of MuJoCo Warp beside those that mjlab takes: results and times.

  python tools/compare_warp_paths.py --num-envs 512 4096 --device cuda:0

Two comparisons on a Go1 among blocks:

- rays: the caster of `Simulation.make_ray_caster`, and `mjw.rays(rc=...)` over the render context's tree, which is
  refitted before each cast. The height scan has 187 rays that see the terrain only.
- step: `opt.run_qacc_smooth` on, as mjlab leaves it, and off, which skips a factorisation and leaves `qacc_smooth`
  stale.

A public way is worth taking if its results agree and its time is not longer. On a CPU times say little: MuJoCo Warp is
made for a GPU.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from mjlab_robots import go1
from mjlab_scene import Scene, SceneCfg
from mjlab_sensors import GridPatternCfg
from mjlab_sim import Simulation, SimulationCfg
from mjlab_terrain import RandomGridCfg, TerrainGridCfg

GROUND = TerrainGridCfg(types={"blocks": RandomGridCfg()}, rows=4, columns=4, border_width=2.0)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--num-envs", type=int, nargs="+", default=[16])
  parser.add_argument("--device", default="cuda:0" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--steps", type=int, default=50)
  args = parser.parse_args()
  print("| worlds | what | mjlab [ms] | public [ms] | largest difference |")
  print("|---:|---|---:|---:|---|")
  for num_envs in args.num_envs:
    for name, compare in (("rays", compare_rays), ("step", compare_step)):
      ours, public, difference = compare(num_envs, args.device, args.steps)
      print(f"| {num_envs} | {name} | {ours:.3f} | {public:.3f} | {difference} |")


def timed(call: Callable[[], object], device: str, steps: int) -> float:
  """Return the time of a call [ms]; on a GPU it is recorded once and replayed."""
  for _ in range(3):
    call()
  with wp.ScopedDevice(device):
    if wp.get_device(device).is_cuda:
      with wp.ScopedCapture() as capture:
        call()
      graph: Any = capture.graph
      call = lambda: wp.capture_launch(graph)  # noqa: E731 - replay in place of the call
    wp.synchronize()
    start = time.perf_counter()
    for _ in range(steps):
      call()
    wp.synchronize()
  return 1e3 * (time.perf_counter() - start) / steps


def scene(num_envs: int) -> Scene:
  """Return Go1s among blocks."""
  return Scene(SceneCfg(num_envs=num_envs, terrain=GROUND, entities={"robot": go1()}))


def compare_rays(num_envs: int, device: str, steps: int) -> tuple[float, float, str]:
  """Return both times of a height scan [ms], and the largest difference of the distances [m]."""
  world = scene(num_envs)
  sim = Simulation(num_envs, world.spec, SimulationCfg(engine="warp"), device)
  world.initialize(sim)
  offsets, down = GridPatternCfg(size=(1.6, 1.0), resolution=0.1).rays()
  offsets[:, 2] += 1.0
  base = world["robot"].data.root_link_pos_w[:, None]
  origins = (base + torch.tensor(offsets, dtype=base.dtype, device=base.device)).contiguous()
  directions = torch.tensor(down, dtype=base.dtype, device=base.device).expand_as(origins).contiguous()
  terrain_only = (True, False, False, False, False, False)
  caster = sim.make_ray_caster(len(offsets), geomgroup=terrain_only)
  hits = caster.cast(origins, directions)
  # The simulation records its launches itself.
  start_of_ours = time.perf_counter()
  for _ in range(steps):
    caster.cast()
  wp.synchronize()
  ours = 1e3 * (time.perf_counter() - start_of_ours) / steps

  model = sim.mj_model
  host = mujoco.MjData(model)
  with wp.ScopedDevice(device):
    m, d = mjw.put_model(model), mjw.put_data(model, host, nworld=num_envs)
    wp.copy(d.qpos, wp.from_torch(sim.data.qpos.contiguous()))
    mjw.kinematics(m, d)
    context = mjw.create_render_context(model, nworld=num_envs, cam_res=(1, 1), enabled_geom_groups=[0])
    shape = (num_envs, len(offsets))
    distance: Any = wp.zeros(shape, dtype=float)
    geomid: Any = wp.zeros(shape, dtype=int)
    normal: Any = wp.zeros(shape, dtype=wp.vec3)
    exclude: Any = wp.full(len(offsets), -1, dtype=int)
    starts: Any = wp.from_torch(origins, dtype=wp.vec3)
    rays: Any = wp.from_torch(directions, dtype=wp.vec3)
    groups: Any = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]

    def cast() -> None:
      mjw.refit_bvh(m, d, context)
      mjw.rays(m, d, starts, rays, groups, True, exclude, distance, geomid, normal, rc=context)

    public = timed(cast, device, steps)
  difference = np.abs(distance.numpy() - hits.distance.cpu().numpy())
  return ours, public, f"{difference.max():.2g} m, {int((difference > 1e-3).sum())} rays differ"


def compare_step(num_envs: int, device: str, steps: int) -> tuple[float, float, str]:
  """Return the times of a step with and without `run_qacc_smooth` [ms], and the largest difference of qpos."""
  spec = scene(num_envs).spec
  SimulationCfg().apply(spec)
  model = spec.compile()
  host = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, host, 0)
  times, ends = [], []
  with wp.ScopedDevice(device):
    for run_qacc_smooth in (True, False):
      m, d = mjw.put_model(model), mjw.put_data(model, host, nworld=num_envs, nconmax=64, njmax=256)
      m.opt.run_qacc_smooth = run_qacc_smooth
      times.append(timed(lambda m=m, d=d: mjw.step(m, d), device, steps))
      ends.append(d.qpos.numpy())
  return times[0], times[1], f"{np.abs(ends[0] - ends[1]).max():.2g} after {steps + 3} steps"


if __name__ == "__main__":
  main()
