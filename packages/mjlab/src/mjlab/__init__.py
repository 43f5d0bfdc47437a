"""GPU-accelerated robot learning from small composable parts: the meta-package and its command line.

`import mjlab` imports neither torch nor Warp: every name below is loaded on first use.
"""

from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

from mjlab._moved import announce_moved_modules

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
  from mjlab_rl import (
    RslRlDistillationAlgorithmCfg,
    RslRlDistillationRunnerCfg,
    RslRlModelCfg,
    RslRlOnPolicyRunnerCfg,
    RslRlPpoAlgorithmCfg,
    TaskCfg,
    load_run,
    train,
  )
  from mjlab_scene import EntityCfg, SceneCfg
  from mjlab_sim import Simulation, SimulationCfg

  from mjlab.environments import make
  from mjlab.registry import list_tasks, load_task, register_task

__all__ = [
  "EntityCfg",
  "ManagerBasedRlEnv",
  "ManagerBasedRlEnvCfg",
  "RslRlDistillationAlgorithmCfg",
  "RslRlDistillationRunnerCfg",
  "RslRlModelCfg",
  "RslRlOnPolicyRunnerCfg",
  "RslRlPpoAlgorithmCfg",
  "SceneCfg",
  "Simulation",
  "SimulationCfg",
  "TaskCfg",
  "list_tasks",
  "load_run",
  "load_task",
  "make",
  "register_task",
  "train",
]

__getattr__, __dir__ = lazy_exports(
  __name__,
  {
    ".environments": "make",
    ".registry": "list_tasks load_task register_task",
    "mjlab_envs": "ManagerBasedRlEnv ManagerBasedRlEnvCfg",
    "mjlab_rl": (
      "RslRlDistillationAlgorithmCfg RslRlDistillationRunnerCfg RslRlModelCfg RslRlOnPolicyRunnerCfg "
      "RslRlPpoAlgorithmCfg TaskCfg load_run train"
    ),
    "mjlab_scene": "EntityCfg SceneCfg",
    "mjlab_sim": "Simulation SimulationCfg",
  },
)

announce_moved_modules()
