"""Policies that a command line names: those of runs, exported ones, and none at all."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mjlab.cli._config_flags import replaced
from mjlab.cli._errors import UsageError

if TYPE_CHECKING:
  from mjlab_rl import Policy, RunManifest, TaskCfg

Agent = Literal["trained", "zero", "random"]
"""Who acts: a trained policy, nobody, or chance."""


def find_policy(wanted: Any, name: str, task: "TaskCfg[Any]") -> "tuple[Path | None, TaskCfg[Any] | RunManifest]":
  """The checkpoint or exported network that `wanted` means, and its run; None where none acts, the task where none is.

  Args:
    wanted: Arguments of a command, with `agent`, `checkpoint` and `log_root`.
    name: Name of the task.
    task: The task itself.

  Raises:
    UsageError: There is no run yet.
    RunNotFoundError: What was named is not there.
  """
  if wanted.agent != "trained":
    return None, task
  source = _source(wanted.checkpoint, Path(wanted.log_root), name, task.agent.experiment_name)
  return source, manifest_of(source, name) or task


def _source(checkpoint: str, log_root: Path, task: str, experiment: str) -> Path:
  from mjlab_rl import RunNotFoundError, find_checkpoint

  if checkpoint.endswith(".onnx"):
    if not Path(checkpoint).is_file():
      raise RunNotFoundError(f"policy {checkpoint}: no such file")
    return Path(checkpoint)
  try:
    return find_checkpoint(checkpoint, log_root=log_root, experiment=experiment, task=task)
  except FileNotFoundError as error:
    if checkpoint != "latest":
      raise
    raise UsageError(f"{error}. Train one with `train {task}`, or see what --agent random does.") from error


def manifest_of(source: Path, task: str, say: Callable[[str], object] = print) -> "RunManifest | None":
  """The run of `task` that a policy is of; None, and why, where there is no manifest or it is another task's."""
  from mjlab_rl import load_run

  try:
    run = load_run(source)
  except FileNotFoundError:
    say(f"{source.parent} has no manifest: the configuration of {task} is used.")
    return None
  if run.task != task:
    say(f"{source} is of {run.task}: the configuration of {task} is used.")
    return None
  return run


def without_teacher(env: Any, agent: Any) -> Any:
  """A configuration without the observation groups that only a teacher sees, who is asked nothing where others act."""
  from mjlab_rl import RslRlDistillationRunnerCfg

  groups = getattr(env, "observations", None)
  if not isinstance(agent, RslRlDistillationRunnerCfg) or groups is None:
    return env
  unseen = set(agent.obs_groups["teacher"]) - set(agent.obs_groups["student"])
  return replaced(env, ("observations",), {name: group for name, group in groups.items() if name not in unseen})


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
