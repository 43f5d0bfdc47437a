"""State that is not saved: tensors that a term replaces, or writes, without a declaration.

A recorded step goes on reading a tensor that was replaced, and a run that is resumed begins with what was not saved.
"""

import re
from collections.abc import Callable
from typing import Any

import pytest
import torch
from managers_terms import ActCfg, GoalCfg
from mjlab_core.errors import ConfigError
from mjlab_core.state import Stateful
from mjlab_managers import (
  ActionManager,
  ActionTerm,
  CommandManager,
  CommandTerm,
  CurriculumManager,
  CurriculumTermCfg,
  EventManager,
  EventTermCfg,
  ManagerTermBase,
  MetricsManager,
  MetricsTermCfg,
  ObservationGroupCfg,
  ObservationManager,
  ObservationTermCfg,
  RecorderManager,
  RecorderTerm,
  RecorderTermCfg,
  RewardManager,
  RewardTermCfg,
  TerminationManager,
  TerminationTermCfg,
)


class Peak(Stateful):
  """Part of a term."""

  def __init__(self, env: Any) -> None:
    self.num_envs, self.device = env.num_envs, env.device
    self.value = torch.zeros(env.num_envs)


def prepare(term: Any) -> None:
  """Give a term tensors in every place where it can have some."""
  term.peak = torch.zeros(term.num_envs)
  term.by_name = {"peak": torch.zeros(term.num_envs)}
  term.frames = [torch.zeros(term.num_envs), torch.zeros(term.num_envs)]
  term.part = Peak(term.env)
  term.declared = term.state()


CHANGES = {
  "term.peak = torch.maximum(term.peak, term.env.values[:, 0])": "self.peak",
  "term.by_name['peak'] = term.by_name['peak'] + 1.0": "self.by_name['peak']",
  "term.frames = [term.env.values[:, 0].clone(), term.frames[0]]": "self.frames[0], self.frames[1]",
  "term.part.value = term.part.value + 1.0": "self.part.value",
  "term.last = term.env.values[:, 0].clone()": "self.last",
  "term.peak.add_(1.0)": "self.peak",
  "term.by_name['peak'].add_(1.0)": "self.by_name['peak']",
  "term.frames[1].copy_(term.frames[0])": "self.frames[1]",
  "term.part.value.mul_(0.5)": "self.part.value",
}
WRITE_DECLARED = "term.declared.add_(1.0)"


def do(change: str, term: Any) -> None:
  exec(change, {"term": term, "torch": torch})


class Called(ManagerTermBase):
  """Term of every manager that calls terms; `shape` is what it returns for one world."""

  def __init__(self, env: Any, *, change: str, kind: str) -> None:
    super().__init__(env)
    prepare(self)
    self._change, self._kind = change, kind

  def __call__(self) -> Any:
    do(self._change, self)
    shape = (self.num_envs, 1) if self._kind == "observation" else (self.num_envs,)
    return torch.zeros(shape, dtype=torch.bool if self._kind == "termination" else torch.float32)


class Masked(ManagerTermBase):
  """Event or curriculum."""

  def __init__(self, env: Any, *, change: str) -> None:
    super().__init__(env)
    prepare(self)
    self._change = change

  def __call__(self, mask: torch.Tensor) -> None:
    do(self._change, self)


class Act(ActionTerm):
  def __init__(self, cfg: ActCfg, env: Any) -> None:
    super().__init__(cfg, env)
    prepare(self)
    self._change = cfg.option

  @property
  def action_dim(self) -> int:
    return 2

  def process_actions(self, actions: torch.Tensor) -> None:
    do(self._change, self)


class Goal(CommandTerm):
  def __init__(self, cfg: GoalCfg, env: Any) -> None:
    super().__init__(cfg, env)
    prepare(self)
    self.goal = self.state((2,))
    self._change = cfg.option

  @property
  def command(self) -> torch.Tensor:
    return self.goal

  def resample(self, mask: torch.Tensor) -> None:
    pass

  def update(self) -> None:
    do(self._change, self)


def term(kind: str, change: str, cfg: Any, **options: Any) -> dict[str, Any]:
  return {"t": cfg(Called, params={"change": change, "kind": kind}, **options)}


def event(mode: Any, **options: Any) -> Callable[[Any, str], Any]:
  return lambda env, change: EventManager(
    {"t": EventTermCfg(Masked, mode=mode, params={"change": change}, **options)}, env
  )


MANAGERS: dict[str, Callable[[Any, str], Any]] = {
  "reward": lambda env, change: RewardManager(term("reward", change, RewardTermCfg, weight=1.0), env),
  "termination": lambda env, change: TerminationManager(term("termination", change, TerminationTermCfg), env),
  "metric": lambda env, change: MetricsManager(term("metric", change, MetricsTermCfg), env),
  "observation": lambda env, change: ObservationManager(
    {"g": ObservationGroupCfg(terms=term("observation", change, ObservationTermCfg))}, env
  ),
  "curriculum": lambda env, change: CurriculumManager({"t": CurriculumTermCfg(Masked, params={"change": change})}, env),
  "startup event": event("startup"),
  "reset event": event("reset"),
  "interval event": event("interval", interval_range_s=(3600.0, 3600.0)),
  "step event": event("step"),
  "command": lambda env, change: CommandManager(
    {"t": GoalCfg(term=Goal, option=change, resampling_time_range=None)}, env
  ),
  "action": lambda env, change: ActionManager({"t": ActCfg(term=Act, option=change)}, env),
}


@pytest.mark.parametrize("kind", MANAGERS)
@pytest.mark.parametrize("change", CHANGES)
def test_state_that_is_not_declared_is_refused_by_name(env, kind: str, change: str):
  changed = re.escape(CHANGES[change])
  with pytest.raises(ConfigError, match=rf"term '(g/)?t': a trial call .* {changed}, .*self\.x = self\.state\("):
    MANAGERS[kind](env, change).rehearse()


@pytest.mark.parametrize("kind", MANAGERS)
def test_declared_state_is_written_and_put_back(env, kind: str):
  manager = MANAGERS[kind](env, WRITE_DECLARED)
  before = manager.state_dict()
  manager.rehearse()
  after = manager.state_dict()
  name = "g/t" if kind == "observation" else "t"
  for state in (before, after):
    assert state["_stateful_terms"][name]["declared"].tolist() == [0.0] * env.num_envs


def test_a_reset_that_replaces_a_tensor_is_refused(env):
  class Forgetful(Called):
    def reset(self, mask: torch.Tensor) -> None:
      self.peak = torch.zeros(self.num_envs)

  params = {"change": WRITE_DECLARED, "kind": "reward"}
  with pytest.raises(ConfigError, match=r"term 't': a trial call replaced, or wrote into, self\.peak,"):
    RewardManager({"t": RewardTermCfg(Forgetful, weight=1.0, params=params)}, env)


def test_a_change_of_parameters_is_tried_in_the_same_way(env):
  manager = MANAGERS["reward"](env, WRITE_DECLARED)
  with pytest.raises(ConfigError, match=r"term 't': a trial call replaced, or wrote into, self\.peak,"):
    manager.set_params("t", change="term.peak.add_(1.0)")
  assert manager.term("t").given["change"] == WRITE_DECLARED


def test_recorders_run_on_the_host_and_may_keep_what_they_like(env):
  class Keeping(RecorderTerm):
    def __init__(self, env: Any) -> None:
      super().__init__(env)
      self.rows = torch.zeros(0)

    def post_step(self) -> None:
      self.rows = torch.cat([self.rows, self.env.values[:, 0]])

  manager = RecorderManager({"t": RecorderTermCfg(Keeping)}, env)
  manager.rehearse()
  recorder: Any = manager.get_term("t")
  assert len(recorder.rows) == 0
  manager.post_step()
  assert len(recorder.rows) == env.num_envs


@pytest.mark.parametrize("mode", ["startup", "reset"])
def test_tensors_of_a_term_that_is_built_again_for_its_trial_are_no_others(env, mode: Any):
  """A term that reads its numbers on the host is built again with Python numbers, with new tensors."""
  kept = []

  class Level(ManagerTermBase):
    def __init__(self, env: Any, *, block: float) -> None:
      super().__init__(env)
      self.level = torch.arange(env.num_envs) // block
      self._block = block
      kept.append(self.level)  # Its memory is not used again.

    def __call__(self, mask: torch.Tensor) -> None:
      assert float(self._block) == 2.0

  manager = EventManager({"t": EventTermCfg(Level, mode=mode, params={"block": 2.0})}, env)
  manager.rehearse()
  term: Any = manager.term("t").func
  assert term.level.tolist() == [world // 2 for world in range(env.num_envs)]
