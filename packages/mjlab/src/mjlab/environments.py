"""Environments of tasks, and the devices to run them on."""

import copy
import os
from typing import TYPE_CHECKING, Any

from mjlab_core.names import check_name
from mjlab_rl import RunManifest, TaskCfg

from mjlab.registry import load_task

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

GPU_NUM_ENVS = 4096


def make(task: str, *, num_envs: int | None = None, device: str = "auto", play: bool = False) -> "ManagerBasedRlEnv":
  """Build the environment of a task.

  Args:
    task: Task id.
    num_envs: Number of environments; None: a number that suits the device.
    device: "auto" (a GPU if there is one), "cpu" or "cuda:0".
    play: Use the configuration for watching.

  Raises:
    UnknownNameError: The task or the device does not exist.
  """
  loaded = load_task(task)
  cfg = for_watching(loaded) if play else loaded.env
  device = resolve_device(device)
  cfg.scene.num_envs = default_num_envs(device, cfg.scene.num_envs) if num_envs is None else num_envs
  return (loaded.make_env or standard_env)(cfg, device=device)


def standard_env(cfg: Any, *, device: str) -> "ManagerBasedRlEnv":
  """Build an environment of the class that tasks use if they name no other."""
  from mjlab_envs import ManagerBasedRlEnv

  return ManagerBasedRlEnv(cfg, device=device)


def for_watching(parts: "TaskCfg[Any] | RunManifest") -> Any:
  """Return the configuration for watching of a task or a run; that of its training if it has no other."""
  return parts.env if parts.play is None else parts.play(copy.deepcopy(parts.env))


def resolve_device(device: str) -> str:
  """Return the name of an existing device; "auto" is the first GPU, or the CPU without one.

  Raises:
    UnknownNameError: The device does not exist.
  """
  import torch

  count = torch.cuda.device_count() if torch.cuda.is_available() else 0
  if device == "auto":
    return "cuda:0" if count else "cpu"
  if device == "cuda":
    device = "cuda:0"
  return check_name("device", device, ["auto", "cpu", *(f"cuda:{i}" for i in range(count))])


def default_num_envs(device: str, configured: int) -> int:
  """Return the number of environments if the user gives none.

  A GPU runs the number of the task, or 4096 if that is 1. A CPU runs 128 per core, from 64 to 1024, and no more than
  the GPU would.
  """
  wanted = configured if configured > 1 else GPU_NUM_ENVS
  if device == "cpu":
    return min(wanted, max(64, min(1024, 128 * cpu_cores())))
  return wanted


def cpu_cores() -> int:
  """Return the number of cores that this process may use."""
  return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
