"""Policies that a command line selects: those of runs, exported networks, zeros and random numbers."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mjlab_core import UsageError

if TYPE_CHECKING:
  from mjlab_rl import Policy, RunManifest, TaskCfg

Agent = Literal["trained", "zero", "random"]
"""Source of actions: a trained policy, zeros, or random numbers."""


@dataclasses.dataclass(kw_only=True)
class PolicyArguments:
  """Flags of commands with a policy."""

  checkpoint: str = "latest"
  """Policy: latest (the newest run of this task), the name or directory of a run, a checkpoint, a bundle, or an
  exported policy (.onnx)."""
  agent: Agent = "trained"
  """Source of actions: a trained policy, zeros, or random numbers."""
  device: str = "auto"
  """Device of the simulation: cpu, cuda:0, or auto for a GPU if there is one."""
  log_root: str = "logs"
  """Folder of all runs."""


def find_policy(
  wanted: PolicyArguments, name: str, task: "TaskCfg[Any]"
) -> "tuple[Path | None, TaskCfg[Any] | RunManifest]":
  """Return the checkpoint, bundle or exported network that is wanted, and its run.

  The path is None for zero and random actions; the run is the task itself if the policy has no manifest of the task.

  Args:
    wanted: Arguments of a command.
    name: Name of the task.
    task: The task itself.

  Raises:
    UsageError: The task has no run yet.
    UnknownNameError: What was named is not there.
  """
  if wanted.agent != "trained":
    return None, task
  from mjlab_rl.bundle_policy import is_bundle

  source = _source(wanted.checkpoint, Path(wanted.log_root), name, task.agent.experiment_name)
  if is_bundle(source):
    # Bundles stand beside the manifest of their run, or alone; their description is compared with the environment.
    return source, manifest_of(source.parent, name, say=lambda line: None) or task
  return source, manifest_of(source, name) or task


def _source(checkpoint: str, log_root: Path, task: str, experiment: str) -> Path:
  from mjlab_core.errors import UnknownNameError
  from mjlab_rl import find_checkpoint
  from mjlab_rl.bundle_policy import is_bundle

  if is_bundle(Path(checkpoint)):
    return Path(checkpoint)
  try:
    return find_checkpoint(checkpoint, log_root=log_root, experiment=experiment, task=task)
  except UnknownNameError as error:
    if checkpoint != "latest":
      raise
    raise UsageError(f"{error}. Train one with `train {task}`, or use --agent random.") from error


def manifest_of(source: Path, task: str, say: Callable[[str], object] = print) -> "RunManifest | None":
  """Return the run of a policy; None, after a message, if there is no manifest or the run is of another task."""
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
  """Return a configuration without the observation groups that only a teacher reads."""
  from mjlab_rl import RslRlDistillationRunnerCfg

  from mjlab.cli._flags import replaced

  groups = getattr(env, "observations", None)
  if not isinstance(agent, RslRlDistillationRunnerCfg) or groups is None:
    return env
  unseen = {group for seen in agent.obs_groups.values() for group in seen} - set(agent.obs_groups["student"])
  return replaced(env, ("observations",), {name: group for name, group in groups.items() if name not in unseen})


def make_policy(agent: Agent, source: Path | None, env: Any, parts: Any) -> "Policy":
  """Return the policy that acts in `env`; a trained one needs the learner of `parts`, a task or a run.

  Raises:
    MjlabError: The file cannot be read or does not fit.
  """
  if source is None:
    from mjlab_viewer import RandomPolicy, ZeroPolicy

    return (ZeroPolicy if agent == "zero" else RandomPolicy)(
      env.num_envs, env.action_manager.total_action_dim, env.device
    )
  from mjlab_rl.bundle_policy import is_bundle

  if is_bundle(source):
    from mjlab_rl import BundlePolicy

    return BundlePolicy(source, env)
  if source.suffix == ".onnx":
    from mjlab_rl import OnnxPolicy

    policy = OnnxPolicy(source, parts.agent, env)
    # Fails before a viewer opens if the network does not fit.
    policy(env.get_observations())
    policy.reset(None)
    return policy
  from mjlab_rl import CheckpointPolicy

  trained = CheckpointPolicy(env, parts.agent, parts.runner)
  trained.load(source)
  return trained
