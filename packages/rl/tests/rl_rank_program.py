"""Program of one process of a run: `rl_two_processes.py rl_rank_program.py FOLDER`."""

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mjlab_rl
import torch
from mjlab_rl.offpolicy.runner import MjlabOffPolicyRunner
from mjlab_rl.processes.ranks import Ranks
from rl_point_env import PointEnv, PointEnvCfg
from torch import distributed

COLLECTIVES = ("all_reduce", "broadcast", "all_gather_object", "gather_object", "barrier")


class KeepingRunner(mjlab_rl.MjlabOnPolicyRunner):
  """Runner that writes the state of each rank at the end."""

  folder: Path

  def learn(self, num_learning_iterations: int, init_at_random_ep_len: bool = False) -> None:
    starts = self.env.get_observations()["actor"].clone()
    super().learn(num_learning_iterations, init_at_random_ep_len)
    assert self.log_dir is not None
    kept = {
      "starts": starts,
      "learner": self.alg.save(),
      "env": self.env.unwrapped.state_dict(),
      "steps": self._total_steps,
      "rate": self.alg.learning_rate,
      "draw": torch.rand(4),
    }
    torch.save(kept, self.folder / f"{self.log_dir.name.split('_')[-1]}_{self.ranks.rank}.pt")


class KeepingOffPolicyRunner(KeepingRunner, MjlabOffPolicyRunner):
  """The same with a replay memory."""


def train(folder: Path, name: str, iterations: int, resume: Path | None = None) -> Path:
  """Train with PPO, or with FlashSAC for names with "replay", which has the most state for each world.

  Returns:
    The last checkpoint.
  """
  agent: Any = mjlab_rl.RslRlOnPolicyRunnerCfg(num_steps_per_env=6, logger="none", experiment_name=name)
  kind: type[KeepingRunner] = KeepingRunner
  if "replay" in name:
    kind, agent = KeepingOffPolicyRunner, mjlab_rl.offpolicy.flashsac(agent)
    agent.num_steps_per_env, agent.save_replay = 12, True
    algorithm = agent.algorithm
    algorithm.batch_size, algorithm.learning_starts, algorithm.replay_steps = 16, 5, 40
    algorithm.final_learning_rate = None
  else:
    agent.actor.obs_normalization = agent.critic.obs_normalization = True
  agent.run_name, agent.max_iterations, agent.save_interval = name, iterations, 100
  agent.actor.hidden_dims = agent.critic.hidden_dims = (8,)
  task = mjlab_rl.TaskCfg(env=PointEnvCfg(), agent=agent, runner=kind)
  mjlab_rl.train(task, name="Point", make_env=PointEnv, log_root=folder / "logs", resume=resume)
  (run,) = (folder / "logs" / name).iterdir()
  return run / f"model_{iterations}.pt"


def counted(name: str, call: Callable[..., Any], counts: Counter[str]) -> Callable[..., Any]:
  """Return a collective operation that counts its calls."""

  def counting(*args: Any, **options: Any) -> Any:
    counts[name] += 1
    return call(*args, **options)

  return counting


def main(folder: Path) -> None:
  torch.set_num_threads(1)
  for module in ("rl_point_env", "rl_rank_program"):
    mjlab_rl.trust_package(module)
  KeepingRunner.folder = folder
  ranks = Ranks.launched()
  with ranks.joined("cpu"):
    first = train(folder, "half", 3)
    train(folder, "resumed", 5, resume=first)
    train(folder, "whole", 5)
    if (alone := folder / "alone.pt").exists():
      train(folder, "alone", 5, resume=alone)
    first = train(folder, "replay-half", 2)
    train(folder, "replay-resumed", 4, resume=first)
    train(folder, "replay-whole", 4)
    counts: Counter[str] = Counter()
    for name in COLLECTIVES:
      setattr(distributed, name, counted(name, getattr(distributed, name), counts))
    train(folder, "short", 2)
    before = dict(counts)
    counts.clear()
    train(folder, "long", 5)
    torch.save((before, dict(counts)), folder / f"counts_{ranks.rank}.pt")


if __name__ == "__main__":
  import rl_rank_program

  rl_rank_program.main(Path(sys.argv[1]))
