"""Policies of checkpoints, for any number of worlds."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict

from mjlab_rl.config import RslRlBaseRunnerCfg
from mjlab_rl.env_protocol import RlEnv
from mjlab_rl.onpolicy.distillation import runner_class
from mjlab_rl.reports.console import Console
from mjlab_rl.runner import MjlabOnPolicyRunner
from mjlab_rl.vec_env import RslRlVecEnvWrapper


class CheckpointPolicy:
  """Mean action of the policy in a checkpoint, of reinforcement learning or distillation.

  Args:
    env: Environment to act in; reset on construction.
    agent: Configuration of its learner.
    runner: Runner class of the task; None: the standard one of the learner.
  """

  def __init__(self, env: RlEnv, agent: RslRlBaseRunnerCfg, runner: type[MjlabOnPolicyRunner] | None = None) -> None:
    wrapped = RslRlVecEnvWrapper(env, clip_actions=agent.clip_actions)
    device = str(env.device)
    kind = runner or runner_class(agent)
    self._runner = kind(wrapped, agent.for_inference(), None, device, console=Console("quiet"))
    self._policy = self._runner.get_inference_policy(device)
    self._clip = agent.clip_actions
    self._num_envs = env.num_envs

  @property
  def network(self) -> Any:
    """The policy's network, a model of rsl-rl."""
    return self._runner.networks[self._runner.agent_cfg.policy]

  def load(self, path: Path) -> None:
    """Take the weights of a checkpoint and clear the hidden state.

    Raises:
      FileError: It cannot be read or does not fit; nothing has been changed then.
    """
    self._runner.load_policy(path)
    self.reset(None)

  def __call__(self, observations: Mapping[str, Any]) -> torch.Tensor:
    """Return actions (num_envs, num_actions) for observations by group."""
    actions = self._policy(TensorDict(dict(observations), batch_size=[self._num_envs]))
    return actions if self._clip is None else actions.clamp(-self._clip, self._clip)

  def reset(self, dones: torch.Tensor | None) -> None:
    """Clear the hidden state of these worlds, bool (num_envs,); None: of all."""
    self._policy.reset(dones)
