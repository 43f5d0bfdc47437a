"""Steps on rough ground, block by block, with what collides in them: where a scatter between runs comes from.

  python tools/benchmark_rough.py --num-envs 4096 --output docs/benchmarks/rough_cuda.md

For each robot and each way to build the trees that height rays search, worlds start on all rows of the terrain with
several seeds, and take random actions. Every block of steps has its own row: time, contacts, candidate pairs and rows
of constraints, the share of contacts with height fields, and the clock of the GPU.
"""

import argparse
import json
import statistics
import subprocess
import sys
from datetime import date
from pathlib import Path
from typing import Any

import torch
import warp as wp
from benchmark_step import synchronize, timed
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl.runs.manifest import package_versions
from mjlab_sim.warp import rays
from stage_timing import ENGINE_CALLS, time_methods

TASKS = {"Go1": "Mjlab-Velocity-Rough-Unitree-Go1", "G1": "Mjlab-Velocity-Rough-Unitree-G1"}
HFIELD = 1
COLUMNS = ("step_ms", "contacts", "most_contacts", "pairs", "rows", "most_rows", "on_hfield", "mhz")


def build(task: str, num_envs: int, device: str, tree: str) -> ManagerBasedRlEnv:
  """Build the training environment, with trees of this kind and worlds on all rows of the terrain."""

  def build_tree(vertices: Any, triangles: Any) -> wp.Mesh:
    points, indices = wp.array(vertices, dtype=wp.vec3), wp.array(triangles.ravel(), dtype=wp.int32)
    constructor, _, leaf_size = tree.partition(":")
    return wp.Mesh(points, indices, bvh_constructor=constructor, bvh_leaf_size=int(leaf_size) if leaf_size else None)

  module: Any = rays
  module._tree = build_tree
  cfg = load_task(task).env
  cfg.scene.num_envs, cfg.scene.max_init_terrain_level = num_envs, None
  cfg.sim.engine, cfg.seed = "warp", 1
  return ManagerBasedRlEnv(cfg, device)


def counts(env: ManagerBasedRlEnv) -> dict[str, float]:
  """Return what collides at this moment."""
  engine: Any = env.sim._engine
  d = engine._d
  found = min(int(d.nacon.numpy()[0]), d.naconmax)
  worlds = wp.to_torch(d.contact.worldid)[:found].long()
  geoms = wp.to_torch(d.contact.geom)[:found].long()
  kinds = torch.as_tensor(env.sim.mj_model.geom_type, device=env.device)
  each = torch.bincount(worlds, minlength=env.num_envs).float()
  rows = wp.to_torch(d.nefc).float()
  return {
    "contacts": each.mean().item(),
    "most_contacts": each.max().item(),
    "pairs": int(d.ncollision.numpy()[0]) / env.num_envs,
    "rows": rows.mean().item(),
    "most_rows": rows.max().item(),
    "on_hfield": (kinds[geoms] == HFIELD).any(1).float().mean().item() if found else 0.0,
  }


def clock() -> float:
  """Return the clock of the GPU [MHz]; 0 if it cannot be read."""
  try:
    words = ["nvidia-smi", "--query-gpu=clocks.sm", "--format=csv,noheader,nounits"]
    return float(subprocess.run(words, capture_output=True, text=True, timeout=10, check=True).stdout.split()[0])
  except (OSError, subprocess.SubprocessError, ValueError, IndexError):
    return 0.0


def measure(robot: str, tree: str, args: argparse.Namespace) -> list[dict[str, Any]]:
  """Return one row for each block of steps of each seed, and one of the physics alone."""
  env = build(TASKS[robot], args.num_envs, args.device, tree)
  action = torch.zeros(env.num_envs, env.action_manager.total_action_dim, device=env.device)

  def step() -> None:
    env.step(action.normal_())

  rows = []
  for seed in args.seeds:
    env.reset(seed=seed)
    for block in range(args.blocks):
      seconds = timed(step, args.steps, 1, env.device)
      synchronize(env.device)
      row = {"robot": robot, "tree": tree, "seed": seed, "block": block, "step_ms": 1e3 * seconds}
      rows.append(row | counts(env) | {"mhz": clock()})
      print(json.dumps(rows[-1]), flush=True)
  physics = sum(time_methods(env, env.sim._engine, ENGINE_CALLS, step, 20).values())
  about = {"robot": robot, "tree": tree, "physics_ms": physics, "sizes": env.sim.buffer_sizes}
  print(json.dumps(about | {"lines": env.sim.overflow_report()}), flush=True)
  env.close()
  return [*rows, about]


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--robots", nargs="+", choices=tuple(TASKS), default=list(TASKS))
  parser.add_argument(
    "--trees", nargs="+", default=["lbvh", "sah"], help="constructors of Warp, as sah or sah:2 (leaf)"
  )
  # The first seed twice: scatter that remains between the two is not one of the terrain.
  parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 1])
  parser.add_argument("--blocks", type=int, default=3)
  parser.add_argument("--steps", type=int, default=80)
  parser.add_argument("--output", type=Path, help="file to write the table to")
  args = parser.parse_args()
  measured = [row for robot in args.robots for tree in args.trees for row in measure(robot, tree, args)]
  lines = [
    "| robot | tree | seed | blocks [ms] | contacts | most | pairs | rows | most | on height fields | clock [MHz] |",
    "|---|---|---|---|---:|---:|---:|---:|---:|---:|---:|",
  ]
  for robot in args.robots:
    for tree in args.trees:
      own = [row for row in measured if (row["robot"], row["tree"]) == (robot, tree) and "seed" in row]
      for start in range(0, len(own), args.blocks):
        lines.append(table_row(own[start : start + args.blocks]))
  lines += ["", "| robot | tree | median step [ms] | physics [ms] | buffers |", "|---|---|---:|---:|---|"]
  for about in (row for row in measured if "physics_ms" in row):
    steps = [row["step_ms"] for row in measured if "seed" in row and shared(row, about)]
    sizes = ", ".join(f"{name} {size}" for name, size in about["sizes"].items())
    physics = f"{about['physics_ms']:.2f}"
    lines.append(f"| {about['robot']} | {about['tree']} | {statistics.median(steps):.2f} | {physics} | {sizes} |")
  print("\n".join(lines))
  if args.output:
    hardware = torch.cuda.get_device_name() if args.device.startswith("cuda") else "CPU"
    versions = package_versions()
    packages = ", ".join(f"{name} {versions[name]}" for name in ("mujoco", "mujoco-warp", "torch"))
    head = [
      "# Steps on rough ground, block by block",
      "",
      f"{date.today()}, {hardware}, {args.num_envs} worlds, {args.steps} steps a block, random actions. {packages}.",
      "",
      f"`python tools/benchmark_rough.py {' '.join(sys.argv[1:])}`",
      "",
    ]
    args.output.parent.mkdir(parents=True, exist_ok=True)
    args.output.write_text("\n".join([*head, *lines, ""]))
    args.output.with_suffix(".json").write_text(json.dumps(measured, indent=1) + "\n")


def shared(row: dict[str, Any], other: dict[str, Any]) -> bool:
  """Return True if two rows are of one robot and one kind of tree."""
  return (row["robot"], row["tree"]) == (other["robot"], other["tree"])


def table_row(blocks: list[dict[str, Any]]) -> str:
  """Return the row of one start, with its blocks side by side."""
  first = blocks[0]
  times = " ".join(f"{block['step_ms']:.2f}" for block in blocks)
  mean = {name: statistics.mean(block[name] for block in blocks) for name in COLUMNS}
  most = {name: max(block[name] for block in blocks) for name in COLUMNS}
  return (
    f"| {first['robot']} | {first['tree']} | {first['seed']} | {times} | {mean['contacts']:.2f} | "
    f"{most['most_contacts']:.0f} | {mean['pairs']:.1f} | {mean['rows']:.1f} | {most['most_rows']:.0f} | "
    f"{mean['on_hfield']:.0%} | {mean['mhz']:.0f} |"
  )


if __name__ == "__main__":
  main()
