"""Kernels of a replayed environment step: their number and time by origin (GPU).

  python tools/profile_step.py Mjlab-Velocity-Flat-Unitree-Go1 Mjlab-Velocity-Flat-Unitree-G1 --num-envs 4096 16384

Each part of the step launches a mark, a kernel that does nothing, while the step is recorded: what runs between two
marks belongs to one part. Kernels of Warp are known by the module that launched them.
"""

import argparse
import contextlib
import re
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Sequence
from pathlib import Path
from typing import Any

import torch
import warp as wp
from benchmark_step import heading, make, timed
from mjlab_envs import ManagerBasedRlEnv
from mjlab_managers.terms.binding import Term

MARK = "spin_kernel"
REST = "rest of the step"
STAGES = ("act", "simulate", "terminate", "reward", "reset", "command", "event", "observe")
LIBRARIES = {
  "mujoco_warp": "MuJoCo Warp",
  "mjlab_sim.warp.solver.fused_newton": "constraint solver of this project",
  "mjlab_sim.warp.rays": "rays of this project",
  "mjlab_sim.warp": "other Warp kernels of this project",
  "mjlab": "other Warp kernels of this project",
}


class Marks:
  """Parts of the step in the order in which they are recorded."""

  def __init__(self) -> None:
    self.parts: list[str] = []
    self.modules: dict[str, str] = {}
    """Module of each kernel of Warp, by its key."""
    self._inside = [REST]

  def start(self) -> None:
    """Forget an earlier run of the step."""
    self.parts.clear()

  @contextlib.contextmanager
  def part(self, name: str) -> Generator[None]:
    """Count kernels under a name."""
    self._inside.append(name)
    self._mark()
    try:
      yield
    finally:
      self._inside.pop()
      self._mark()

  @property
  def stage(self) -> str:
    return self._inside[-1]

  def _mark(self) -> None:
    self.parts.append(self.stage)
    if torch.cuda.is_available():
      torch.cuda._sleep(1)


@contextlib.contextmanager
def watched(env: ManagerBasedRlEnv, marks: Marks) -> Generator[None]:
  """Have recordings of the step launch marks meanwhile; the environment is of no use afterwards."""

  def within(method: Callable[..., Any], name: str) -> Callable[..., Any]:
    def call(*args: Any, **kwargs: Any) -> Any:
      with marks.part(name):
        return method(*args, **kwargs)

    return call

  def noted(launch: Callable[..., Any]) -> Callable[..., Any]:
    def call(kernel: Any, *args: Any, **kwargs: Any) -> Any:
      marks.modules[kernel.key] = kernel.func.__module__
      return launch(kernel, *args, **kwargs)

    return call

  for stage in STAGES:
    setattr(env, f"_{stage}", within(getattr(env, f"_{stage}"), stage))
  terms: Any = Term
  call_term = terms.__call__

  def call(term: Term, *args: Any) -> Any:
    with marks.part(f"{marks.stage.removesuffix(': terms')}: terms"):
      return call_term(term, *args)

  warp: Any = wp
  launches = wp.launch, wp.launch_tiled
  graph: Any = env._step_graph
  stages = graph._fn

  def run() -> None:
    marks.start()
    stages()

  graph._fn = run
  env.request_recapture("profiling")
  try:
    terms.__call__ = call
    warp.launch, warp.launch_tiled = noted(wp.launch), noted(wp.launch_tiled)
    yield
  finally:
    terms.__call__ = call_term
    warp.launch, warp.launch_tiled = launches


def origin(name: str, part: str, modules: dict[str, str]) -> str:
  """Return where a kernel comes from, by its name and the part of the step in which it runs."""
  key = re.sub(r"(_[0-9a-f]{8})?_cuda_kernel_forward$", "", name)
  if key in modules:
    return next(label for prefix, label in LIBRARIES.items() if modules[key].startswith(prefix))
  if name.startswith(("Memcpy", "Memset")):
    return "copies and fills of memory"
  return f"torch, {part}"


def grouped(
  kernels: Iterable[tuple[str, float]], parts: Sequence[str], modules: dict[str, str]
) -> dict[str, tuple[int, float]]:
  """Return number and microseconds of kernels by origin.

  Args:
    kernels: Name and microseconds of all kernels in the order in which they ran, marks included.
    parts: Part that begins at each mark of a step.
    modules: Module of each kernel of Warp.
  """
  found: dict[str, tuple[int, float]] = {}
  part, seen = REST, 0
  for name, spent in kernels:
    if MARK in name:
      part = parts[seen % len(parts)]
      seen += 1
      continue
    label = origin(name, part, modules)
    count, total = found.get(label, (0, 0.0))
    found[label] = count + 1, total + spent
  if seen % max(len(parts), 1):
    raise SystemExit(f"{seen} marks were profiled, which is not a multiple of the {len(parts)} of a step")
  return found


def profile(task: str, num_envs: int, args: argparse.Namespace) -> list[str]:
  """Return the table of one task."""
  env = make(task, num_envs, "cuda", "auto", capture=True)
  env.reset()
  action = torch.zeros(num_envs, env.action_manager.total_action_dim, device=env.device)

  def step() -> None:
    env.step(action.normal_())

  for _ in range(20):
    step()
  whole = 1e3 * timed(step, 100, 3, env.device)
  marks = Marks()
  with watched(env, marks):
    for _ in range(6):
      step()
  torch.cuda.synchronize()
  with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile:
    for _ in range(args.steps):
      step()
    torch.cuda.synchronize()
  events = sorted(profile.events() or (), key=lambda event: event.time_range.start)
  found = grouped([(event.name, event.device_time) for event in events], marks.parts, marks.modules)
  lines = [f"## {task}, {num_envs} worlds: {whole:.2f} ms", "", "| origin | kernels | ms |", "| --- | ---: | ---: |"]
  totals = [sum(values) / args.steps for values in zip(*found.values(), strict=True)]
  for label, (count, spent) in sorted(found.items(), key=lambda item: -item[1][1]):
    lines.append(f"| {label} | {count / args.steps:.0f} | {spent / args.steps / 1e3:.3f} |")
  lines += [f"| all | {totals[0]:.0f} | {totals[1] / 1e3:.3f} |", ""]
  print("\n".join(lines), flush=True)
  count, spent = Counter(), Counter()
  for event in events:
    name = re.sub(r"<.*", "", event.name)[:70]
    count[name] += 1
    spent[name] += event.device_time
  for name, total in spent.most_common(args.rows):
    print(f"{total / args.steps:9.1f} us  {count[name] / args.steps:7.1f} x  {name}")
  env.close()
  return lines


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("tasks", nargs="+")
  parser.add_argument("--num-envs", type=int, nargs="+", default=[4096])
  parser.add_argument("--steps", type=int, default=10)
  parser.add_argument("--rows", type=int, default=45, help="kernels to print one by one")
  parser.add_argument("--output", type=Path)
  args = parser.parse_args()
  lines = [heading("Kernels of a step by origin", "cuda") + " Random actions, without curricula.", ""]
  for task in args.tasks:
    for num_envs in args.num_envs:
      lines += profile(task, num_envs, args)
      if args.output:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        args.output.write_text("\n".join(lines))


if __name__ == "__main__":
  main()
