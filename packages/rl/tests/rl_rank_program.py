"""Program of one process of a run: `torchrun --nproc-per-node 2 rl_rank_program.py FOLDER [CHECKPOINT]`."""

import sys
from pathlib import Path

import mjlab_rl
import torch
from rl_point_env import PointEnv, PointEnvCfg


class KeepingRunner(mjlab_rl.MjlabOnPolicyRunner):
  """Writes what each rank has at the end."""

  folder: Path

  def learn(self, num_learning_iterations: int, init_at_random_ep_len: bool = False) -> None:
    starts = self.env.get_observations()["actor"].clone()
    super().learn(num_learning_iterations, init_at_random_ep_len)
    kept = {"starts": starts, "learner": self.alg.save(), "steps": self._total_steps, "draw": torch.rand(4)}
    torch.save(kept, self.folder / f"rank_{self.ranks.rank}.pt")


def main(folder: Path, resume: Path | None) -> None:
  torch.set_num_threads(1)
  for module in ("rl_point_env", "rl_rank_program"):
    mjlab_rl.trust_package(module)
  KeepingRunner.folder = folder
  agent = mjlab_rl.RslRlOnPolicyRunnerCfg(num_steps_per_env=6, logger="none", experiment_name="point")
  agent.max_iterations = 3 if resume is None else 5
  agent.actor.obs_normalization = True
  task = mjlab_rl.TaskCfg(env=PointEnvCfg(), agent=agent, runner=KeepingRunner)
  mjlab_rl.train(task, name="Point", make_env=PointEnv, log_root=folder / "logs", resume=resume)


if __name__ == "__main__":
  import rl_rank_program

  rl_rank_program.main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
