"""The off-policy learner keeps the pole upright after a short training with few worlds on a CPU."""

import csv
from pathlib import Path
from typing import Any

import pytest
from mjlab_cartpole import balance
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import Console, train, with_agent


@pytest.mark.slow
def test_cartpole_is_balanced_by_fastsac(tmp_path: Path) -> None:
  task: Any = with_agent(balance(), "fastsac")
  task.env.scene.num_envs, task.env.episode_length_s = 32, 5.0
  task.agent.max_iterations, task.agent.logger, task.agent.seed = 10, "none", 42
  task.agent.algorithm.learning_rate = 3e-3
  run = train(
    task, name="Mjlab-Cartpole-Balance", make_env=ManagerBasedRlEnv, log_root=tmp_path, console=Console("quiet")
  )
  assert run.directory is not None
  with (run.directory / "progress.csv").open(newline="") as file:
    returns = [float(row["Train/mean_reward"] or "nan") for row in csv.DictReader(file)]
  # 100 steps of at most 0.05 each, over the last 100 episodes; without control about 1.7.
  assert max(returns[:5]) < 2.0
  assert returns[-1] > 3.0
