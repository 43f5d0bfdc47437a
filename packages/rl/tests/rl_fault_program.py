"""Run of two processes of which the second one hangs: `torchrun --nproc-per-node 2 rl_fault_program.py FOLDER`."""

import sys
import threading
from pathlib import Path
from typing import Any

import mjlab_rl
import torch
from mjlab_rl.ranks import Ranks
from rl_point_env import PointEnv, PointEnvCfg


class HangingEnv(PointEnv):
  """Environment whose step does not return after the second iteration."""

  def step(self, action: torch.Tensor) -> Any:
    if Ranks.current().rank == 1 and int(self.steps) >= 12:
      threading.Event().wait()
    return super().step(action)


if __name__ == "__main__":
  torch.set_num_threads(1)
  for module in ("rl_point_env", "rl_fault_program"):
    mjlab_rl.trust_package(module)
  agent = mjlab_rl.RslRlOnPolicyRunnerCfg(num_steps_per_env=6, logger="none", experiment_name="point")
  task = mjlab_rl.TaskCfg(env=PointEnvCfg(), agent=agent)
  mjlab_rl.train(task, name="Point", make_env=HangingEnv, log_root=Path(sys.argv[1]), rank_timeout=16.0)
