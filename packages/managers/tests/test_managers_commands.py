"""Commands: timers, draws and metrics."""

from typing import Any

import pytest
import torch
from managers_terms import GoalCfg
from mjlab_core import UnknownNameError
from mjlab_core.errors import ConfigError
from mjlab_core.indexing import where_
from mjlab_managers import CommandManager, CommandTerm, CommandTermCfg


class Uniform(CommandTerm):
  def __init__(self, cfg: CommandTermCfg, env: Any) -> None:
    super().__init__(cfg, env)
    self._command, self.age = self.state((3,)), self.state()
    self.metrics["error"] = torch.zeros(self.num_envs)
    self.metrics["steps"] = torch.zeros(self.num_envs)

  @property
  def command(self) -> torch.Tensor:
    return self._command

  def resample(self, mask: torch.Tensor) -> None:
    where_(self._command, mask, torch.rand(self.num_envs, 3, generator=self.env.rng))

  def update(self) -> None:
    self.age.add_(~self.env.command_manager.fresh)

  def update_metrics(self) -> None:
    self.metrics["error"] += self.env.values[:, 0]
    self.metrics["steps"] = self.metrics["steps"] + 1.0


def build(env: Any, lo: float = 0.1, hi: float = 0.3) -> CommandManager:
  env.command_manager = CommandManager({"twist": GoalCfg(term=Uniform, resampling_time_range=(lo, hi))}, env)
  return env.command_manager


@pytest.mark.parametrize("steps", [1, 5, 50, 400])
def test_a_command_is_drawn_again_exactly_when_its_time_runs_out(env, steps):
  manager = build(env, steps * env.step_dt, steps * env.step_dt)
  manager.reset(~env.mask())
  counter, drawn = manager.get_term("twist").command_counter, []
  for step in range(1, 2 * steps + 1):
    before = manager.get_command("twist").clone()
    manager.compute(env.step_dt, env.mask())
    changed = (manager.get_command("twist") != before).all(1)
    assert changed.all() == changed.any()
    drawn += [step] if changed.all() else []
  assert drawn == [steps, 2 * steps]
  assert counter.tolist() == [3] * 4


def test_no_command_is_drawn_where_no_time_passes_even_if_each_step_draws_one(env):
  manager = build(env, 0.0, 0.0)
  manager.reset(~env.mask())
  before = manager.get_command("twist").clone()
  manager.compute(0.02, env.mask(0, 2))
  after = manager.get_command("twist")
  assert (after == before).all(1).tolist() == [True, False, True, False]
  assert manager.get_term("twist").command_counter.tolist() == [1, 2, 1, 2]


def test_worlds_just_reset_keep_their_full_timer_and_do_not_advance(env):
  manager = build(env)
  fresh = env.mask(1)
  manager.reset(env.mask(0, 1, 2, 3))
  left = manager.get_term("twist").time_left.clone()
  manager.compute(0.02, fresh)
  expected = torch.where(fresh, left, left - 0.02)
  torch.testing.assert_close(manager.get_term("twist").time_left, expected)
  assert manager.get_term("twist").age.tolist() == [1.0, 0.0, 1.0, 1.0]  # type: ignore


def test_metrics_are_logged_over_the_worlds_that_reset_and_zeroed_there(env, logged):
  manager = build(env)
  for _ in range(3):
    manager.compute(0.02)
  manager.reset(env.mask(1, 2))
  assert logged(manager) == {"Metrics/twist/error": 3 * 7.5, "Metrics/twist/steps": 3.0}
  assert manager.get_term("twist").metrics["steps"].tolist() == [3.0, 0.0, 0.0, 3.0]
  manager.clear_log()
  assert {str(value) for value in logged(manager).values()} == {"nan"}


@pytest.mark.parametrize("limits", [(2.0, 1.0), (-1.0, 1.0), (1.0, float("inf"))])
def test_an_impossible_time_range_is_an_error(env, limits):
  with pytest.raises(ConfigError, match="term 'twist': resampling_time_range"):
    build(env, *limits)


def test_unknown_names_get_a_suggestion(env):
  with pytest.raises(UnknownNameError, match=r"^CommandManager: term 'twst' does not exist\. Nearest: twist"):
    build(env).get_command("twst")


class Counting(Uniform):
  """Logs how many draws there were in all, and takes that over into any number of worlds."""

  def __init__(self, cfg, env):
    super().__init__(cfg, env)
    self.total = self.state((1,), shared=True)

  def resample(self, mask):
    super().resample(mask)
    self.total += mask.sum()

  def log_values(self):
    return {"draws": self.total[0]}

  def load_progress(self, state):
    self.total.copy_(state["total"])


def test_a_term_logs_further_values_and_takes_its_progress_into_another_number_of_worlds(make_env, logged):
  few, many = make_env(num_envs=3), make_env(num_envs=5)
  cfg = GoalCfg(term=Counting, resampling_time_range=(1.0, 2.0))
  managers = [CommandManager({"twist": cfg}, env) for env in (few, many)]
  managers[0].reset(torch.ones(3, dtype=torch.bool))
  assert [logged(manager)["Metrics/twist/draws"] for manager in managers] == [3.0, 0.0]
  managers[1].load_progress(managers[0].state_dict())
  assert logged(managers[1])["Metrics/twist/draws"] == 3.0


def test_a_command_without_times_is_drawn_at_resets_only(env):
  env.command_manager = manager = CommandManager({"twist": GoalCfg(term=Uniform, resampling_time_range=None)}, env)
  manager.reset(~env.mask())
  first = manager.get_command("twist").clone()
  for _ in range(20):
    manager.compute(1e3)
  assert torch.equal(manager.get_command("twist"), first)
  assert manager.get_term("twist").command_counter.eq(1).all()
  manager.reset(~env.mask())
  assert not torch.equal(manager.get_command("twist"), first)
  assert "resampling_time_range" in manager.describe()


class Steerable(Uniform):
  @property
  def axes(self) -> list[tuple[str, float, float]]:
    return [("forward [m/s]", -1.0, 1.0), ("left [m/s]", -0.5, 0.5), ("turn [rad/s]", -2.0, 2.0)]

  def update(self) -> None:
    if self.by_hand is not None:
      where_(self._command, *self.by_hand)


def test_a_steered_command_holds_in_its_world_and_needs_no_operation_before(env):
  term = Steerable(GoalCfg(term=Steerable, resampling_time_range=None), env)
  term.name = "twist"
  term.resample(~env.mask())
  before = term.command.clone()
  term.update()
  assert term.by_hand is None
  term.steer(2, [0.5, 0.25, -1.0])
  term.update()
  assert term.command[2].tolist() == [0.5, 0.25, -1.0]
  others = [0, 1, 3]
  assert torch.equal(term.command[others], before[others])
  term.steer(2, None)
  term.resample(~env.mask())
  term.update()
  assert term.command[2].tolist() != [0.5, 0.25, -1.0]
  term.steer(0, [0.0, 0.0, 0.0])
  assert env.recaptures == ["command 'twist' is steered"]
  assert set(term.state_dict()) == {"time_left", "command_counter", "_command", "age"}
  with pytest.raises(ValueError, match=r"steered by forward \[m/s\], left \[m/s\], turn \[rad/s\]; got 2 numbers"):
    term.steer(0, [1.0, 2.0])
  with pytest.raises(ValueError, match="steered by nothing; got 1 numbers"):
    Uniform(GoalCfg(term=Uniform, resampling_time_range=None), env).steer(0, [1.0])
