"""Time of environment steps with MuJoCo Warp's constraint solver and with the fused one, and how well the two agree.

  python tools/benchmark_solver.py --output runs/solver

One environment per task and number of worlds takes all variants in turn, with its step recorded again for each. A
variant that does not compile or run prints its message, and the next one follows.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco_warp as mjw
import torch
import warp as wp
from benchmark_step import heading, make, synchronize
from mjlab_sim.warp.solver.fused_newton import FusedNewton

GO1, G1 = "Mjlab-Velocity-Flat-Unitree-Go1", "Mjlab-Velocity-Flat-Unitree-G1"
_96 = {"rows": 96, "groups": 384}
_64 = {"rows": 64, "groups": 256}
_128 = {"threads": 64, "rows": 128}
_ALL = {"rows": 1 << 20, "groups": 1 << 20}
FUSED: dict[str, dict[str, int]] = {
  "fused": {},
  "fused, 32 threads": {"threads": 32, **_96},
  "fused, 64 threads": {"threads": 64, **_96},
  "fused, 128 threads": {"threads": 128, **_96},
  "fused, 256 threads": {"threads": 256, **_96},
  "fused, 64 threads, 96 rows, 9 KB of J": {"threads": 64, "rows": 96, "groups": 576},
  "fused, 64 threads, 112 rows, 10 KB of J": {"threads": 64, "rows": 112, "groups": 640},
  "fused, 64 threads, 128 rows, 8 KB of J": {**_128, "groups": 512},
  "fused, 64 threads, 128 rows, 12 KB of J": {**_128, "groups": 768},
  "fused, 64 threads, 128 rows, 16 KB of J": {**_128, "groups": 1024},
  "fused, 64 threads, 160 rows, 20 KB of J": {"threads": 64, "rows": 160, "groups": 1280},
  "fused, 32 threads, 64 rows, 4 KB of J": {"threads": 32, **_64},
  "fused, 64 threads, 64 rows, 4 KB of J": {"threads": 64, **_64},
  "fused, 32 threads, 64 registers": {"threads": 32, "registers": 64, **_96},
  "fused, 32 threads, 80 registers": {"threads": 32, "registers": 80, **_96},
  "fused, 32 threads, all rows": {"threads": 32, **_ALL},
  "fused, 64 threads, all rows": {"threads": 64, **_ALL},
}
"""Sizes of the fused solver; the first takes them from the model."""


@dataclass
class Variant:
  """One way to solve."""

  name: str
  fused: dict[str, int] | None = None
  options: dict[str, Any] = field(default_factory=dict)
  """Fields of MuJoCo Warp's options."""


def variants(iterations: list[int], fused: list[str]) -> list[Variant]:
  """Return the variants of one environment, the most telling first."""
  rows = [Variant("mujoco_warp"), *(Variant(name, FUSED[name]) for name in fused)]
  rows += [Variant("mujoco_warp, no qacc_smooth", options={"run_qacc_smooth": False})]
  rows += [Variant("fused, no qacc_smooth", {}, {"run_qacc_smooth": False})]
  rows += [Variant(f"mujoco_warp, at most {k} iterations", options={"iterations": k}) for k in iterations]
  return [*rows, Variant("mujoco_warp, again")]


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--seconds", type=float, default=230, help="start no measurement after this time")
  parser.add_argument("--steps", type=int, default=50)
  parser.add_argument("--repeats", type=int, default=3)
  parser.add_argument("--worlds", type=int, default=4096)
  parser.add_argument("--more-worlds", type=int, default=16384)
  parser.add_argument("--only", nargs="*", default=[], help="names of variants to take")
  parser.add_argument("--output", type=Path, help="folder to write solver.json and solver_table.md to")
  args = parser.parse_args()
  end = time.perf_counter() + args.seconds
  few = ["fused", "fused, 32 threads", "fused, 64 threads"]
  plan = [
    (GO1, args.worlds, "", variants([1, 2, 4, 6], list(FUSED))),
    (G1, args.worlds, "", variants([1, 2, 4, 6], list(FUSED))),
    (GO1, args.more_worlds, "", variants([], few)),
    (G1, args.more_worlds, "", variants([], few)),
    (GO1, args.worlds, "pyramidal", variants([], few)),
  ]
  rows: list[dict[str, Any]] = []
  for task, worlds, cone, every in plan:
    kinds = [kind for kind in every if not args.only or kind.name in args.only]
    if time.perf_counter() > end:
      print(f"no time for {task}, {worlds} worlds {cone}")
      continue
    try:
      rows += measure(task, worlds, cone, kinds, args, end)
    except Exception as error:
      print(f"{task} {worlds} {cone}: {type(error).__name__}: {str(error)[:2000]}", flush=True)
    if args.output:
      write(args.output, args.device, rows)


def measure(
  task: str, worlds: int, cone: str, kinds: list[Variant], args: argparse.Namespace, end: float
) -> list[dict[str, Any]]:
  """Return one row for each variant that ran."""
  begin = time.perf_counter()
  env = build(task, worlds, args.device, cone)
  engine: Any = env.sim._engine
  m, d = engine._m, engine._d
  env.reset()
  action = torch.zeros(worlds, env.action_manager.total_action_dim, device=env.device)

  def step() -> None:
    env.step(action.normal_())

  solvers = {kind.name: FusedNewton(m, d, **kind.fused) for kind in kinds if kind.fused is not None}
  load(solvers)
  print(f"{task}, {worlds} worlds, {cone or 'own cone'}: ready in {time.perf_counter() - begin:.0f} s", flush=True)
  rows = []
  for kind in kinds:
    if time.perf_counter() > end:
      print(f"no time for {kind.name}")
      continue
    before = {name: getattr(m.opt, name) for name in kind.options}
    try:
      for name, value in kind.options.items():
        setattr(m.opt, name, value)
      engine._fused = solvers.get(kind.name)
      engine._launcher.clear()
      env._step_graph.invalidate()
      row: dict[str, Any] = {"task": task, "worlds": worlds, "cone": cone or "own", "variant": kind.name}
      low, middle, high = timed(step, args.steps, args.repeats, env.device)
      row |= {"step_ms": round(middle, 3), "least_ms": round(low, 3), "most_ms": round(high, 3)}
      iterations = wp.to_torch(d.solver_niter).float()
      row |= {"iterations": round(float(iterations.mean()), 2), "most_iterations": int(iterations.max())}
      if "iterations" not in kind.options:
        row |= one_solve(engine, solvers.get(kind.name))
      rows.append(row)
      print(json.dumps(row), flush=True)
    except Exception as error:
      print(f"{kind.name}: {type(error).__name__}: {str(error)[:2000]}", flush=True)
    finally:
      for name, value in before.items():
        setattr(m.opt, name, value)
  env.close()
  return rows


def build(task: str, worlds: int, device: str, cone: str) -> Any:
  """Build the task's training environment, with another friction cone if one is named."""
  if not cone:
    return make(task, worlds, device, "warp", capture=True)
  from mjlab.registry import load_task
  from mjlab_envs import ManagerBasedRlEnv

  cfg: Any = load_task(task).env
  cfg.scene.num_envs, cfg.seed, cfg.sim.engine, cfg.sim.cone = worlds, 1, "warp", cone
  return ManagerBasedRlEnv(cfg, device)


def load(solvers: dict[str, FusedNewton]) -> None:
  """Compile and load kernels side by side; one that fails says so when it is launched."""
  kernels = [(kernel, solver) for solver in solvers.values() for kernel in solver.kernels]

  def one(kernel: Any, solver: FusedNewton) -> None:
    try:
      kernel.module.load(solver.is_left.device, solver._threads if solver.is_left.device.is_cuda else None)
    except Exception as error:
      print(f"compiling failed: {str(error)[:3000]}", flush=True)

  with ThreadPoolExecutor(8) as pool:
    list(pool.map(lambda pair: one(*pair), kernels))


def timed(step: Callable[[], None], steps: int, repeats: int, device: torch.device) -> tuple[float, float, float]:
  """Return the least, the median and the greatest mean time of `steps` steps [ms]."""
  for _ in range(20):
    step()
  samples = []
  for _ in range(repeats):
    synchronize(device)
    begin = time.perf_counter()
    for _ in range(steps):
      step()
    synchronize(device)
    samples.append(1e3 * (time.perf_counter() - begin) / steps)
  return min(samples), statistics.median(samples), max(samples)


def one_solve(engine: Any, fused: FusedNewton | None) -> dict[str, Any]:
  """Return the time of one solve in the worlds' present state, and how far it is from MuJoCo Warp's solution."""
  m, d = engine._m, engine._d
  device = torch.device(wp.device_to_torch(engine._wp_device))
  row: dict[str, Any] = {}
  solve = fused.solve if fused is not None else mjw.solve
  synchronize(device)
  # On Warp's own stream: torch's default one cannot be captured.
  with wp.ScopedDevice(engine._wp_device):
    mjw.step1(m, d)
    mjw.fwd_actuation(m, d)
    mjw.fwd_acceleration(m, d)
    mjw.solve(m, d)
    synchronize(device)
    reference = wp.to_torch(d.qacc).clone()
    row["solve_us"] = round(solve_time(lambda: solve(m, d), device), 1)
    synchronize(device)
    found = wp.to_torch(d.qacc)
    scale = reference.abs().amax(1) + 1
    relative = (found - reference).abs().amax(1) / scale
    row["rows"] = round(float(wp.to_torch(d.nefc).float().mean()), 1)
    if fused is not None:
      row |= {
        "median_difference": float(f"{relative.median():.2e}"),
        "percentile_99": float(f"{relative.quantile(0.99):.2e}"),
        "greatest": float(f"{relative.max():.2e}"),
        "left_to_second_kernel": round(float(wp.to_torch(fused.is_left).float().mean()), 5),
      }
  return row


def solve_time(solve: Callable[[], None], device: torch.device) -> float:
  """Return the time of one call [us], of twenty in a graph."""
  solve()
  if device.type != "cuda":
    begin = time.perf_counter()
    solve()
    return 1e6 * (time.perf_counter() - begin)
  with wp.ScopedCapture() as capture:
    for _ in range(20):
      solve()
  graph: Any = capture.graph
  samples = []
  for _ in range(5):
    torch.cuda.synchronize()
    begin = time.perf_counter()
    wp.capture_launch(graph)
    torch.cuda.synchronize()
    samples.append(1e6 * (time.perf_counter() - begin) / 20)
  return statistics.median(samples)


def write(folder: Path, device: str, rows: list[dict[str, Any]]) -> None:
  """Write the rows as JSON, and as a Markdown table for each task."""
  folder.mkdir(parents=True, exist_ok=True)
  (folder / "solver.json").write_text(json.dumps(rows, indent=1) + "\n")
  lines = [heading("Constraint solvers", device), ""]
  columns = {
    "variant": "variant",
    "step_ms": "step [ms]",
    "solve_us": "one solve [us]",
    "iterations": "mean iterations",
    "median_difference": "difference, median",
    "percentile_99": "99 %",
    "left_to_second_kernel": "left to the second kernel",
  }
  for key in dict.fromkeys((row["task"], row["worlds"], row["cone"]) for row in rows):
    lines += [f"## {key[0]}, {key[1]} worlds" + (f", {key[2]} cone" if key[2] != "own" else ""), ""]
    lines += ["| " + " | ".join(columns.values()) + " |", "|" + " --- |" * len(columns)]
    for row in rows:
      if (row["task"], row["worlds"], row["cone"]) == key:
        lines.append("| " + " | ".join(str(row.get(name, "")) for name in columns) + " |")
    lines.append("")
  (folder / "solver_table.md").write_text("\n".join(lines))


if __name__ == "__main__":
  main()
