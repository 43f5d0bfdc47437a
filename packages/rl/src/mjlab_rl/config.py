"""Learner configuration: plain dataclass instances that become rsl-rl's dictionaries."""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from typing import Any, ClassVar, Literal, Self, get_args

from mjlab_core import unknown

Activation = Literal[
  "elu", "selu", "relu", "crelu", "lrelu", "tanh", "sigmoid", "softplus", "gelu", "swish", "mish", "identity"
]


class ConfigError(ValueError):
  """A learner configuration that cannot work; the message names the field."""


@dataclass(kw_only=True)
class RslRlModelCfg:
  """One network: an actor, a critic, a student or a teacher."""

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
  """Recurrent layer between what is seen and the hidden layers; None: none."""
  rnn_hidden_dim: int = 256
  """Width of the recurrent layer."""
  rnn_num_layers: int = 1
  """Number of recurrent layers."""
  class_name: str = "MLPModel"
  """rsl-rl's "MLPModel" or, for images, "CNNModel", with or without `rnn_type`, or "module:Class"."""

  def to_rsl_rl(self) -> dict[str, Any]:
    """Arguments of the model class, without the optional parts that are off."""
    names = {"CNNModel": "mjlab_rl.image_model:ImageModel"}
    if self.rnn_type is not None:
      names["MLPModel"] = "RNNModel"
    model: dict[str, Any] = {
      "class_name": names.get(self.class_name, self.class_name),
      "hidden_dims": list(self.hidden_dims),
      "activation": self.activation,
      "obs_normalization": self.obs_normalization,
    }
    if self.distribution_cfg is not None:
      model["distribution_cfg"] = dict(self.distribution_cfg)
      if self.distribution_cfg.get("class_name") == "GaussianDistribution":
        model["distribution_cfg"]["class_name"] = "mjlab_rl.gaussian:Gaussian"
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


@dataclass(kw_only=True)
class RslRlDistillationAlgorithmCfg:
  """The student acts, the teacher says what it would have done, and the student learns to do that (DAgger, Ross et al.
  2011, arXiv:1011.0686), as rsl-rl implements it."""

  num_learning_epochs: int = 1
  """Passes over the data of one iteration."""
  gradient_length: int = 8
  """Steps whose errors add up to one gradient, and through which a recurrent student learns; divides
  num_learning_epochs x num_steps_per_env."""
  learning_rate: float = 1e-3
  """Step size."""
  max_grad_norm: float | None = 1.0
  """Gradient norm limit; None: none."""
  loss_type: Literal["mse", "huber"] = "mse"
  """Measure of the difference between the student's mean action and the teacher's."""
  optimizer: Literal["adam", "adamw", "sgd", "rmsprop"] = "adam"
  """Optimiser of the student."""
  use_mixed_precision: bool = False
  """Compute the loss in bfloat16 where that is safe."""
  class_name: str = "Distillation"
  """rsl-rl's "Distillation", or "module:Class"."""


def _gaussian(init_std: float) -> dict[str, Any]:
  return {"class_name": "GaussianDistribution", "init_std": init_std, "std_type": "scalar"}


@dataclass(kw_only=True)
class RslRlBaseRunnerCfg:
  """What every training run has: length, seed, logging. One that learns is of a subclass."""

  policy: ClassVar[str]
  """Name of the network that acts, in `obs_groups`, in checkpoints and among the fields."""

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
  obs_groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
  """Observation groups that each network sees."""
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
  torch_compile_mode: Literal["default", "reduce-overhead", "max-autotune", "max-autotune-no-cudagraphs"] | None = None
  """Mode of torch.compile for the networks; None: not compiled."""
  matmul_precision: Literal["highest", "high", "medium"] = "high"
  """float32 matrix products of the update on a GPU; high: TF32. The environment always computes in full precision."""

  def to_rsl_rl(self) -> dict[str, Any]:
    """rsl-rl's configuration dictionary; a fresh one, rsl-rl writes into it.

    Raises:
      ConfigError: A number is out of its range, a name is no name, the policy has no action distribution, or the logger
        is not installed.
    """
    for name in ("num_steps_per_env", "max_iterations", "save_interval"):
      _check(f"agent.{name}", getattr(self, name), "at least 1", lambda x: x >= 1)
    if self.clip_actions is not None:
      _check("agent.clip_actions", self.clip_actions, "positive", _is_positive)
    if self.logger == "wandb" and find_spec("wandb") is None:
      raise ConfigError("agent.logger is 'wandb', which is not installed: pip install wandb")
    for key, name in (("experiment_name", self.experiment_name), ("run_name", self.run_name)):
      if "/" in name or name in (".", "..") or (key == "experiment_name" and not name):
        raise ConfigError(f"agent.{key} is {name!r}; it is the name of one folder, or part of one, and takes no path")
    return {
      "num_steps_per_env": self.num_steps_per_env,
      "save_interval": self.save_interval,
      "obs_groups": {name: list(groups) for name, groups in self.obs_groups.items()},
      "run_name": self.run_name,
      "torch_compile_mode": self.torch_compile_mode,
      # The environment finds and resets broken worlds itself; rsl-rl's check would stop the GPU three times a step.
      "check_for_nan": False,
    }

  def check_samples(self, num_envs: int) -> None:
    """Whether so many worlds give an iteration enough to learn from.

    Raises:
      ConfigError: They do not.
    """

  def for_inference(self) -> Self:
    """A copy for acting alone, in however many worlds: its storage is as small as it can be.

    Other networks than the policy are asked nothing. They see what the policy sees, so that nothing else is needed.
    """
    agent = replace(copy.deepcopy(self), num_steps_per_env=1)
    agent.obs_groups = {name: agent.obs_groups.get(agent.policy, groups) for name, groups in agent.obs_groups.items()}
    return agent


@dataclass(kw_only=True)
class RslRlOnPolicyRunnerCfg(RslRlBaseRunnerCfg):
  """One training run by reinforcement: networks, algorithm, length, logging."""

  policy: ClassVar[str] = "actor"

  obs_groups: dict[str, tuple[str, ...]] = field(default_factory=lambda: {"actor": ("actor",), "critic": ("critic",)})
  """Observation groups that each network sees."""
  actor: RslRlModelCfg = field(default_factory=lambda: RslRlModelCfg(distribution_cfg=_gaussian(1.0)))
  """The policy."""
  critic: RslRlModelCfg = field(default_factory=RslRlModelCfg)
  """The value estimate."""
  algorithm: RslRlPpoAlgorithmCfg = field(default_factory=RslRlPpoAlgorithmCfg)
  """The update rule."""

  def to_rsl_rl(self) -> dict[str, Any]:
    config = super().to_rsl_rl()
    for name in ("num_learning_epochs", "num_mini_batches"):
      _check(f"agent.algorithm.{name}", getattr(self.algorithm, name), "at least 1", lambda x: x >= 1)
    for name in ("learning_rate", "desired_kl", "clip_param", "max_grad_norm"):
      _check(f"agent.algorithm.{name}", getattr(self.algorithm, name), "positive", _is_positive)
    for name in ("entropy_coef", "value_loss_coef"):
      _check(f"agent.algorithm.{name}", getattr(self.algorithm, name), "finite", math.isfinite)
    for name in ("gamma", "lam"):
      _check(f"agent.algorithm.{name}", getattr(self.algorithm, name), "between 0 and 1", lambda x: 0 <= x <= 1)
    _check_model("actor", self.actor)
    _check_model("critic", self.critic)
    _check_distribution("actor", self.actor, "PPO samples its actions")
    if self.algorithm.share_cnn_encoders and self.critic.class_name in _BLIND:
      raise ConfigError(
        f"agent.algorithm.share_cnn_encoders is on, but agent.critic.class_name {self.critic.class_name!r} sees nothing"
      )
    return config | {
      "actor": self.actor.to_rsl_rl(),
      "critic": self.critic.to_rsl_rl(),
      "algorithm": self.algorithm.to_rsl_rl(),
    }

  def check_samples(self, num_envs: int) -> None:
    remembers = self.actor.rnn_type or self.critic.rnn_type
    # Trajectories are divided by worlds: where there are too few, some batches of rsl-rl would be empty.
    if remembers and self.algorithm.num_mini_batches > num_envs:
      raise ConfigError(
        f"agent.algorithm.num_mini_batches is {self.algorithm.num_mini_batches}; where a network remembers, an "
        f"iteration of {num_envs} worlds has 1 to {num_envs}"
      )
    samples = num_envs * self.num_steps_per_env
    if not 1 <= self.algorithm.num_mini_batches <= samples:
      raise ConfigError(
        f"agent.algorithm.num_mini_batches is {self.algorithm.num_mini_batches}; an iteration of {num_envs} worlds "
        f"and {self.num_steps_per_env} steps has 1 to {samples}"
      )

  def for_inference(self) -> Self:
    agent = super().for_inference()
    agent.algorithm.num_mini_batches = 1
    agent.algorithm.rnd_cfg = None
    agent.critic = replace(copy.deepcopy(agent.actor), distribution_cfg=None)
    return agent


@dataclass(kw_only=True)
class RslRlDistillationRunnerCfg(RslRlBaseRunnerCfg):
  """One training run that imitates: a student does what a teacher would do, from what the student sees."""

  policy: ClassVar[str] = "student"

  obs_groups: dict[str, tuple[str, ...]] = field(
    default_factory=lambda: {"student": ("actor",), "teacher": ("teacher",)}
  )
  """Observation groups that each network sees; the teacher's in the order of those it was trained with."""
  student: RslRlModelCfg = field(default_factory=lambda: RslRlModelCfg(distribution_cfg=_gaussian(0.1)))
  """The policy. Its deviation is that of its rollouts and is not learned."""
  teacher: RslRlModelCfg | None = None
  """The teacher's network; None: that of the run it is from."""
  teacher_task: str | None = None
  """Task whose newest run is the teacher where none is named."""
  algorithm: RslRlDistillationAlgorithmCfg = field(default_factory=RslRlDistillationAlgorithmCfg)
  """The update rule."""

  def to_rsl_rl(self) -> dict[str, Any]:
    config = super().to_rsl_rl()
    for name in ("num_learning_epochs", "gradient_length"):
      _check(f"agent.algorithm.{name}", getattr(self.algorithm, name), "at least 1", lambda x: x >= 1)
    for name in ("learning_rate", "max_grad_norm"):
      if (value := getattr(self.algorithm, name)) is not None:
        _check(f"agent.algorithm.{name}", value, "positive", _is_positive)
    steps, length = self.algorithm.num_learning_epochs * self.num_steps_per_env, self.algorithm.gradient_length
    if steps % length:
      raise ConfigError(
        f"agent.algorithm.gradient_length is {length}; it must divide num_learning_epochs x num_steps_per_env, "
        f"{steps}, or the last {steps % length} steps of every iteration would teach nothing"
      )
    _check_model("student", self.student)
    _check_distribution("student", self.student, "it explores about what it has learned")
    if self.teacher is not None:
      _check_model("teacher", self.teacher)
      config["teacher"] = self.teacher.to_rsl_rl()
    return config | {"student": self.student.to_rsl_rl(), "algorithm": dict(vars(self.algorithm))}

  def for_inference(self) -> Self:
    agent = super().for_inference()
    agent.algorithm.num_learning_epochs = agent.algorithm.gradient_length = 1
    agent.teacher = replace(copy.deepcopy(agent.student), distribution_cfg=None)
    return agent


def _check(name: str, value: float, wanted: str, holds: Callable[[float], bool]) -> None:
  if not holds(value):
    raise ConfigError(f"{name} is {value}; it must be {wanted}")


def _is_positive(value: float) -> bool:
  return 0 < value < math.inf


_BLIND = ("MLPModel", "RNNModel")
# rsl-rl takes any other padding for none, without a word.
_CNN_CHOICES: dict[str, tuple[str, ...]] = {
  "activation": get_args(Activation),
  "global_pool": ("none", "max", "avg"),
  "norm": ("none", "batch", "layer"),
  "padding": ("none", "zeros", "reflect", "replicate", "circular"),
}
_CNN_SIZES = ("output_channels", "kernel_size", "stride", "dilation", "temperature")


def _check_model(network: str, model: RslRlModelCfg) -> None:
  if not model.hidden_dims:
    raise ConfigError(f"agent.{network}.hidden_dims is empty; a network has at least one hidden layer")
  for width in model.hidden_dims:
    _check(f"agent.{network}.hidden_dims", width, "at least 1", lambda x: x >= 1)
  if model.activation not in get_args(Activation):
    raise ConfigError(unknown("activation", model.activation, get_args(Activation), f"agent.{network}.activation"))
  for name in ("rnn_hidden_dim", "rnn_num_layers"):
    _check(f"agent.{network}.{name}", getattr(model, name), "at least 1", lambda x: x >= 1)
  encoders = model.cnn_cfg or {}
  if encoders and model.class_name in _BLIND:
    raise ConfigError(
      f"agent.{network}.cnn_cfg is given, but agent.{network}.class_name {model.class_name!r} sees nothing"
    )
  if encoders and all(isinstance(cfg, dict) for cfg in encoders.values()):
    for group, cfg in encoders.items():
      _check_encoder(f"agent.{network}.cnn_cfg.{group}", cfg)
  else:
    _check_encoder(f"agent.{network}.cnn_cfg", encoders)


def _check_encoder(where: str, cfg: dict[str, Any]) -> None:
  channels = cfg.get("output_channels", ())
  if not isinstance(channels, (tuple, list)):
    raise ConfigError(f"{where}.output_channels is {channels}; it must be a number for each layer")
  layers = len(channels)
  for name, value in cfg.items():
    values = value if isinstance(value, (tuple, list)) else (value,)
    if values is value and len(values) != layers:
      raise ConfigError(f"{where}.{name} has {len(values)} values, output_channels {layers}")
    for one in values:
      if name in _CNN_SIZES:
        if not isinstance(one, (int, float)):
          raise ConfigError(f"{where}.{name} is {one}; it must be a positive number")
        _check(f"{where}.{name}", one, "positive", _is_positive)
      elif name in _CNN_CHOICES and one not in _CNN_CHOICES[name]:
        raise ConfigError(unknown(name, str(one), _CNN_CHOICES[name], f"{where}.{name}"))


def _check_distribution(network: str, model: RslRlModelCfg, why: str) -> None:
  if model.distribution_cfg is None:
    raise ConfigError(
      f"agent.{network}.distribution_cfg is None, but {why}. "
      'Give one, e.g. {"class_name": "GaussianDistribution", "init_std": 1.0}.'
    )
  if isinstance(std := model.distribution_cfg.get("init_std"), (int, float)):
    _check(f"agent.{network}.distribution_cfg.init_std", std, "positive", _is_positive)
