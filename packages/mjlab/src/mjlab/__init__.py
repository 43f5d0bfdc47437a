"""GPU-accelerated robot learning from small composable parts: the meta-package and its command line.

`import mjlab` imports neither torch nor Warp: every name below is loaded on first use.
"""

import os
import sys
from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

from mjlab._moved import MovedModules

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

# The last finder is asked only for modules that do not exist.
sys.meta_path.append(MovedModules)

# By default torch's threads spin for a millisecond or more on cores that MuJoCo's threads or other programs need. With
# 256 environments of the Go1 on two cores, an iteration of training takes 1.25 s with this default, 1.2 s if threads
# sleep at once, and 1.1 s if they spin for ten microseconds. Beside another busy program it takes 10 s with the
# default, and 2 to 4 s otherwise. Only libgomp, torch's on Linux, can spin for so short a time; it reads this when
# torch is imported. The runner sets the number of threads: one in rollouts, all in updates.
if "OMP_WAIT_POLICY" not in os.environ:
  os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
  os.environ.setdefault("GOMP_SPINCOUNT", "1000")
