"""The training loop of a student that imitates a teacher."""

from typing import Any, cast

from rsl_rl.algorithms import Distillation
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from mjlab_rl import checkpoint
from mjlab_rl.config import ConfigError, RslRlBaseRunnerCfg, RslRlDistillationRunnerCfg
from mjlab_rl.runner import MjlabOnPolicyRunner
from mjlab_rl.trained_policy import TrainedPolicy


class MjlabDistillationRunner(MjlabOnPolicyRunner):
  """`MjlabOnPolicyRunner` for rsl-rl's `Distillation`: the student acts and learns what the teacher would have done.

  The teacher comes from `load_teacher`, or with the checkpoint of a distillation that is resumed, and then as it was.
  """

  @property
  def networks(self) -> dict[str, MLPModel]:
    return {"student": self._distillation._raw_student, "teacher": self._distillation._raw_teacher}

  def load_teacher(self, teacher: TrainedPolicy) -> None:
    """Take the weights of a teacher.

    Raises:
      CheckpointError: It saw observations of other shapes, or its network has other sizes; nothing has been
        changed then.
    """
    network = self.networks["teacher"]
    self.check_shapes_seen(teacher.path, "teacher", teacher.shapes_seen)
    checkpoint.check_fit(teacher.path, "teacher", teacher.weights, network.state_dict())
    network.load_state_dict(teacher.weights)
    self._distillation.teacher_loaded = True

  def learn(self, num_learning_iterations: int, init_at_random_ep_len: bool = False) -> None:
    if not self._distillation.teacher_loaded:
      raise ConfigError("there is no teacher to learn from: load one before learning")
    super().learn(num_learning_iterations, init_at_random_ep_len)

  @property
  def _distillation(self) -> Distillation:
    return cast("Distillation", self.alg)

  def _load_worlds(self, state: dict[str, Any]) -> None:
    super()._load_worlds(state)
    # What an update replays begins with what the student remembered before it.
    self._distillation.last_hidden_states = (self.networks["student"].get_hidden_state(), None)

  def _update(self, obs: TensorDict) -> dict[str, float]:
    # rsl-rl puts the teacher back to where it was before its first step, after every update.
    teacher = self.networks["teacher"]
    remembered = teacher.get_hidden_state()
    losses = super()._update(obs)
    teacher.reset(hidden_state=remembered)
    return losses


def runner_class(agent: RslRlBaseRunnerCfg) -> type[MjlabOnPolicyRunner]:
  """The standard runner of a learner."""
  return MjlabDistillationRunner if isinstance(agent, RslRlDistillationRunnerCfg) else MjlabOnPolicyRunner
