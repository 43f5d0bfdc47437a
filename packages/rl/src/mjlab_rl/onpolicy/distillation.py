"""Training loop of distillation."""

from pathlib import Path
from typing import Any, cast

from rsl_rl.algorithms import Distillation
from tensordict import TensorDict

from mjlab_rl.config import RslRlBaseRunnerCfg, RslRlDistillationRunnerCfg
from mjlab_rl.offpolicy.config import OffPolicyRunnerCfg
from mjlab_rl.offpolicy.runner import MjlabOffPolicyRunner
from mjlab_rl.onpolicy.teachers import Teachers
from mjlab_rl.runner import MjlabOnPolicyRunner
from mjlab_rl.trained_policy import TrainedPolicy


class MjlabDistillationRunner(MjlabOnPolicyRunner):
  """`MjlabOnPolicyRunner` for rsl-rl's `Distillation`: the student acts and learns the actions of the teacher.

  The teacher comes from `load_teacher`, or from the checkpoint of a resumed distillation. `agent.num_teachers` teachers
  share the worlds, as `mjlab_rl.onpolicy.teachers.Teachers` describes.
  """

  network_names = ("student", "teacher")

  def load_teacher(self, *teachers: TrainedPolicy) -> None:
    """Take the weights of a teacher, or of all `agent.num_teachers` teachers in their order.

    Raises:
      FileError: One saw observations of other shapes, or its network has other sizes; nothing has been
        changed then.
    """
    loaded: Any = self.networks["teacher"]
    networks = list(loaded) if isinstance(loaded, Teachers) else [loaded]
    for teacher, network in zip(teachers, networks, strict=True):
      self.check_network(teacher.path, "teacher", teacher.weights, teacher.shapes_seen, network)
    for teacher, network in zip(teachers, networks, strict=True):
      network.load_state_dict(teacher.weights)
    self._distillation.teacher_loaded = True

  @property
  def _distillation(self) -> Distillation:
    return cast("Distillation", self.alg)

  def _load_worlds(self, path: Path, state: dict[str, Any]) -> None:
    super()._load_worlds(path, state)
    # An update replays from the hidden state that the student had before the rollout.
    self._distillation.last_hidden_states = (self.networks["student"].get_hidden_state(), None)

  def _update(self, obs: TensorDict) -> dict[str, float]:
    # rsl-rl resets the teacher's hidden state to its initial one after every update.
    teacher: Any = self.networks["teacher"]
    remembered = teacher.get_hidden_state()
    losses = super()._update(obs)
    teacher.reset(hidden_state=remembered)
    return losses


def runner_class(agent: RslRlBaseRunnerCfg) -> type[MjlabOnPolicyRunner]:
  """Return the standard runner of a learner."""
  if isinstance(agent, OffPolicyRunnerCfg):
    return MjlabOffPolicyRunner
  return MjlabDistillationRunner if isinstance(agent, RslRlDistillationRunnerCfg) else MjlabOnPolicyRunner
