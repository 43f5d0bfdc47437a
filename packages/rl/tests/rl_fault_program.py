"""Two processes of which the second one fails: `rl_two_processes.py rl_fault_program.py FOLDER FAULT`."""

import sys
import threading
from pathlib import Path
from typing import Any

import mjlab_rl
import torch
from mjlab_rl.processes.ranks import Ranks
from rl_point_env import PointEnv, PointEnvCfg


class FailingEnv(PointEnv):
  """Environment of which a step after the second iteration does not return, or rewards with NaN."""

  def step(self, action: torch.Tensor) -> Any:
    is_broken = Ranks.current().rank == 1 and int(self.steps) >= 12
    if is_broken and sys.argv[2] == "hangs":
      threading.Event().wait()
    observations, reward, *rest = super().step(action)
    return observations, reward * torch.nan if is_broken else reward, *rest


if __name__ == "__main__":
  torch.set_num_threads(1)
  for module in ("rl_point_env", "rl_fault_program"):
    mjlab_rl.trust_package(module)
  agent = mjlab_rl.RslRlOnPolicyRunnerCfg(num_steps_per_env=6, logger="none", experiment_name="point", save_interval=1)
  agent.actor.hidden_dims = agent.critic.hidden_dims = (8,)
  task = mjlab_rl.TaskCfg(env=PointEnvCfg(), agent=agent)
  mjlab_rl.train(task, name="Point", make_env=FailingEnv, log_root=Path(sys.argv[1]), rank_timeout=16.0)
