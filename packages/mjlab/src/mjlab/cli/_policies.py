"""Policies that a command line names: those of runs, and none at all."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mjlab.cli._config_flags import replaced

if TYPE_CHECKING:
  from mjlab_rl import Console, Policy, TaskCfg

Baseline = Literal["zero", "random"]


def find_run(run: str, *, log_root: str, name: str, task: "TaskCfg[Any]") -> Path:
  """The checkpoint that `run` means for a task; RunNotFoundError where there is none."""
  from mjlab_rl import find_checkpoint

  return find_checkpoint(run, log_root=Path(log_root), experiment=task.agent.experiment_name, task=name)


def as_trained(checkpoint: Path, name: str, task: "TaskCfg[Any]", console: "Console") -> "TaskCfg[Any]":
  """The task with environment and learner as the run had them."""
  from mjlab_rl import load_run

  try:
    trained = load_run(checkpoint)
  except FileNotFoundError:
    console.say(f"{checkpoint.parent} has no manifest: the configuration of the task is used.")
    return task
  if trained.task != name:
    console.say(f"the checkpoint is of {trained.task}: the configuration of {name} is used.")
    return task
  return dataclasses.replace(
    task, env=trained.env, agent=trained.agent, runner=trained.runner, make_env=trained.make_env
  )


def make_policy(
  task: "TaskCfg[Any]", env: Any, checkpoint: Path | None, baseline: Baseline | None, device: str
) -> tuple["Policy", str]:
  """The deterministic policy of a checkpoint, or a baseline, and what to call it."""
  import torch

  if checkpoint is None:
    shape = (env.num_envs, env.action_manager.total_action_dim)
    generator = torch.Generator(env.device).manual_seed(0)
    if baseline == "random":
      return (lambda _: torch.randn(shape, generator=generator, device=env.device)), "random actions"
    return (lambda _: torch.zeros(shape, device=env.device)), "no actions"
  from mjlab_rl import Console, MjlabOnPolicyRunner, RslRlVecEnvWrapper
  from tensordict import TensorDict

  # So few worlds may be too few for the batches of training.
  agent = replaced(task.agent, ("algorithm", "num_mini_batches"), 1)
  runner_class = task.runner or MjlabOnPolicyRunner
  runner = runner_class(
    RslRlVecEnvWrapper(env, clip_actions=agent.clip_actions), agent, None, device, console=Console("quiet")
  )
  runner.load(str(checkpoint), load_cfg={"actor": True})
  actor, limit = runner.get_inference_policy(device), agent.clip_actions

  class Actor:
    def __call__(self, observations: Any) -> torch.Tensor:
      actions = actor(TensorDict(dict(observations), batch_size=[env.num_envs]))
      return actions if limit is None else actions.clamp(-limit, limit)

    def reset(self, dones: torch.Tensor) -> None:
      actor.reset(dones)

  return Actor(), str(checkpoint)
