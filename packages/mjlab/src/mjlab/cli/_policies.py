"""Policies that a command line names: those of runs, exported ones, and none at all."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mjlab.cli._errors import UsageError

if TYPE_CHECKING:
  from mjlab_rl import Policy, RunManifest

Agent = Literal["trained", "zero", "random"]
"""Who acts: a trained policy, nobody, or chance."""


def find_policy(policy: str, *, log_root: str, task: str, experiment: str) -> Path:
  """The checkpoint or exported network that `policy` means for a task.

  Raises:
    UsageError: There is no run yet.
    RunNotFoundError: What was named is not there.
  """
  from mjlab_rl import find_checkpoint

  if policy.endswith(".onnx"):
    return Path(policy)
  try:
    return find_checkpoint(policy, log_root=Path(log_root), experiment=experiment, task=task)
  except FileNotFoundError as error:
    if policy != "latest":
      raise
    raise UsageError(f"{error}. Train one with `train {task}`, or see what --agent random does.") from error


def manifest_of(source: Path, task: str) -> "RunManifest | None":
  """The run that something is of; None where it does not say."""
  from mjlab_rl import load_run

  try:
    run = load_run(source)
  except FileNotFoundError:
    print(f"{source.parent} has no manifest: the configuration of {task} is used.")
    return None
  if run.task != task:
    print(f"{source} is of {run.task}: the configuration of {task} is used.")
    return None
  return run


def make_policy(agent: Agent, source: Path | None, env: Any, parts: Any) -> "Policy":
  """Who acts in `env`, a policy from a source with the learner of `parts`, a task or a run.

  Raises:
    CheckpointError: it cannot be read or does not fit.
  """
  if source is None:
    from mjlab_viewer import RandomPolicy, ZeroPolicy

    return (ZeroPolicy if agent == "zero" else RandomPolicy)(
      env.num_envs, env.action_manager.total_action_dim, env.device
    )
  from mjlab_rl import CheckpointPolicy, OnnxPolicy

  if source.suffix == ".onnx":
    policy = OnnxPolicy(source, parts.agent, env.num_envs)
    # What does not fit is said before anything opens.
    policy(env.get_observations())
    policy.reset(None)
    return policy
  trained = CheckpointPolicy(env, parts.agent, parts.runner)
  trained.load(source)
  return trained
