"""Stages of the start of `train`, from the prompt to the end of the first iteration, with cold and with warm kernels.

  python tools/benchmark_start.py Mjlab-Velocity-Flat-Unitree-G1 --device cuda --output docs/benchmarks/start_cuda.md

Each row is the time in that stage alone, without the stages inside it. The cold column is the first of the runs, with
an empty cache of kernels; the warm one is the median of the others, which use the cache that it filled. Flags that are
not known here go to `train`.
"""

import argparse
import contextlib
import importlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator
from datetime import date
from pathlib import Path
from typing import Any

IMPORTS = {
  "import torch": ("torch",),
  "import MuJoCo Warp": ("mujoco_warp",),
  "import rsl-rl": ("rsl_rl.runners",),
  "import mjlab": ("mjlab_rl.training", "mjlab_envs", "mjlab_sim.warp.engine", "mjlab.cli._train"),
}
STAGES = {
  "scene of the model": [("mjlab_scene", "Scene.__init__")],
  "compile the model": [("mujoco", "MjSpec.compile")],
  "model and data of MuJoCo Warp": [("mujoco_warp", "put_model"), ("mujoco_warp", "put_data")],
  "load kernels": [("mjlab_sim.warp.engine", "load_kernels")],
  "rest of the simulation": [("mjlab_sim", "Simulation.__init__")],
  "expand model fields": [("mjlab_sim", "Simulation.expand_model_fields")],
  "entities and sensors": [("mjlab_scene", "Scene.initialize")],
  "managers and trial calls": [("mjlab_envs", "ManagerBasedRlEnv._load_managers")],
  "trial calls of events and drawings": [("mjlab_envs", "ManagerBasedRlEnv._rehearse")],
  "rest of the environment": [("mjlab_envs", "ManagerBasedRlEnv.__init__")],
  "learner": [("mjlab_rl", "MjlabOnPolicyRunner.__init__")],
  "run directory and manifest": [("mjlab_rl.training", "encode_manifest"), ("mjlab_rl.training", "write_manifest")],
  "record the step": [("mjlab_sim.step_graph", "StepGraph._record")],
  "first reset": [("mjlab_envs", "ManagerBasedRlEnv.reset")],
  "steps of the first rollout": [("mjlab_rl", "MjlabOnPolicyRunner._collect")],
  "first update": [("mjlab_rl", "MjlabOnPolicyRunner._update")],
  "checkpoint": [("mjlab_rl", "MjlabOnPolicyRunner.save")],
}
REST = "all else"


class Clock:
  """Time spent in each stage, without the stages inside it."""

  def __init__(self) -> None:
    self.seconds: dict[str, float] = {}
    self._inside = [REST]
    self._since = time.perf_counter()

  @contextlib.contextmanager
  def stage(self, name: str) -> Generator[None]:
    """Count time under a name."""
    self._turn()
    self._inside.append(name)
    try:
      yield
    finally:
      self._turn()
      self._inside.pop()

  def _turn(self) -> None:
    torch: Any = sys.modules.get("torch")
    is_running = hasattr(torch, "cuda") and torch.cuda.is_initialized()
    if is_running and not torch.cuda.is_current_stream_capturing():
      torch.cuda.synchronize()
    now = time.perf_counter()
    self.seconds[self._inside[-1]] = self.seconds.get(self._inside[-1], 0.0) + now - self._since
    self._since = now

  def watch(self, name: str, module: str, path: str) -> None:
    """Count the calls of a function under a name."""
    owner: Any = importlib.import_module(module)
    *parents, attribute = path.split(".")
    for parent in parents:
      owner = getattr(owner, parent)
    original: Callable[..., Any] = getattr(owner, attribute)

    def timed(*args: Any, **kwargs: Any) -> Any:
      with self.stage(name):
        return original(*args, **kwargs)

    setattr(owner, attribute, timed)


def start_once(task: str, flags: list[str], began: float) -> None:
  """Train one iteration in this process and print the seconds of each stage as JSON."""
  clock = Clock()
  clock.seconds["start of Python"] = time.time() - began
  for name, modules in IMPORTS.items():
    with clock.stage(name):
      for module in modules:
        importlib.import_module(module)
  for name, functions in STAGES.items():
    for module, path in functions:
      clock.watch(name, module, path)
  from mjlab.cli._train import run

  with contextlib.redirect_stdout(sys.stderr):
    code = run([task, "--agent.max-iterations", "1", "--agent.logger", "tensorboard", *flags])
  with clock.stage(REST):
    pass
  clock.seconds["whole"] = time.time() - began
  print(json.dumps(clock.seconds))
  sys.exit(code)


def measure(task: str, flags: list[str], cache: str) -> dict[str, float]:
  """Train one iteration in a new process."""
  with tempfile.TemporaryDirectory() as logs:
    words = [sys.executable, __file__, task, "--began", str(time.time()), *flags, "--log-root", logs]
    result = subprocess.run(
      words, env={**os.environ, "WARP_CACHE_PATH": cache}, stdout=subprocess.PIPE, text=True, check=True
    )
  return json.loads(result.stdout.splitlines()[-1])


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--device", default="auto")
  parser.add_argument("--num-envs", type=int)
  parser.add_argument("--repeats", type=int, default=3, help="runs with warm kernels")
  parser.add_argument("--output", type=Path, help="file to write the table to")
  parser.add_argument("--began", type=float, help=argparse.SUPPRESS)
  args, others = parser.parse_known_args()
  if args.began is not None:
    start_once(args.task, ["--device", args.device, *others], args.began)
  flags = ["--device", args.device, *others]
  flags += ["--env.scene.num-envs", str(args.num_envs)] if args.num_envs else []
  with tempfile.TemporaryDirectory() as cache:
    cold, *warm = (measure(args.task, flags, cache) for _ in range(args.repeats + 1))
  names = dict.fromkeys(name for run in (cold, *warm) for name in run if name != "whole")
  # In the order in which they happen, where that is known.
  order = ["start of Python", *IMPORTS, *STAGES, REST]
  rows = ["| stage | cold [s] | warm [s] |", "|---|---:|---:|"]
  for name in [*sorted(names, key=order.index), "whole"]:
    rows.append(f"| {name} | {cold.get(name, 0.0):.2f} | {statistics.median(run.get(name, 0.0) for run in warm):.2f} |")
  print("\n".join(rows))
  if args.output:
    write(args.output, args.task, rows)


def write(path: Path, task: str, rows: list[str]) -> None:
  """Write the table with what it was measured on."""
  import torch
  from mjlab_rl.runs.manifest import package_versions

  versions = package_versions()
  packages = ", ".join(f"{name} {versions[name]}" for name in ("mujoco", "mujoco-warp", "torch", "rsl-rl-lib"))
  hardware = torch.cuda.get_device_name() if torch.cuda.is_available() else "CPU"
  lines = [
    f"# Start of a training: {task}",
    "",
    f"{date.today()}, {hardware}, {os.cpu_count()} CPU cores, {packages}.",
    "",
    f"`python tools/benchmark_start.py {' '.join(sys.argv[1:])}`",
    "",
    "From the prompt to the end of the first iteration and its checkpoint; each row without the rows inside it.",
    "",
    *rows,
    "",
  ]
  path.parent.mkdir(parents=True, exist_ok=True)
  path.write_text("\n".join(lines))


if __name__ == "__main__":
  main()
