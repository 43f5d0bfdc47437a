"""Off-policy learners by name, in their published settings."""

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

from mjlab_core.constraints import require
from mjlab_core.names import check_name

from mjlab_rl.config import RslRlBaseRunnerCfg, RslRlOnPolicyRunnerCfg, TaskCfg
from mjlab_rl.offpolicy.config import OffPolicyModelCfg, OffPolicyRunnerCfg, SacCfg, bounded_gaussian

# Entropy of a Gaussian with standard deviation 0.15, FlashSAC's target for one action: log(0.15 sqrt(2 pi e)) [nat].
_ENTROPY = -0.47818


def fastsac(base: RslRlBaseRunnerCfg) -> OffPolicyRunnerCfg:
  """Return FastSAC (Seo et al. 2025, arXiv:2512.01996) in the settings of its authors' holosoma, for 4096 worlds.

  Its 50 000 steps of all worlds are iterations of 25 steps.

  Args:
    base: Learner of the task; its experiment, observation groups, seed and logs are kept.
  """
  return _like(base, "fastsac")


def flashsac(base: RslRlBaseRunnerCfg) -> OffPolicyRunnerCfg:
  """Return FlashSAC (arXiv:2604.04539) in its authors' settings for Isaac Lab.

  They train 1024 worlds with a replay memory of 10 million transitions, which 2441 steps of 4096 worlds are, and bound
  all actions by 1 (`joint_limits=False`); here joints have the bounds of FastSAC.

  Args:
    base: Learner of the task; its experiment, observation groups, seed and logs are kept.
  """
  agent = _like(base, "flashsac")
  agent.actor = OffPolicyModelCfg(
    hidden_dims=(128, 128), activation="relu", layers="unit", distribution_cfg=bounded_gaussian((-10.0, 2.0))
  )
  agent.critic = OffPolicyModelCfg(
    hidden_dims=(256, 256), activation="relu", layers="unit", class_name="mjlab_rl.offpolicy.networks:Critic"
  )
  agent.algorithm = SacCfg(
    batch_size=2048,
    updates_per_step=2.0,
    policy_every=2,
    learning_starts=98,
    replay_steps=2441,
    n_step=3,
    gamma=0.99,
    tau=0.01,
    final_learning_rate=1.5e-4,
    betas=(0.9, 0.999),
    weight_decay=0.0,
    value_limit=5.0,
    combine="min",
    return_scaling=True,
    temperature=0.01,
    target_entropy=_ENTROPY,
    temperature_with="policy",
    noise_repetition=16,
  )
  return agent


PRESETS: dict[str, Callable[[RslRlBaseRunnerCfg], OffPolicyRunnerCfg]] = {"fastsac": fastsac, "flashsac": flashsac}
"""Learners by name, as functions of a task's own learner."""


def with_agent(task: TaskCfg[Any], name: str) -> TaskCfg[Any]:
  """Return a task with another learner: "ppo", its own; one of `task.agents`; or a preset.

  Raises:
    UnknownNameError: There is no such learner.
    ConfigError: The task is not one of reinforcement learning.
  """
  fixed = f"learner '{name}': the task has a {type(task.agent).__name__}, which no other learner replaces"
  agent = require(task.agent, RslRlOnPolicyRunnerCfg, fixed)
  if name == "ppo":
    return task
  if name in task.agents:
    return dataclasses.replace(task, agent=task.agents[name])
  check_name("learner", name, ["ppo", *dict.fromkeys((*PRESETS, *task.agents))])
  return dataclasses.replace(task, agent=PRESETS[name](agent))


def _like(base: RslRlBaseRunnerCfg, name: str) -> OffPolicyRunnerCfg:
  kept = ("seed", "experiment_name", "logger", "wandb_project", "wandb_tags", "upload_model")
  if set(base.obs_groups) == {"actor", "critic"}:
    kept += ("obs_groups",)
  agent = OffPolicyRunnerCfg(
    num_steps_per_env=25, max_iterations=2000, save_interval=200, save_replay=False, run_name=name
  )
  return dataclasses.replace(agent, **{field: copy.copy(getattr(base, field)) for field in kept})
