"""Policies of checkpoints whose network is an rsl-rl MLP, run with torch alone."""

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from mjlab_rl import checkpoint
from mjlab_rl.config import RslRlBaseRunnerCfg, RslRlDistillationRunnerCfg, RslRlModelCfg, RslRlOnPolicyRunnerCfg
from mjlab_rl.env_protocol import RlEnv

_ACTIVATIONS: dict[str, type[nn.Module]] = {
  "elu": nn.ELU,
  "selu": nn.SELU,
  "relu": nn.ReLU,
  "crelu": nn.CELU,
  "lrelu": nn.LeakyReLU,
  "tanh": nn.Tanh,
  "sigmoid": nn.Sigmoid,
  "softplus": nn.Softplus,
  "gelu": nn.GELU,
  "swish": nn.SiLU,
  "mish": nn.Mish,
  "identity": nn.Identity,
}
"""Activation functions by rsl-rl's names."""

_EPSILON = 1e-2
"""Term that rsl-rl adds to the standard deviation of observations."""


class MlpPolicy:
  """Mean action of the policy in a checkpoint, bit for bit that of `CheckpointPolicy`, for plain MLPs only.

  `play` and `demo` use it where they can: importing rsl-rl and tensordict takes as long as all other imports together.

  Args:
    env: Environment to act in; reset on construction.
    agent: Configuration of its learner, for which `suits` is true.
  """

  def __init__(self, env: RlEnv, agent: RslRlBaseRunnerCfg) -> None:
    self._name: str = agent.policy
    self._groups = agent.obs_groups[agent.policy]
    self._clip = agent.clip_actions
    env.reset()
    seen = env.get_observations()
    self._shapes = [list(seen[group].shape[1:]) for group in self._groups]
    width = sum(seen[group].shape[1] for group in self._groups)
    model: RslRlModelCfg = getattr(agent, agent.policy)
    self._network = _Mlp(model, width, env.action_manager.total_action_dim).to(env.device)

  @staticmethod
  def suits(env: RlEnv, agent: RslRlBaseRunnerCfg, runner: type[Any] | None = None) -> bool:
    """Return True if the policy of a learner is a plain MLP of vectors, with a standard runner and distribution."""
    if runner is not None or type(agent) not in (RslRlOnPolicyRunnerCfg, RslRlDistillationRunnerCfg):
      return False
    model: RslRlModelCfg = getattr(agent, agent.policy)
    distribution = (model.distribution_cfg or {}).get("class_name")
    is_plain = model.class_name == "MLPModel" and model.rnn_type is None and distribution == "GaussianDistribution"
    seen = env.get_observations()
    # Other mistakes are left to rsl-rl's runner, which names them.
    return (
      is_plain
      and not list(agent.problems())
      and all(group in seen and seen[group].dim() == 2 for group in agent.obs_groups.get(agent.policy, ()))
    )

  def load(self, path: Path) -> None:
    """Take the weights of a checkpoint.

    Raises:
      FileError: It cannot be read or does not fit; nothing has been changed then.
    """
    weights, shapes = checkpoint.read_policy(path, self._name)
    checkpoint.check_network(
      path, self._name, self._groups, (shapes, self._shapes), (weights, self._network.state_dict())
    )
    self._network.load_state_dict(weights)

  @torch.no_grad()
  def __call__(self, observations: Mapping[str, Any]) -> torch.Tensor:
    """Return actions (num_envs, num_actions) for observations by group."""
    actions = self._network(torch.cat([observations[group] for group in self._groups], dim=-1))
    return actions if self._clip is None else actions.clamp(-self._clip, self._clip)

  def reset(self, dones: torch.Tensor | None) -> None:
    """Do nothing: the network has no memory."""


class _Mlp(nn.Module):
  """Network with the names of weights of rsl-rl's MLPModel."""

  def __init__(self, model: RslRlModelCfg, width: int, num_actions: int) -> None:
    super().__init__()
    self.obs_normalizer = _Normalizer(width) if model.obs_normalization else nn.Identity()
    is_log = (model.distribution_cfg or {}).get("std_type") == "log"
    self.distribution = nn.Module()
    self.distribution.register_buffer("log_std_param" if is_log else "std_param", torch.ones(num_actions))
    layers: list[nn.Module] = []
    widths = (width, *model.hidden_dims)
    for before, after in itertools.pairwise(widths):
      layers += [nn.Linear(before, after), _ACTIVATIONS[model.activation]()]
    layers.append(nn.Linear(widths[-1], num_actions))
    self.mlp = nn.Sequential(*layers)

  def forward(self, observations: torch.Tensor) -> torch.Tensor:
    return self.mlp(self.obs_normalizer(observations))


class _Normalizer(nn.Module):
  """Observations with the mean and deviation of the training removed, as rsl-rl's EmpiricalNormalization."""

  def __init__(self, width: int) -> None:
    super().__init__()
    for name in ("_mean", "_var", "_std"):
      self.register_buffer(name, torch.ones(1, width))
    self.register_buffer("count", torch.tensor(0))

  def forward(self, observations: torch.Tensor) -> torch.Tensor:
    return (observations - self.get_buffer("_mean")) / (self.get_buffer("_std") + _EPSILON)
