"""Steps on rough ground with each search for pairs of geoms, in turn, and whether all find the same (GPU).

  python tools/benchmark_broadphase.py --output docs/benchmarks/broadphase.md

One environment per task, without curricula, takes random actions; its search is exchanged between blocks of steps.
"""

import argparse
import statistics
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from benchmark_step import heading, make, synchronize, timed
from mjlab_sim.warp import internals
from mjlab_sim.warp.collision.grouped_broadphase import GroupedBroadphase

TASKS = ("Mjlab-Velocity-Rough-Unitree-G1", "Mjlab-Velocity-Rough-Unitree-Go1")
LAUNCHES = 20


def contacts(engine: Any, search: Any) -> tuple[np.ndarray, np.ndarray]:
  """Return the pairs that a search finds, and the contacts that follow, both ordered."""
  m, d = engine._m, engine._d
  engine._broadphase = search
  pairs = pair_lists(d)
  d.ncollision.zero_()
  find_pairs(search)(m, d, pairs)
  pairs_found = ordered(vars(pairs).values(), int(d.ncollision.numpy()[0]))
  with engine._ours():
    mjw.collision(m, d)
  names = ("worldid", "geom", "geomcollisionid", "dist", "pos", "frame", "includemargin")
  return pairs_found, ordered([getattr(d.contact, name) for name in names], int(d.nacon.numpy()[0]))


def pair_lists(d: Any) -> Any:
  """Return memory for pairs."""
  kinds = {"collision_pair": wp.vec2i, "collision_pairid": wp.vec2i, "collision_worldid": int}
  return SimpleNamespace(**{name: wp.zeros(d.naconmax, dtype=kind) for name, kind in kinds.items()})


def find_pairs(search: Any) -> Any:
  """Return the function of a search; None stands for MuJoCo Warp's."""
  return internals.nxn_broadphase if search is None else search.find_pairs


def ordered(arrays: Any, count: int) -> np.ndarray:
  """Return the first rows of some arrays side by side, in an order of their own."""
  rows = np.concatenate([array.numpy()[:count].reshape(count, -1).astype(np.float64) for array in arrays], 1)
  return rows[np.lexsort(rows.T[::-1])]


def alone(engine: Any, search: Any) -> float:
  """Return the milliseconds of one search, of twenty in a graph."""
  m, d = engine._m, engine._d
  pairs = pair_lists(d)

  def launch() -> None:
    for _ in range(LAUNCHES):
      d.ncollision.zero_()
      find_pairs(search)(m, d, pairs)

  launch()
  device = engine._wp_device
  if not device.is_cuda:
    begin = time.perf_counter()
    launch()
    return 1e3 * (time.perf_counter() - begin) / LAUNCHES
  with wp.ScopedCapture(device) as capture:
    launch()
  graph: Any = capture.graph
  samples = []
  for _ in range(5):
    wp.synchronize_device(device)
    begin = time.perf_counter()
    wp.capture_launch(graph)
    wp.synchronize_device(device)
    samples.append((time.perf_counter() - begin) / LAUNCHES)
  return 1e3 * statistics.median(samples)


def measure(task: str, args: argparse.Namespace) -> list[str]:
  """Return the rows of one task."""
  env = make(task, args.num_envs, args.device, "warp", capture=True)
  env.reset()
  engine: Any = env.sim._engine
  model, m, d = env.sim.mj_model, engine._m, engine._d
  action = torch.zeros(env.num_envs, env.action_manager.total_action_dim, device=env.device)

  def step() -> None:
    env.step(action.normal_())

  for _ in range(20):
    step()
  with wp.ScopedDevice(engine._wp_device):
    searches = {"every pair (MuJoCo Warp)": None} | {
      f"groups of {size}": GroupedBroadphase(model, m, d, members=size) for size in args.members
    }
  seconds: dict[str, list[float]] = {name: [] for name in searches}
  for _ in range(args.rounds):
    for name, search in searches.items():
      engine._broadphase = search
      engine._launcher.clear()
      env.sim._recordings.invalidate()
      for _ in range(4):
        step()
      seconds[name].append(timed(step, args.steps, 1, env.device))
  env.sim.forward()
  synchronize(env.device)
  rows = []
  with wp.ScopedDevice(engine._wp_device):
    expected = contacts(engine, None)
    for name, search in searches.items():
      found = contacts(engine, search)
      same = all(np.array_equal(*both) for both in zip(found, expected, strict=True))
      numbers = " ".join(f"{1e3 * value:.2f}" for value in seconds[name])
      threads = m.nxn_geom_pair_filtered.shape[0] - (0 if search is None else search.saved)
      median = 1e3 * statistics.median(seconds[name])
      counts = f"{len(found[0])} | {len(found[1])} | {'yes' if same else 'NO'}"
      rows.append(
        f"| {task} | {name} | {threads} | {alone(engine, search):.3f} | {median:.2f} | {numbers} | {counts} |"
      )
      print(rows[-1], flush=True)
  print(env.sim.overflow_report(), flush=True)
  env.close()
  return rows


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--steps", type=int, default=40)
  parser.add_argument("--rounds", type=int, default=3)
  parser.add_argument("--members", type=int, nargs="+", default=[8, 16, 64], help="geoms of a group")
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--tasks", nargs="+", default=TASKS)
  parser.add_argument("--output", type=Path)
  args = parser.parse_args()
  rows = [
    "| task | search | threads of a world | one search [ms] | step [ms] | rounds [ms] | pairs | contacts | the same |",
    "| --- | --- | ---: | ---: | ---: | --- | ---: | ---: | --- |",
  ]
  for task in args.tasks:
    rows += measure(task, args)
    if args.output:
      args.output.parent.mkdir(parents=True, exist_ok=True)
      text = heading("Search for pairs of geoms", args.device)
      args.output.write_text(
        f"{text} {args.num_envs} worlds. By `tools/benchmark_broadphase.py`.\n\n" + "\n".join(rows) + "\n"
      )


if __name__ == "__main__":
  main()
