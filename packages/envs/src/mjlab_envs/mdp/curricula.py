"""Curricula that any task can use: weights and parameters of terms in stages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import torch
from mjlab_core import MjlabError, PositiveCount
from mjlab_managers import ManagerBase, ManagerTermBase

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv


@dataclass(frozen=True, kw_only=True)
class Stage:
  """Values of a term from one point of training on. A value that a stage leaves out stays as it is."""

  step: int
  """Environment step, or iteration where the curriculum counts iterations, with which the stage begins."""
  weight: float | None = None
  """Weight of a reward."""
  params: dict[str, float] = field(default_factory=dict)
  """Parameters of the term by name."""


Stages = Sequence[Stage | Mapping[str, Any]]
"""Stages in the order of their steps, each a `Stage` or a dict of its fields."""


class termination_curriculum(ManagerTermBase):
  """Set parameters of a termination in stages of the step counter; before the first stage they are as configured.

  Only numbers that the term takes as scalars can change inside the recorded step. Logs each by its name.

  Args:
    env: the environment.
    termination: name of the termination.
    stages: values and the steps with which they begin.
    steps_per_iteration: environment steps of one unit of `Stage.step`; with `num_steps_per_env`, stages count
      iterations.
  """

  env: "ManagerBasedRlEnv"

  def __init__(
    self, env: "ManagerBasedRlEnv", *, termination: str, stages: Stages, steps_per_iteration: PositiveCount = 1
  ) -> None:
    super().__init__(env)
    read = _read(stages)
    if any(stage.weight is not None for stage in read):
      raise MjlabError(f"stages of termination '{termination}': a termination has no weight")
    self._term = termination
    self._tabulate(read, steps_per_iteration)

  @property
  def _manager(self) -> ManagerBase[Any]:
    return self.env.termination_manager

  def __call__(self, mask: torch.Tensor) -> dict[str, torch.Tensor]:
    del mask  # All worlds share the stage, which follows from the step counter.
    self._values.copy_(self._rows.index_select(0, self._stage())[0])
    self._write()
    return dict(zip(self._params, self._values.unbind(), strict=True))

  def restore(self, state: Mapping[str, Any], mask: torch.Tensor | None = None) -> None:
    """Write a saved state back, and its values into the term."""
    super().restore(state, mask)
    self._write()

  def _tabulate(self, stages: list[Stage], steps_per_iteration: int) -> None:
    """Make a table of the values: first as configured, then one row for each stage."""
    self._params = tuple(dict.fromkeys(name for stage in stages for name in stage.params))
    rows = [[float(self._manager.scalar(self._term, name)) for name in self._params]]
    for stage in stages:
      rows.append([stage.params.get(name, value) for name, value in zip(self._params, rows[-1], strict=True)])
    self._rows = torch.tensor(rows, dtype=torch.float64, device=self.device)
    self._values = self.state_of(self._rows[0].clone(), shared=True)
    starts = [stage.step * steps_per_iteration for stage in stages]
    self._starts = torch.tensor(starts, dtype=torch.int64, device=self.device)

  def _stage(self) -> torch.Tensor:
    """Return the number of stages that have begun, (1,)."""
    return (self.env.common_step_counter >= self._starts).sum(0, keepdim=True)

  def _write(self) -> None:
    for name, value in zip(self._params, self._values.unbind(), strict=True):
      self._manager.scalar(self._term, name).copy_(value)


class reward_curriculum(termination_curriculum):
  """Set the weight and parameters of a reward in stages of the step counter; before the first they are as configured.

  As `termination_curriculum`. A weight is logged as "weight". With a weight in some stage the term is always evaluated,
  also while it is 0.
  """

  def __init__(
    self, env: "ManagerBasedRlEnv", *, reward: str, stages: Stages, steps_per_iteration: PositiveCount = 1
  ) -> None:
    ManagerTermBase.__init__(self, env)
    read = _read(stages)
    self._term = reward
    self._tabulate(read, steps_per_iteration)
    self._weights: torch.Tensor | None = None
    if any(stage.weight is not None for stage in read):
      weights = [float(env.reward_manager.weight(reward))]
      for stage in read:
        weights.append(weights[-1] if stage.weight is None else stage.weight)
      self._weights = torch.tensor(weights, dtype=torch.float32, device=env.device)

  @property
  def _manager(self) -> ManagerBase[Any]:
    return self.env.reward_manager

  def __call__(self, mask: torch.Tensor) -> dict[str, torch.Tensor]:
    values = super().__call__(mask)
    if self._weights is None:
      return values
    weight = self._weights.index_select(0, self._stage())[0]
    self.env.reward_manager.weight(self._term).copy_(weight)
    return {"weight": weight, **values}


def _read(stages: Stages) -> list[Stage]:
  read = [stage if isinstance(stage, Stage) else Stage(**stage) for stage in stages]
  if any(later.step <= sooner.step for sooner, later in pairwise(read)):
    raise MjlabError(f"stages must follow in order, got steps {[stage.step for stage in read]}")
  return read
