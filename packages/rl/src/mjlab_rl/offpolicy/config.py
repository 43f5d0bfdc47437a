"""Configuration of off-policy learners."""

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal, Self

from mjlab_core.constraints import Finite, Limits, NonNegative, Positive, PositiveCount, Share

from mjlab_rl.config import LearnerPart, RslRlBaseRunnerCfg, RslRlModelCfg
from mjlab_rl.models.network_entries import Activation


@dataclass(kw_only=True)
class OffPolicyModelCfg(RslRlModelCfg):
  """Actor or critic of an off-policy learner; images and recurrent layers are not supported."""

  hidden_dims: Annotated[tuple[int, ...], Limits(ge=1)] = (512, 256, 128)
  """Widths of the hidden layers; with unit layers the width of each block, the same for all."""
  activation: Activation = "swish"
  """Activation function by rsl-rl's name."""
  layers: Literal["layer_norm", "unit"] = "layer_norm"
  """layer_norm: LayerNorm after each layer (FastSAC); unit: batch-normalised residual blocks with weights of unit norm
  (FlashSAC)."""
  class_name: str = "mjlab_rl.offpolicy.networks:Actor"
  """Class of the network, "module:Class"."""

  def problems(self, where: str) -> Iterator[str]:
    yield from super().problems(where)
    if self.cnn_cfg is not None or self.rnn_type is not None:
      yield f"{where}.cnn_cfg and {where}.rnn_type must be None: off-policy learners take vectors only"
    if self.layers == "unit" and len(set(self.hidden_dims)) > 1:
      yield f"{where}.hidden_dims is {self.hidden_dims}; unit layers all have the same width"


@dataclass(kw_only=True)
class SacCfg(LearnerPart):
  """Soft actor-critic (Haarnoja et al. 2018, arXiv:1812.05905) for thousands of worlds.

  The defaults are the settings of FastSAC (Seo et al. 2025, arXiv:2512.01996).
  """

  batch_size: PositiveCount = 8192
  """Transitions of an update, mirrored copies not counted."""
  updates_per_step: Positive = 8.0
  """Updates of the critic for each step of all worlds; it may be below 1."""
  policy_every: PositiveCount = 4
  """Updates of the critic for each update of the policy."""
  learning_starts: PositiveCount = 10
  """Steps of all worlds before the first update."""
  replay_steps: Annotated[int, Limits(ge=8)] = 1024
  """Steps of each world that the replay memory keeps."""
  replay_half: bool = False
  """Keep observations and actions as float16."""
  n_step: PositiveCount = 1
  """Most rewards summed before the value of the critic."""
  gamma: Share = 0.97
  """Discount per environment step."""
  tau: Share = 0.125
  """Share of the critic that goes into its slow copy after each update."""
  learning_rate: Positive = 3e-4
  """Step size at the start."""
  final_learning_rate: Positive | None = None
  """Step size at the last iteration, reached along a cosine (FlashSAC); None: the same throughout."""
  betas: tuple[Share, Share] = (0.9, 0.95)
  """Decay of the moments of AdamW."""
  weight_decay: NonNegative = 1e-3
  """Weight decay of AdamW for both networks."""
  num_atoms: Annotated[int, Limits(ge=2)] = 101
  """Values of the critic's distribution (C51, arXiv:1707.06887)."""
  value_limit: Positive = 20.0
  """The values reach from -value_limit to value_limit."""
  combine: Literal["mean", "min"] = "mean"
  """Value of two critics: their mean (FastSAC), or the smaller one (TD3, arXiv:1802.09477; FlashSAC)."""
  return_scaling: bool = False
  """Divide rewards so that returns fill the values of the critic (SimbaV2, arXiv:2502.15280; FlashSAC)."""
  temperature: Positive = 1e-3
  """Weight of the entropy at the start; it is learned."""
  target_entropy: Finite = 0.0
  """Entropy of one action that the temperature aims at [nat]."""
  temperature_with: Literal["critic", "policy"] = "critic"
  """Update of the temperature: with each update of the critic (FastSAC) or of the policy (FlashSAC)."""
  noise_repetition: PositiveCount = 1
  """Most steps that noise stays the same (FlashSAC: 16); 1: new in each step."""
  joint_limits: bool = True
  """Bound joint position actions so that the targets reach the farther limit of their joint (FastSAC)."""
  action_bound: Positive = 1.0
  """Largest absolute value of all other actions."""
  symmetry: Callable[..., Any] | None = None
  """Mirror of the robot: symmetry(env) returns a `Mirror` of mjlab_rl.offpolicy.replay for each observation group, and
  for "action"; a batch then gets a mirrored copy of each transition (FastSAC). None: no mirror."""
  bf16: bool = True
  """Compute the networks of an update in bfloat16 on a GPU."""
  capture: bool = True
  """Record the updates between two updates of the policy as one CUDA graph; False: run them eagerly."""
  class_name: str = "mjlab_rl.offpolicy.sac:Sac"
  """Class of the algorithm, "module:Class"."""

  def to_rsl_rl(self) -> dict[str, Any]:
    return {"class_name": self.class_name, "cfg": copy.deepcopy(self), "schedule": "own"}


def bounded_gaussian(log_std_range: tuple[float, float]) -> dict[str, Any]:
  """Return the `distribution_cfg` of a policy, with the range of the logarithm of the deviation before tanh."""
  return {"class_name": "mjlab_rl.offpolicy.networks:TanhGaussian", "log_std_range": log_std_range}


@dataclass(kw_only=True)
class OffPolicyRunnerCfg(RslRlBaseRunnerCfg):
  """Runner config for off-policy learning: networks and algorithm."""

  policy: ClassVar[str] = "actor"

  obs_groups: dict[str, tuple[str, ...]] = field(default_factory=lambda: {"actor": ("actor",), "critic": ("critic",)})
  """Observation groups that each network sees."""
  actor: OffPolicyModelCfg = field(
    default_factory=lambda: OffPolicyModelCfg(obs_normalization=True, distribution_cfg=bounded_gaussian((-5.0, 0.0)))
  )
  """The policy."""
  critic: OffPolicyModelCfg = field(
    default_factory=lambda: OffPolicyModelCfg(
      hidden_dims=(768, 384, 192), obs_normalization=True, class_name="mjlab_rl.offpolicy.networks:Critic"
    )
  )
  """The estimate of returns."""
  algorithm: SacCfg = field(default_factory=SacCfg)
  """The update rule."""
  save_replay: bool = True
  """Save the replay memory beside the newest checkpoint, which an exact resume needs; without it a resumed run fills a
  new one first."""

  def problems(self) -> Iterator[str]:
    yield from super().problems()
    if self.clip_actions is not None:
      yield "agent.clip_actions must be None: agent.algorithm.joint_limits and action_bound limit actions"
    if self.torch_compile_mode is not None:
      yield "agent.torch_compile_mode must be None: a GPU records the updates as a graph"
    algorithm = self.algorithm
    if algorithm.replay_steps < algorithm.n_step + 3:
      yield f"agent.algorithm.replay_steps must be n_step + 3 = {algorithm.n_step + 3} or more"

  def prepare_env(self, cfg: Any) -> None:
    """Ask an environment configuration for the last observations of episodes."""
    cfg.capture_terminal_observations = True

  def for_inference(self) -> Self:
    agent = super().for_inference()
    agent.algorithm = replace(agent.algorithm, replay_steps=agent.algorithm.n_step + 8, symmetry=None)
    return agent
