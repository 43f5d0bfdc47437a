"""Limits of training on 64 and 512 GPUs, computed from measured and stated constants.

`uv run python tools/scaling_limits.py`

Network sizes, messages per iteration and checkpoint sizes are counted here, on the CPU. Times of an iteration on one
H200 are from docs/benchmarks. Bandwidths and latencies are those that vendors state, and the spread of rollouts is
assumed: neither is measured. It prints the tables of docs/scaling.md.
"""

import contextlib
import io
import math
from dataclasses import dataclass
from typing import Any

import torch
from mjlab import make
from mjlab.registry import load_task
from mjlab_rl import MjlabOnPolicyRunner, RslRlVecEnvWrapper
from mjlab_rl.runs.process_state import pack

# Rollout and update of 4096 environments on one H200 [s], measured: docs/benchmarks/scaling.md.
TASKS = {
  "Mjlab-Velocity-Flat-Unitree-Go1": (0.256, 0.034),
  "Mjlab-Velocity-Rough-Unitree-Go1": (0.571, 0.041),
  "Mjlab-Velocity-Flat-Unitree-G1": (0.286, 0.036),
}
# Bytes per second of one GPU, and latency of a message between two [s]; stated by vendors, not measured.
NETWORKS = {
  "InfiniBand NDR, 400 Gb/s per GPU": (50e9, 5e-6),
  "Ethernet, 100 Gb/s per 8 GPUs": (12.5e9 / 8, 30e-6),
}
SPREAD = 0.02  # standard deviation of the time of a rollout between GPUs; assumed
DISK = 1e9  # bytes per second of a shared disk; assumed
NUM_ENVS = 4096
COUNTS = (8, 64, 512)
_COUNTED = 128  # worlds whose state is counted


@dataclass(frozen=True, kw_only=True)
class Sizes:
  """Messages and files of a task."""

  gradient: int
  """Size of all gradients [bytes]."""
  updates: int
  """Updates of an iteration."""
  learner: int
  """Part of a checkpoint that all processes share [bytes]."""
  world: int
  """Part of a checkpoint for one environment [bytes]."""
  interval: int
  """Iterations from one checkpoint to the next."""

  def checkpoint(self, count: int) -> int:
    """Return the size of a checkpoint of `count` GPUs [bytes]."""
    return self.learner + count * NUM_ENVS * self.world


def sizes(task_name: str) -> Sizes:
  """Count parameters and state on the CPU."""
  task = load_task(task_name)
  env = make(task_name, num_envs=_COUNTED, device="cpu")
  with contextlib.redirect_stdout(io.StringIO()):
    runner = MjlabOnPolicyRunner(RslRlVecEnvWrapper(env), task.agent)
  parameters = sum(weight.numel() for network in runner.networks.values() for weight in network.parameters())
  # Weights, and two moments of each for the optimiser.
  learner, world = 3 * 4 * parameters, len(pack(env.state_dict())) // _COUNTED
  env.close()
  algorithm: Any = getattr(task.agent, "algorithm")  # noqa: B009
  return Sizes(
    gradient=4 * parameters,
    updates=algorithm.num_learning_epochs * algorithm.num_mini_batches,
    learner=learner,
    world=world,
    interval=task.agent.save_interval,
  )


def message_time(size: int, count: int, bandwidth: float, latency: float) -> float:
  """Return the time of an all-reduce as a ring sends the bytes and a tree has the latency [s]."""
  return 2 * (count - 1) / count * size / bandwidth + 2 * math.ceil(math.log2(count)) * latency


def slowest(count: int) -> float:
  """Return the expected maximum of `count` standard normal numbers, from their distribution."""
  x = torch.linspace(-8, 8, 16001, dtype=torch.float64)
  below = torch.special.ndtr(x) ** count
  return float(torch.trapezoid((x > 0).double() - below, x))


def efficiency(task: str, its: Sizes, count: int, network: tuple[float, float], *, saves: bool) -> float:
  """Return the training speed per GPU as a fraction of that of one GPU, with or without checkpoints."""
  rollout, update = TASKS[task]
  if count == 1:
    return 1.0
  waiting = SPREAD * rollout * slowest(count)
  sending = its.updates * message_time(its.gradient, count, *network) + message_time(8000, count, *network)
  # The first process collects the worlds and writes them; the others wait for its next message.
  saving = its.checkpoint(count) * (1 / network[0] + 1 / DISK) / its.interval if saves else 0.0
  return (rollout + update) / (rollout + update + waiting + sending + saving)


def main() -> None:
  torch.set_num_threads(1)
  counted = {task: sizes(task) for task in TASKS}
  columns = ("task", "gradient [MB]", "updates per iteration", "sent per GPU and iteration [MB]")
  columns += ("checkpoint of 8, 64, 512 GPUs [GB]", "time to write it [s]")
  print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
  for task, its in counted.items():
    files = [its.checkpoint(count) for count in COUNTS]
    figures = [f"{its.gradient / 1e6:.2f}", str(its.updates), f"{2 * its.gradient * its.updates / 1e6:.0f}"]
    figures += [", ".join(f"{size / 1e9:.2f}" for size in files), ", ".join(f"{size / DISK:.1f}" for size in files)]
    print(f"| {task} | {' | '.join(figures)} |")
  columns = ("task", "network", "efficiency with 8, 64, 512 GPUs", "the same without checkpoints")
  columns += ("all-reduce with 512 [ms]", "below 0.8 from")
  print(f"\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
  for task, its in counted.items():
    for name, network in NETWORKS.items():
      rates = {
        saves: ", ".join(f"{efficiency(task, its, count, network, saves=saves):.2f}" for count in COUNTS)
        for saves in (True, False)
      }
      limit = next(count for count in range(2, 10**6) if efficiency(task, its, count, network, saves=True) < 0.8)
      time = 1e3 * message_time(its.gradient, 512, *network)
      print(f"| {task} | {name} | {rates[True]} | {rates[False]} | {time:.2f} | {limit} GPUs |")
  print(f"\nTwo of 512 processes have the same 32-bit seed with probability {512 * 511 / 2 / 2**32:.0e}.")


if __name__ == "__main__":
  main()
