"""Learner configuration: plain dataclass instances that become rsl-rl's dictionaries."""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, Literal, get_args

from mjlab_core import unknown

Activation = Literal[
  "elu", "selu", "relu", "crelu", "lrelu", "tanh", "sigmoid", "softplus", "gelu", "swish", "mish", "identity"
]


class ConfigError(ValueError):
  """A learner configuration that cannot work; the message names the field."""


@dataclass(kw_only=True)
class RslRlModelCfg:
  """One network: the actor or the critic."""

  hidden_dims: tuple[int, ...] = (128, 128, 128)
  """Widths of the hidden layers."""
  activation: Activation = "elu"
  """Activation function by rsl-rl's name."""
  obs_normalization: bool = False
  """Normalise observations by their running mean and deviation, shared by all worlds."""
  distribution_cfg: dict[str, Any] | None = None
  """Action distribution, e.g. {"class_name": "GaussianDistribution", "init_std": 1.0}; None: deterministic output."""
  cnn_cfg: dict[str, Any] | None = None
  """Convolution settings of image groups; None: no image groups."""
  rnn_type: Literal["lstm", "gru"] | None = None
  """Recurrent layer in front of the network; None: none. Needs class_name "RNNModel"."""
  rnn_hidden_dim: int = 256
  """Width of the recurrent layer."""
  rnn_num_layers: int = 1
  """Number of recurrent layers."""
  class_name: str = "MLPModel"
  """rsl-rl's "MLPModel", "CNNModel" or "RNNModel", or "module:Class"."""

  def to_rsl_rl(self) -> dict[str, Any]:
    """Arguments of the model class, without the optional parts that are off."""
    model: dict[str, Any] = {
      "class_name": self.class_name,
      "hidden_dims": list(self.hidden_dims),
      "activation": self.activation,
      "obs_normalization": self.obs_normalization,
    }
    if self.distribution_cfg is not None:
      model["distribution_cfg"] = dict(self.distribution_cfg)
    if self.cnn_cfg is not None:
      model["cnn_cfg"] = dict(self.cnn_cfg)
    if self.rnn_type is not None:
      model |= {
        "rnn_type": self.rnn_type,
        "rnn_hidden_dim": self.rnn_hidden_dim,
        "rnn_num_layers": self.rnn_num_layers,
      }
    return model


@dataclass(kw_only=True)
class RslRlPpoAlgorithmCfg:
  """Proximal policy optimisation (Schulman et al. 2017, arXiv:1707.06347) as rsl-rl implements it."""

  num_learning_epochs: int = 5
  """Passes over the data of one iteration."""
  num_mini_batches: int = 4
  """Mini-batches per pass."""
  learning_rate: float = 1e-3
  """Step size at the start."""
  schedule: Literal["adaptive", "fixed"] = "adaptive"
  """adaptive: the step size follows the measured KL divergence, within [1e-5, 1e-2]."""
  desired_kl: float = 0.01
  """KL divergence per mini-batch that the adaptive schedule aims at."""
  gamma: float = 0.99
  """Discount per environment step."""
  lam: float = 0.95
  """Lambda of the generalised advantage estimate."""
  entropy_coef: float = 0.005
  """Weight of the entropy bonus."""
  value_loss_coef: float = 1.0
  """Weight of the value loss."""
  use_clipped_value_loss: bool = True
  """Clip the change of the value estimate as well."""
  clip_param: float = 0.2
  """Clip range of the probability ratio."""
  max_grad_norm: float = 1.0
  """Gradient norm limit, for actor and critic separately."""
  normalize_advantage_per_mini_batch: bool = False
  """Normalise advantages in each mini-batch instead of over the whole batch."""
  optimizer: Literal["adam", "adamw", "sgd", "rmsprop"] = "adam"
  """Optimiser over actor and critic together."""
  share_cnn_encoders: bool = False
  """Let the critic use the actor's image encoders."""
  use_mixed_precision: bool = False
  """Compute the loss in bfloat16 where that is safe."""
  rnd_cfg: dict[str, Any] | None = None
  """Random network distillation (curiosity reward), rsl-rl's settings; None: off."""
  symmetry_cfg: dict[str, Any] | None = None
  """Symmetry augmentation, rsl-rl's settings; None: off."""
  class_name: str = "PPO"
  """rsl-rl's "PPO", or "module:Class"."""

  def to_rsl_rl(self) -> dict[str, Any]:
    """Arguments of the algorithm class, without the optional parts that are off."""
    algorithm = dict(vars(self))
    for name in ("rnd_cfg", "symmetry_cfg"):
      if algorithm[name] is None:
        del algorithm[name]
    return algorithm


def _gaussian_actor() -> RslRlModelCfg:
  return RslRlModelCfg(distribution_cfg={"class_name": "GaussianDistribution", "init_std": 1.0, "std_type": "scalar"})


@dataclass(kw_only=True)
class RslRlOnPolicyRunnerCfg:
  """One training run: networks, algorithm, length, logging."""

  seed: int = 42
  """Seed of the learner, and of the environment where that has none of its own."""
  num_steps_per_env: int = 24
  """Environment steps per world and iteration."""
  max_iterations: int = 300
  """Iterations in all; a resumed run continues up to this number."""
  save_interval: int = 50
  """Iterations between checkpoints."""
  experiment_name: str = "exp1"
  """Folder of the runs of one experiment, below the log root."""
  run_name: str = ""
  """Appended to the name of the run directory."""
  obs_groups: dict[str, tuple[str, ...]] = field(default_factory=lambda: {"actor": ("actor",), "critic": ("critic",)})
  """Observation groups that each network sees."""
  actor: RslRlModelCfg = field(default_factory=_gaussian_actor)
  """The policy."""
  critic: RslRlModelCfg = field(default_factory=RslRlModelCfg)
  """The value estimate."""
  algorithm: RslRlPpoAlgorithmCfg = field(default_factory=RslRlPpoAlgorithmCfg)
  """The update rule."""
  clip_actions: float | None = None
  """Limit of the absolute value of every action; None: no limit."""
  logger: Literal["tensorboard", "wandb", "none"] = "tensorboard"
  """Where scalars go besides progress.csv; wandb also writes tensorboard files."""
  wandb_project: str = "mjlab"
  """Weights & Biases project."""
  wandb_tags: tuple[str, ...] = ()
  """Weights & Biases tags."""
  upload_model: bool = True
  """Upload checkpoints to Weights & Biases."""
  torch_compile_mode: str | None = None
  """Mode of torch.compile for actor and critic; None: not compiled."""
  matmul_precision: Literal["highest", "high", "medium"] = "high"
  """float32 matrix products of the update on a GPU; high: TF32. The environment always computes in full precision."""

  def to_rsl_rl(self) -> dict[str, Any]:
    """rsl-rl's configuration dictionary; a fresh one, rsl-rl writes into it.

    Raises:
      ConfigError: A number is out of its range, a name is no name, the actor has no action distribution, or the logger
        is not installed.
    """
    for name in ("num_steps_per_env", "max_iterations", "save_interval"):
      _check(f"agent.{name}", getattr(self, name), "at least 1", lambda x: x >= 1)
    for name in ("num_learning_epochs", "num_mini_batches"):
      _check(f"agent.algorithm.{name}", getattr(self.algorithm, name), "at least 1", lambda x: x >= 1)
    for name in ("learning_rate", "desired_kl", "clip_param", "max_grad_norm"):
      _check(f"agent.algorithm.{name}", getattr(self.algorithm, name), "positive", lambda x: x > 0)
    for name in ("gamma", "lam"):
      _check(f"agent.algorithm.{name}", getattr(self.algorithm, name), "between 0 and 1", lambda x: 0 <= x <= 1)
    for network, model in (("actor", self.actor), ("critic", self.critic)):
      for width in model.hidden_dims:
        _check(f"agent.{network}.hidden_dims", width, "at least 1", lambda x: x >= 1)
      if model.activation not in get_args(Activation):
        raise ConfigError(unknown("activation", model.activation, get_args(Activation), f"agent.{network}.activation"))
    if self.logger == "wandb" and find_spec("wandb") is None:
      raise ConfigError("agent.logger is 'wandb', which is not installed: pip install wandb")
    for key, name in (("experiment_name", self.experiment_name), ("run_name", self.run_name)):
      if "/" in name or name == "..":
        raise ConfigError(f"agent.{key} is {name!r}; it is the name of one folder, or part of one, and takes no path")
    if self.actor.distribution_cfg is None:
      raise ConfigError(
        "agent.actor.distribution_cfg is None, but PPO samples its actions. "
        'Give one, e.g. {"class_name": "GaussianDistribution", "init_std": 1.0}.'
      )
    return {
      "num_steps_per_env": self.num_steps_per_env,
      "save_interval": self.save_interval,
      "obs_groups": {name: list(groups) for name, groups in self.obs_groups.items()},
      "actor": self.actor.to_rsl_rl(),
      "critic": self.critic.to_rsl_rl(),
      "algorithm": self.algorithm.to_rsl_rl(),
      "run_name": self.run_name,
      "torch_compile_mode": self.torch_compile_mode,
      # The environment finds and resets broken worlds itself; rsl-rl's check would stop the GPU three times a step.
      "check_for_nan": False,
    }


def _check(name: str, value: float, wanted: str, holds: Callable[[float], bool]) -> None:
  if not holds(value):
    raise ConfigError(f"{name} is {value}; it must be {wanted}")
