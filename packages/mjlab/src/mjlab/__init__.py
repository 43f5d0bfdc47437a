"""GPU-accelerated robot learning from small composable parts: the meta-package and its command line.

`import mjlab` imports neither torch nor Warp: every name below is loaded on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
  from mjlab_rl import RslRlModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg, TaskCfg, load_run, train
  from mjlab_scene import EntityCfg, SceneCfg
  from mjlab_sim import Simulation, SimulationCfg

  from mjlab.making import make
  from mjlab.registry import TaskError, list_tasks, load_task, register_task

__all__ = [
  "EntityCfg",
  "ManagerBasedRlEnv",
  "ManagerBasedRlEnvCfg",
  "RslRlModelCfg",
  "RslRlOnPolicyRunnerCfg",
  "RslRlPpoAlgorithmCfg",
  "SceneCfg",
  "Simulation",
  "SimulationCfg",
  "TaskCfg",
  "TaskError",
  "list_tasks",
  "load_run",
  "load_task",
  "make",
  "register_task",
  "train",
]

_MODULES = {
  "mjlab.making": "make",
  "mjlab.registry": "TaskError list_tasks load_task register_task",
  "mjlab_envs": "ManagerBasedRlEnv ManagerBasedRlEnvCfg",
  "mjlab_rl": "RslRlModelCfg RslRlOnPolicyRunnerCfg RslRlPpoAlgorithmCfg TaskCfg load_run train",
  "mjlab_scene": "EntityCfg SceneCfg",
  "mjlab_sim": "Simulation SimulationCfg",
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
  if name not in _HOMES:
    raise AttributeError(f"module 'mjlab' has no attribute {name!r}")
  value = getattr(import_module(_HOMES[name]), name)
  globals()[name] = value
  return value


def __dir__() -> list[str]:
  return sorted(__all__)
