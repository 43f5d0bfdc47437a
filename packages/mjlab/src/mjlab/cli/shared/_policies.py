"""Policies that a command line selects: those of runs, exported networks, zeros and random numbers."""

import contextlib
import itertools
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import mjlab_rl
import mjlab_viewer
from mjlab_core import UsageError
from mjlab_core.errors import UnknownNameError
from mjlab_rl import RslRlDistillationRunnerCfg, RunManifest, TaskCfg, find_checkpoint, load_run

from mjlab.cli.shared._command_line import TaskLine, built_env

Agent = Literal["trained", "zero", "random"]
"""Source of actions: a trained policy, zeros, or random numbers."""


@dataclass(kw_only=True)
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


@dataclass(frozen=True, kw_only=True)
class FoundPolicy:
  """Policy that a command line selects."""

  agent: Agent
  source: Path | None
  """Checkpoint, bundle or exported network; None for zero and random actions."""
  parts: "TaskCfg[Any] | RunManifest"
  """Run of the policy; the task itself if the policy has no manifest of the task."""

  def __str__(self) -> str:
    return f"{self.agent} actions" if self.source is None else str(self.source)

  @contextlib.contextmanager
  def acting(self, cfg: Any, device: str) -> "Generator[tuple[Any, mjlab_rl.Policy]]":
    """Build an environment and the policy that acts in it, and close the environment at the end.

    Raises:
      MjlabError: The configuration cannot be built, or the file of the policy cannot be read or does not fit.
    """
    agent = self.parts.agent
    if isinstance(agent, RslRlDistillationRunnerCfg) and hasattr(cfg, "observations"):
      # Without the groups that only a teacher reads.
      unseen = set(itertools.chain(*agent.obs_groups.values())).difference(agent.obs_groups["student"])
      cfg.observations = {name: group for name, group in cfg.observations.items() if name not in unseen}
    with built_env(self.parts, cfg, device) as env:
      yield env, _policy(self, env)


def find_policy(wanted: PolicyArguments, line: TaskLine) -> FoundPolicy:
  """Return the policy that is wanted for a task.

  Raises:
    UsageError: The task has no run yet.
    UnknownNameError: There is no run or file of the given name.
  """
  if wanted.agent != "trained":
    return FoundPolicy(agent=wanted.agent, source=None, parts=line.task)
  from mjlab_rl.bundles.bundle_policy import is_bundle

  source = Path(wanted.checkpoint)
  if is_bundle(source):
    # Bundles stand beside the manifest of their run, or alone; their description is compared with the environment.
    run = manifest_of(source.parent, line.name, say=lambda text: None)
  else:
    try:
      log_root, experiment = Path(wanted.log_root), line.task.agent.experiment_name
      source = find_checkpoint(wanted.checkpoint, log_root=log_root, experiment=experiment, task=line.name)
    except UnknownNameError as error:
      if wanted.checkpoint != "latest":
        raise
      raise UsageError(f"{error}. Train one with `train {line.name}`, or use --agent random.") from error
    run = manifest_of(source, line.name)
  return FoundPolicy(agent="trained", source=source, parts=run or line.task)


def manifest_of(source: Path, task: str, say: Callable[[str], object] = print) -> "RunManifest | None":
  """Return the run of a policy; None, after a message, if there is no manifest or the run is of another task."""
  try:
    run = load_run(source)
  except FileNotFoundError:
    say(f"{source.parent} has no manifest: the configuration of {task} is used.")
    return None
  if run.task != task:
    say(f"{source} belongs to {run.task}: the configuration of {task} is used.")
    return None
  return run


def _policy(found: FoundPolicy, env: Any) -> "mjlab_rl.Policy":
  """Return the policy that acts in `env`."""
  source, parts = found.source, found.parts
  if source is None:
    kind = mjlab_viewer.ZeroPolicy if found.agent == "zero" else mjlab_viewer.RandomPolicy
    return kind(env.num_envs, env.action_manager.total_action_dim, env.device)
  from mjlab_rl.bundles.bundle_policy import is_bundle

  if is_bundle(source):
    return mjlab_rl.BundlePolicy(source, env)
  if source.suffix == ".onnx":
    policy = mjlab_rl.OnnxPolicy(source, parts.agent, env)
    # Fails before a viewer opens if the network does not fit.
    policy(env.get_observations())
    policy.reset(None)
    return policy
  trained = mjlab_rl.CheckpointPolicy(env, parts.agent, parts.runner)
  trained.load(source)
  return trained
