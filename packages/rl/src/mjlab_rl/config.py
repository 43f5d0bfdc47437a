"""Configuration of tasks and learners; that of a learner becomes rsl-rl's dictionaries."""

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, is_dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, Literal, Self, TypeVar

from mjlab_core.config import Config
from mjlab_core.constraints import Count, Finite, Limits, Positive, PositiveCount, Share, field_problems, named_problem
from mjlab_core.errors import ConfigError

from mjlab_rl.models.network_entries import Activation, encoder_problems

if TYPE_CHECKING:
  from mjlab_rl.evaluation import Evaluator

Optimizer = Literal["adam", "adamw", "sgd", "rmsprop"]
EnvCfgT = TypeVar("EnvCfgT")
# Classes that take the place of rsl-rl's.
_CLASSES = {
  "CNNModel": "mjlab_rl.models.networks:ImageModel",
  "GaussianDistribution": "mjlab_rl.models.networks:Gaussian",
  "PPO": "mjlab_rl.onpolicy.captured_ppo:CapturedPPO",
}
_WITHOUT_IMAGES = ("MLPModel", "RNNModel")


class LearnerPart(Config):
  """Configuration of a network or an algorithm."""

  def to_rsl_rl(self) -> dict[str, Any]:
    """Return the arguments of the class, without the optional parts that are off."""
    part = {name: copy.deepcopy(value) for name, value in vars(self).items() if value is not None}
    for settings in (part, part.get("distribution_cfg", {})):
      if (name := settings.get("class_name")) in _CLASSES:
        settings["class_name"] = _CLASSES[name]
    return part


@dataclass(kw_only=True)
class RslRlModelCfg(LearnerPart):
  """One network: an actor, a critic, a student or a teacher."""

  hidden_dims: Annotated[tuple[int, ...], Limits(ge=1)] = (128, 128, 128)
  """Widths of the hidden layers."""
  activation: Activation = "elu"
  """Activation function by rsl-rl's name."""
  obs_normalization: bool = False
  """Normalise observations by their running mean and deviation over all worlds."""
  distribution_cfg: dict[str, Any] | None = None
  """Action distribution, e.g. {"class_name": "GaussianDistribution", "init_std": 1.0}; None: deterministic output."""
  cnn_cfg: dict[str, Any] | None = None
  """Convolution settings of image groups; None: no image groups."""
  rnn_type: Literal["lstm", "gru"] | None = None
  """Recurrent layer between the observations and the hidden layers; None: none."""
  rnn_hidden_dim: PositiveCount = 256
  """Width of the recurrent layer."""
  rnn_num_layers: PositiveCount = 1
  """Number of recurrent layers."""
  class_name: str = "MLPModel"
  """rsl-rl's "MLPModel" or, for images, "CNNModel", with or without `rnn_type`, or "module:Class"."""

  def to_rsl_rl(self) -> dict[str, Any]:
    model = super().to_rsl_rl()
    if self.rnn_type is None:
      del model["rnn_hidden_dim"], model["rnn_num_layers"]
    elif self.class_name == "MLPModel":
      model["class_name"] = "RNNModel"
    return model

  def problems(self, where: str) -> Iterator[str]:
    """Yield a line for each value that a network cannot be built from; `where` names the network."""
    if not self.hidden_dims:
      yield f"{where}.hidden_dims is empty; a network has at least one hidden layer"
    init_std = (self.distribution_cfg or {}).get("init_std", 1.0)
    if problem := named_problem("init_std", init_std, Positive):
      yield f"{where}.distribution_cfg.{problem}"
    encoders = self.cnn_cfg or {}
    if encoders and self.class_name in _WITHOUT_IMAGES:
      yield f"{where}.cnn_cfg is given, but {where}.class_name {self.class_name!r} takes no images"
    if not encoders or not all(isinstance(encoder, dict) for encoder in encoders.values()):
      encoders = {"": encoders}
    for group, encoder in encoders.items():
      yield from encoder_problems(encoder, f"{where}.cnn_cfg{group and '.'}{group}")


@dataclass(kw_only=True)
class RslRlPpoAlgorithmCfg(LearnerPart):
  """Proximal policy optimisation (Schulman et al. 2017, arXiv:1707.06347) as rsl-rl implements it."""

  num_learning_epochs: PositiveCount = 5
  """Passes over the data of one iteration."""
  num_mini_batches: PositiveCount = 4
  """Mini-batches per pass."""
  learning_rate: Positive = 1e-3
  """Step size at the start."""
  schedule: Literal["adaptive", "fixed"] = "adaptive"
  """adaptive: the step size follows the measured KL divergence, within [1e-5, 1e-2]."""
  desired_kl: Positive = 0.01
  """KL divergence per mini-batch that the adaptive schedule aims at."""
  gamma: Share = 0.99
  """Discount per environment step."""
  lam: Share = 0.95
  """Lambda of the generalised advantage estimate."""
  entropy_coef: Finite = 0.005
  """Weight of the entropy bonus."""
  value_loss_coef: Finite = 1.0
  """Weight of the value loss."""
  use_clipped_value_loss: bool = True
  """Clip the change of the value estimate as well."""
  clip_param: Positive = 0.2
  """Clip range of the probability ratio."""
  max_grad_norm: Positive = 1.0
  """Gradient norm limit, for actor and critic separately."""
  normalize_advantage_per_mini_batch: bool = False
  """Normalise advantages in each mini-batch instead of over the whole batch."""
  optimizer: Optimizer = "adam"
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
  """rsl-rl's "PPO", on a GPU as a CUDA graph, or "module:Class"; "rsl_rl.algorithms:PPO" is rsl-rl's own."""


@dataclass(kw_only=True)
class RslRlDistillationAlgorithmCfg(LearnerPart):
  """Imitation of a teacher in the states that the student visits (DAgger, Ross et al. 2011, arXiv:1011.0686)."""

  num_learning_epochs: PositiveCount = 1
  """Passes over the data of one iteration."""
  gradient_length: PositiveCount = 8
  """Steps that contribute to one gradient; a recurrent student is trained through all of them.

  It divides num_learning_epochs x num_steps_per_env."""
  learning_rate: Positive = 1e-3
  """Step size."""
  max_grad_norm: Positive | None = 1.0
  """Gradient norm limit; None: none."""
  loss_type: Literal["mse", "huber"] = "mse"
  """Measure of the difference between the student's mean action and the teacher's."""
  optimizer: Optimizer = "adam"
  """Optimiser of the student."""
  use_mixed_precision: bool = False
  """Compute the loss in bfloat16 where that is safe."""
  class_name: str = "Distillation"
  """rsl-rl's "Distillation", or "module:Class"."""


def _gaussian(init_std: float) -> dict[str, Any]:
  return {"class_name": "GaussianDistribution", "init_std": init_std, "std_type": "scalar"}


@dataclass(kw_only=True)
class RslRlBaseRunnerCfg(Config):
  """Base runner config: iterations, seed, logging."""

  policy: ClassVar[str]
  """Name of the network that acts, in `obs_groups`, in checkpoints and among the fields."""

  seed: int = 42
  """Seed of the learner, and of the environment where that has none."""
  num_steps_per_env: PositiveCount = 24
  """Environment steps per world and iteration."""
  max_iterations: PositiveCount = 300
  """Iterations in all; a resumed run continues up to this number."""
  save_interval: PositiveCount = 50
  """Iterations between checkpoints."""
  experiment_name: str = "exp1"
  """Folder of the runs of one experiment, below the log root."""
  run_name: str = ""
  """Appended to the name of the run directory."""
  obs_groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
  """Observation groups that each network sees."""
  clip_actions: Positive | None = None
  """Limit of the absolute value of every action; None: no limit."""
  logger: Literal["tensorboard", "wandb", "none"] = "tensorboard"
  """Log of scalars besides progress.csv; wandb also writes tensorboard files."""
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
    """Return a new configuration dictionary for rsl-rl, which writes into it.

    Raises:
      ConfigError: Values cannot work, or the logger is not installed; the message lists all of them.
    """
    if problems := list(self.problems()):
      raise ConfigError(*problems)
    parts = {name: part.to_rsl_rl() for name, part in vars(self).items() if isinstance(part, LearnerPart)}
    return parts | {
      "num_steps_per_env": self.num_steps_per_env,
      "max_iterations": self.max_iterations,
      "save_interval": self.save_interval,
      "obs_groups": {name: list(groups) for name, groups in self.obs_groups.items()},
      "run_name": self.run_name,
      "torch_compile_mode": self.torch_compile_mode,
      # The environment finds and resets broken worlds itself; rsl-rl's check would stop the GPU three times a step.
      "check_for_nan": False,
    }

  def problems(self) -> Iterator[str]:
    """Yield a line for each value that cannot work, by the name of its flag."""
    yield from (f"agent.{problem}" for problem in field_problems(self))
    for name, part in vars(self).items():
      if is_dataclass(part):
        yield from (f"agent.{name}.{problem}" for problem in field_problems(part))
      if isinstance(part, RslRlModelCfg):
        yield from part.problems(f"agent.{name}")
    if getattr(self, self.policy).distribution_cfg is None:
      yield (
        f"agent.{self.policy}.distribution_cfg is None, but actions are sampled from it. "
        'Give one, e.g. {"class_name": "GaussianDistribution", "init_std": 1.0}.'
      )
    if self.logger == "wandb" and find_spec("wandb") is None:
      yield "agent.logger is 'wandb', which is not installed: pip install wandb"
    for name in ("experiment_name", "run_name"):
      folder = getattr(self, name)
      if "/" in folder or folder in (".", "..") or (name == "experiment_name" and not folder):
        yield f"agent.{name} is {folder!r}; it must be the name of one folder, not a path"

  def check_samples(self, num_envs: int) -> None:
    """Check that an iteration of `num_envs` worlds gives every mini-batch a sample.

    Raises:
      ConfigError: It does not.
    """

  def prepare_env(self, cfg: Any) -> None:
    """Set the options that the learner needs in the configuration of its environment."""

  def for_inference(self) -> Self:
    """Return a copy for a policy that only acts, in any number of worlds, with the smallest storage.

    The other networks are never called; they get the observations of the policy, so that no others are needed.
    """
    agent = replace(copy.deepcopy(self), num_steps_per_env=1)
    agent.obs_groups = {name: agent.obs_groups.get(agent.policy, groups) for name, groups in agent.obs_groups.items()}
    return agent


@dataclass(kw_only=True)
class RslRlOnPolicyRunnerCfg(RslRlBaseRunnerCfg):
  """Runner config for reinforcement learning: networks and algorithm."""

  policy: ClassVar[str] = "actor"

  obs_groups: dict[str, tuple[str, ...]] = field(default_factory=lambda: {"actor": ("actor",), "critic": ("critic",)})
  """Observation groups that each network sees."""
  actor: RslRlModelCfg = field(default_factory=lambda: RslRlModelCfg(distribution_cfg=_gaussian(1.0)))
  """The policy."""
  critic: RslRlModelCfg = field(default_factory=RslRlModelCfg)
  """The value estimate."""
  algorithm: RslRlPpoAlgorithmCfg = field(default_factory=RslRlPpoAlgorithmCfg)
  """The update rule."""
  critic_warmup: Count = 0
  """Iterations at the start of a run in which only the critic learns; for a run that starts from a trained policy."""

  def problems(self) -> Iterator[str]:
    yield from super().problems()
    if self.critic_warmup and self.algorithm.share_cnn_encoders:
      yield "agent.critic_warmup holds the actor, whose encoders the critic shares; set share_cnn_encoders=False"
    if self.algorithm.share_cnn_encoders and self.critic.class_name in _WITHOUT_IMAGES:
      yield (
        "agent.algorithm.share_cnn_encoders is on, but agent.critic.class_name "
        f"{self.critic.class_name!r} takes no images"
      )

  def check_samples(self, num_envs: int) -> None:
    steps, count = self.num_steps_per_env, self.algorithm.num_mini_batches
    # rsl-rl divides trajectories by worlds, and some batches would be empty.
    is_recurrent = self.actor.rnn_type or self.critic.rnn_type
    most = num_envs if is_recurrent else num_envs * steps
    if not 1 <= count <= most:
      given = f"agent.algorithm.num_mini_batches is {count}; an iteration of {num_envs} worlds and {steps} steps"
      raise ConfigError(f"{given} has 1 to {most}{' for a recurrent network' if is_recurrent else ''}")

  def for_inference(self) -> Self:
    agent = super().for_inference()
    agent.algorithm.num_mini_batches = 1
    agent.algorithm.rnd_cfg = None
    agent.critic = replace(copy.deepcopy(agent.actor), distribution_cfg=None)
    return agent


def control_agent(
  experiment_name: str, max_iterations: int, *, entropy_coef: float = 0.005, save_interval: int = 50
) -> RslRlOnPolicyRunnerCfg:
  """Return PPO as legged robots and arms train with it: wide networks and normalised observations.

  Args:
    experiment_name: Folder of the runs.
    max_iterations: Iterations in all.
    entropy_coef: Weight of the entropy bonus.
    save_interval: Iterations between checkpoints.
  """
  sizes: dict[str, Any] = {"hidden_dims": (512, 256, 128), "obs_normalization": True}
  return RslRlOnPolicyRunnerCfg(
    experiment_name=experiment_name,
    actor=RslRlModelCfg(**sizes, distribution_cfg=_gaussian(1.0)),
    critic=RslRlModelCfg(**sizes),
    algorithm=RslRlPpoAlgorithmCfg(entropy_coef=entropy_coef),
    max_iterations=max_iterations,
    save_interval=save_interval,
  )


@dataclass(kw_only=True)
class RslRlDistillationRunnerCfg(RslRlBaseRunnerCfg):
  """Runner config for distillation: a student imitates a teacher from its own observations."""

  policy: ClassVar[str] = "student"

  obs_groups: dict[str, tuple[str, ...]] = field(
    default_factory=lambda: {"student": ("actor",), "teacher": ("teacher",)}
  )
  """Observation groups of each network; those of the teacher in the order of its training. With several teachers,
  "teacher_index" can name a group with the number of each world's teacher from 0, (num_envs, 1)."""
  student: RslRlModelCfg = field(default_factory=lambda: RslRlModelCfg(distribution_cfg=_gaussian(0.1)))
  """The policy. Its standard deviation applies to rollouts and is not learned."""
  teacher: RslRlModelCfg | None = None
  """The teacher's network; None: the network of its run."""
  num_teachers: PositiveCount = 1
  """Number of teachers, all with one kind of network; set to the number of checkpoints given to `train`."""
  teacher_task: str | None = None
  """Task of the default teacher, which is the newest run of that task; None: a teacher must be given."""
  algorithm: RslRlDistillationAlgorithmCfg = field(default_factory=RslRlDistillationAlgorithmCfg)
  """The update rule."""

  def problems(self) -> Iterator[str]:
    yield from (problems := list(super().problems()))
    steps, length = self.algorithm.num_learning_epochs * self.num_steps_per_env, self.algorithm.gradient_length
    if not problems and steps % length:
      yield (
        f"agent.algorithm.gradient_length is {length}; it must divide num_learning_epochs x num_steps_per_env, "
        f"{steps}, or the last {steps % length} steps of every iteration would not be used"
      )

  def to_rsl_rl(self) -> dict[str, Any]:
    config = super().to_rsl_rl()
    if self.teacher is not None and self.num_teachers > 1:
      network = config["teacher"]
      config["teacher"] = {
        "class_name": "mjlab_rl.onpolicy.teachers:Teachers",
        "network": network,
        "count": self.num_teachers,
      }
    return config

  def for_inference(self) -> Self:
    agent = super().for_inference()
    agent.algorithm.num_learning_epochs = agent.algorithm.gradient_length = 1
    agent.teacher, agent.num_teachers = replace(copy.deepcopy(agent.student), distribution_cfg=None), 1
    return agent


@dataclass(kw_only=True)
class TaskCfg(Config, Generic[EnvCfgT]):
  """One task: environment, variant for watching, learner.

  The target of an entry point of group `mjlab.tasks` returns a new one on every call, because callers change it.
  """

  env: EnvCfgT
  """Environment configuration for training."""
  play: Callable[[EnvCfgT], EnvCfgT] | None = None
  """Function from a copy of the training configuration to the one for watching; None: no change."""
  agent: RslRlBaseRunnerCfg = field(default_factory=RslRlOnPolicyRunnerCfg)
  """Learner configuration."""
  agents: dict[str, RslRlBaseRunnerCfg] = field(default_factory=dict)
  """Other learners by name, such as "flashsac"; they replace the presets of these names."""
  runner: type[Any] | None = None
  """Subclass of MjlabOnPolicyRunner to train with; None: the standard one of the learner."""
  make_env: Callable[..., Any] | None = None
  """Environment factory, called as make_env(cfg, device=device); None: the standard environment class."""
  evaluator: "Evaluator | None" = None
  """Evaluator of policies; None: returns and lengths of episodes only."""
