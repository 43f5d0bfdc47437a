"""What a task is: the target of an entry point of the group `mjlab.tasks` returns one of these."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from mjlab_rl.config import RslRlBaseRunnerCfg, RslRlOnPolicyRunnerCfg

if TYPE_CHECKING:
  from mjlab_rl.evaluation import Evaluator

EnvCfgT = TypeVar("EnvCfgT")


@dataclass(kw_only=True)
class TaskCfg(Generic[EnvCfgT]):
  """One task: what to simulate, how to watch it, how to learn it.

  Build a fresh one on every call of the entry point, because whoever asked for it may change it.
  """

  env: EnvCfgT
  """Environment configuration for training."""
  play: Callable[[EnvCfgT], EnvCfgT] | None = None
  """Turns a training configuration (a copy, with the overrides of the run) into the one for watching; None: as it is.

  A function and not a second configuration, so that a trained run is watched as it was trained."""
  agent: RslRlBaseRunnerCfg = field(default_factory=RslRlOnPolicyRunnerCfg)
  """Learner configuration."""
  runner: type[Any] | None = None
  """Subclass of MjlabOnPolicyRunner to train with; None: the standard one for such a learner."""
  make_env: Callable[..., Any] | None = None
  """Builds the environment, called as make_env(cfg, device=device); None: the standard environment class."""
  evaluator: "Evaluator | None" = None
  """Judges policies of this task; None: only returns and lengths of episodes are looked at."""
