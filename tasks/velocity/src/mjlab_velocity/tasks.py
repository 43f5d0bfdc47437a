"""Velocity tasks that each robot of the family has."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_rl import RslRlBaseRunnerCfg, TaskCfg
from mjlab_rl.offpolicy import fastsac

from mjlab_velocity.evaluation import VelocityEvaluation
from mjlab_velocity.legged import agent, play_flat
from mjlab_velocity.rough import play_rough
from mjlab_velocity.sim_to_real import blind

Task = TaskCfg[ManagerBasedRlEnvCfg]


@dataclass(frozen=True, kw_only=True)
class RobotTasks:
  """Velocity tasks of one robot; each call of a method returns a new one."""

  experiment_name: str
  max_iterations: int
  flat_env: Callable[[], ManagerBasedRlEnvCfg]
  """Function that returns the training environment on a plane."""
  rough_env: Callable[[], ManagerBasedRlEnvCfg]
  """Function that returns the training environment on rough ground."""
  symmetry: Callable[..., Any] | None = None
  """Mirror of the robot for FastSAC; None: the task has no setting of FastSAC."""

  def flat(self) -> Task:
    """Return the task of following velocity commands on a plane."""
    return self._task(self.flat_env(), play_flat)

  def rough(self) -> Task:
    """Return the task of following velocity commands over stairs, slopes and rough ground."""
    return self._task(self.rough_env(), play_rough)

  def flat_blind(self) -> Task:
    """Return the flat task for a robot that has only encoders and an IMU: `blind`."""
    return blind(self.flat())

  def rough_blind(self) -> Task:
    """Return the rough task for a robot that has only encoders and an IMU: `blind`."""
    return blind(self.rough())

  def _task(self, env: ManagerBasedRlEnvCfg, play: Callable[[ManagerBasedRlEnvCfg], ManagerBasedRlEnvCfg]) -> Task:
    ppo = agent(self.experiment_name, self.max_iterations)
    agents: dict[str, RslRlBaseRunnerCfg] = {}
    if self.symmetry is not None:
      agents["fastsac"] = mirrored = fastsac(ppo)
      # With their mirror images 8192.
      mirrored.algorithm.symmetry, mirrored.algorithm.batch_size = self.symmetry, 4096
      # With one reward, most seeds learn to stand on flat ground and stay there (docs/benchmarks/learners_cuda.md).
      mirrored.algorithm.n_step = 3
    return TaskCfg(env=env, play=play, agent=ppo, agents=agents, evaluator=VelocityEvaluation())
