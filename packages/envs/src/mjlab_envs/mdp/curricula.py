"""Curricula that any task can use: weights and parameters of terms in stages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import torch
from mjlab_core import Config, ConfigError, Finite, MjlabError, PositiveCount, check_fields
from mjlab_managers import ManagerTermBase, RewardManager, TerminationManager

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv


@dataclass(frozen=True, kw_only=True)
class Stage(Config):
  """Values of a term from one point of training on. A value that a stage leaves out stays as it is."""

  step: int
  """Environment step, or iteration where the curriculum counts iterations, with which the stage begins."""
  weight: Finite | None = None
  """Weight of a reward."""
  params: Mapping[str, float] = field(default_factory=dict)
  """Parameters of the term by name."""

  def __post_init__(self) -> None:
    check_fields(self, "Stage")


Stages = Sequence[Stage | Mapping[str, Any]]
"""Stages in the order of their steps, each a `Stage` or a dict of its fields."""


_Kind = Literal["reward", "termination"]
_WEIGHT = ""  # Weight among the names of parameters.


class _StagedValues(ManagerTermBase):
  """Base of curricula that set the weight and parameters of a term in stages of the step counter."""

  env: "ManagerBasedRlEnv"

  def __init__(
    self, env: "ManagerBasedRlEnv", kind: _Kind, term: str, stages: Stages, steps_per_iteration: int
  ) -> None:
    super().__init__(env)
    self._kind: _Kind = kind
    self._term = term
    read = [stage if isinstance(stage, Stage) else Stage(**stage) for stage in stages]
    if any(later.step <= sooner.step for sooner, later in pairwise(read)):
      raise MjlabError(f"stages must follow in order, got steps {[stage.step for stage in read]}")
    if problems := [problem for stage in read for problem in self._problems(stage)]:
      raise ConfigError(*problems)
    changes = [stage.params if stage.weight is None else {_WEIGHT: stage.weight, **stage.params} for stage in read]
    self._names = tuple(dict.fromkeys(name for change in changes for name in change))
    rows = [[float(self._scalar(name)) for name in self._names]]
    for change in changes:
      rows.append([change.get(name, value) for name, value in zip(self._names, rows[-1], strict=True)])
    # Values as configured, then of each stage.
    self._rows = torch.tensor(rows, dtype=torch.float64, device=self.device)
    self._values = self.state_of(self._rows[0].clone(), shared=True)
    starts = [stage.step * steps_per_iteration for stage in read]
    self._starts = torch.tensor(starts, dtype=torch.int64, device=self.device)

  def __call__(self, mask: torch.Tensor) -> dict[str, torch.Tensor]:
    del mask  # All worlds share the stage, which follows from the step counter.
    stage = (self.env.common_step_counter >= self._starts).sum(0, keepdim=True)
    self._values.copy_(self._rows.index_select(0, stage)[0])
    self._write()
    return {name or "weight": value for name, value in zip(self._names, self._values.unbind(), strict=True)}

  def restore(self, state: Mapping[str, Any], mask: torch.Tensor | None = None) -> None:
    """Write a saved state back, and its values into the term."""
    super().restore(state, mask)
    self._write()

  def _write(self) -> None:
    for name, value in zip(self._names, self._values.unbind(), strict=True):
      self._scalar(name).copy_(value)

  @property
  def _manager(self) -> RewardManager | TerminationManager:
    return self.env.reward_manager if self._kind == "reward" else self.env.termination_manager

  def _problems(self, stage: Stage) -> list[str]:
    """Return the mistakes in the parameters of a stage, as `set_params` finds them."""
    return [f"stage of step {stage.step}: {line}" for line in self._manager.term(self._term).problems(stage.params)]

  def _scalar(self, name: str) -> torch.Tensor:
    """Return the scalar of a parameter, or the weight, on the device."""
    manager = self._manager
    if name != _WEIGHT:
      return manager.scalar(self._term, name)
    if isinstance(manager, RewardManager):
      return manager.weight(self._term)
    raise MjlabError(f"stages of termination '{self._term}': a termination has no weight")


class termination_curriculum(_StagedValues):
  """Set parameters of a termination in stages of the step counter; before the first stage they are as configured.

  Only numbers that the term takes as scalars can change inside the recorded step. Logs each by its name.

  Args:
    env: the environment.
    termination: name of the termination.
    stages: values and the steps with which they begin.
    steps_per_iteration: environment steps of one unit of `Stage.step`; with `num_steps_per_env`, stages count
      iterations.
  """

  def __init__(
    self, env: "ManagerBasedRlEnv", *, termination: str, stages: Stages, steps_per_iteration: PositiveCount = 1
  ) -> None:
    super().__init__(env, "termination", termination, stages, steps_per_iteration)


class reward_curriculum(_StagedValues):
  """Set the weight and parameters of a reward in stages of the step counter; before the first they are as configured.

  As `termination_curriculum`. A weight is logged as "weight". With a weight in some stage the term is always evaluated,
  also while it is 0.
  """

  def __init__(
    self, env: "ManagerBasedRlEnv", *, reward: str, stages: Stages, steps_per_iteration: PositiveCount = 1
  ) -> None:
    super().__init__(env, "reward", reward, stages, steps_per_iteration)
