"""Environments by task name, and what fits the machine they run on."""

import os
from typing import TYPE_CHECKING, Any

from mjlab.registry import load_task

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

GPU_WORLDS = 4096


class DeviceError(ValueError):
  """A device that is not there."""


def make(task: str, *, num_envs: int | None = None, device: str = "auto", play: bool = False) -> "ManagerBasedRlEnv":
  """Environment of a task.

  Args:
    task: Task id.
    num_envs: Number of worlds; None: what suits the device.
    device: "auto" (a GPU where there is one), "cpu" or "cuda:0".
    play: Use the task's configuration for watching.

  Raises:
    TaskError: No such task.
    DeviceError: No such device.
  """
  loaded = load_task(task)
  cfg = loaded.play(loaded.env) if play and loaded.play is not None else loaded.env
  device = resolve_device(device)
  cfg.scene.num_envs = default_worlds(device, cfg.scene.num_envs) if num_envs is None else num_envs
  return (loaded.make_env or standard_env)(cfg, device=device)


def standard_env(cfg: Any, *, device: str) -> "ManagerBasedRlEnv":
  """The environment class of tasks that name no other."""
  from mjlab_envs import ManagerBasedRlEnv

  return ManagerBasedRlEnv(cfg, device=device)


def resolve_device(device: str) -> str:
  """Name of an existing device; "auto" is the first GPU, or the CPU where there is none.

  Raises:
    DeviceError: There is no such device.
  """
  import torch

  count = torch.cuda.device_count() if torch.cuda.is_available() else 0
  if device == "auto":
    return "cuda:0" if count else "cpu"
  if device == "cuda":
    device = "cuda:0"
  names = ["cpu", *(f"cuda:{i}" for i in range(count))]
  if device not in names:
    raise DeviceError(f"device '{device}' does not exist; there is {', '.join(names)} (and auto)")
  return device


def default_worlds(device: str, configured: int) -> int:
  """Worlds where nobody asked for a number.

  On a GPU what the task says, 4096 where it says 1; on a CPU 128 for each core, between 64 and 1024, and no more than
  on a GPU.
  """
  wanted = configured if configured > 1 else GPU_WORLDS
  if device == "cpu":
    return min(wanted, max(64, min(1024, 128 * cpu_cores())))
  return wanted


def cpu_cores() -> int:
  """Cores this process may use."""
  return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share_cores() -> None:
  """Let torch's threads sleep soon after each operation. Has an effect only before torch is imported.

  By default they spin for a millisecond and more, on cores that MuJoCo's own threads want next, or another program.
  Measured with 256 worlds of the Go1 on two cores: an iteration of training takes 1.25 s with that, 1.2 s when they
  sleep at once and 1.1 s when they spin for ten microseconds; beside another busy program 10 s with that, and 2 to 4 s
  without. How many threads torch uses is the runner's choice: one in rollouts, all in updates.
  """
  if "OMP_WAIT_POLICY" not in os.environ:
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    # Only libgomp, torch's on Linux, can spin for so short a time.
    os.environ.setdefault("GOMP_SPINCOUNT", "1000")
