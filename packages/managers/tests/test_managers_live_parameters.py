"""Parameters and state of class terms, and changes of a built term: what acts, what is refused, and what is kept."""

from typing import Any, Literal

import pytest
import torch
from managers_terms import ActCfg, GoalCfg
from mjlab_core import Positive
from mjlab_core.errors import ConfigError, MjlabError
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
  ObservationGroupCfg,
  ObservationManager,
  ObservationTermCfg,
  RecorderManager,
  RecorderTerm,
  RecorderTermCfg,
  RewardManager,
  RewardTermCfg,
)


class Peak(ManagerTermBase):
  """Counts its calls per world, times a factor."""

  def __init__(self, env: Any, *, factor: Positive, mode: Literal["up", "down"] = "up", start: int = 0) -> None:
    super().__init__(env)
    self._factor, self._sign = factor, 1.0 if mode == "up" else -1.0
    self.calls = self.state(fill=start)
    self.total = self.state(dtype=torch.int64, shared=True)

  def __call__(self) -> torch.Tensor:
    self.total.add_(1)
    return self.calls.add_(1.0) * self._factor * self._sign


class KeptPeak(Peak):
  def reset(self, mask: torch.Tensor) -> None:
    self.calls.masked_fill_(mask, -1.0)


def scaled(env: Any, *, scale: float, power: int = 1) -> torch.Tensor:
  return torch.ones(env.num_envs) * scale * power


def rewards(env: Any, func: Any, **params: Any) -> RewardManager:
  return RewardManager({"r": RewardTermCfg(func, weight=1.0, params=params)}, env, scale_by_dt=False)


MISTAKES: list[tuple[dict[str, Any], str]] = [
  ({"factor": "much"}, "term 'r': parameter 'factor' must be a number, got 'much'."),
  ({"factor": -1.0}, "term 'r': parameter 'factor' must be positive, got -1.0."),
  ({"start": 0.5}, "term 'r': parameter 'start' must be a whole number, got 0.5."),
  ({"factr": 1.0}, "term 'r': parameter 'factr' does not exist. Nearest: factor. All 3: factor, mode, start."),
  ({"mode": "upp"}, "term 'r': parameter 'mode' 'upp' does not exist. Nearest: up. All 2: up, down."),
]


@pytest.mark.parametrize(("wrong", "message"), MISTAKES)
def test_set_params_refuses_what_the_build_refuses(env, wrong: dict[str, Any], message: str):
  with pytest.raises(ConfigError) as at_build:
    rewards(env, Peak, **{"factor": 2.0, **wrong})
  manager = rewards(env, Peak, factor=2.0)
  with pytest.raises(ConfigError) as live:
    manager.set_params("r", **wrong)
  assert str(at_build.value) == str(live.value) == f"RewardManager: {message}"
  assert manager.compute().tolist() == [2.0] * 4


def test_a_missing_parameter_of_a_class_is_named(env):
  with pytest.raises(ConfigError, match=r"term 'r': missing parameter factor\."):
    rewards(env, Peak)


def test_a_number_is_written_and_anything_else_rebuilds_the_term_with_its_state(env):
  manager = rewards(env, Peak, factor=2.0)
  manager.compute()
  manager.set_params("r", factor=10.0)
  assert env.recaptures == []
  assert manager.compute().tolist() == [20.0] * 4
  manager.set_params("r", mode="down")
  assert env.recaptures == ["RewardManager: parameters of 'r' changed"]
  assert manager.compute().tolist() == [-30.0] * 4
  assert manager.term("r").func.total == 3
  assert manager.get_term_cfg("r").params == {"factor": 10.0, "mode": "down", "start": 0}


def test_a_reset_refills_state_unless_the_term_does_it_itself(env):
  for kind, begun in ((Peak, 5.0), (KeptPeak, -1.0)):
    manager = rewards(env, kind, factor=1.0, start=5)
    manager.compute()
    manager.reset(env.mask(1))
    term = manager.term("r").func
    assert term.calls.tolist() == [6.0, begun, 6.0, 6.0]
    assert term.total == 1


def test_edits_of_the_params_of_a_built_term_are_refused_and_name_set_params(env):
  cfg = rewards(env, scaled, scale=1.0).get_term_cfg("r")
  for edit in (
    lambda: cfg.params.update(scale=2.0),
    lambda: cfg.params.__setitem__("scale", 2.0),
    lambda: setattr(cfg, "params", {"scale": 2.0}),
    lambda: setattr(cfg, "func", Peak),
  ):
    with pytest.raises(MjlabError, match=r"assign weight, or change its parameters by set_params\('r', name=value\)"):
      edit()


class Goal(CommandTerm):
  def __init__(self, cfg: GoalCfg, env: Any) -> None:
    super().__init__(cfg, env)
    self.goal = self.state((2,))

  @property
  def command(self) -> torch.Tensor:
    return self.goal

  def resample(self, mask: torch.Tensor) -> None: ...


class Act(ActionTerm):
  @property
  def action_dim(self) -> int:
    return 2

  def process_actions(self, actions: torch.Tensor) -> None: ...


def test_the_config_of_a_command_has_no_parameters_to_name(env):
  manager = CommandManager({"c": GoalCfg(term=Goal, resampling_time_range=None)}, env)
  with pytest.raises(MjlabError, match=r"its config is read-only; write into a tensor of the term\."):
    manager.get_term_cfg("c").resampling_time_range = (1.0, 2.0)


class TestForm:
  """Terms in the form of mjlab 1.x are refused with the form that they must have."""

  def test_class_terms(self, env):
    class Init(ManagerTermBase):
      def __init__(self, cfg: Any, env: Any) -> None:
        super().__init__(env)

      def __call__(self) -> Any: ...

    class Call(Peak):
      def __call__(self, env: Any, factor: float) -> Any: ...  # type: ignore

    class Reset(Peak):
      def reset(self, env_ids: torch.Tensor) -> None: ...  # type: ignore

    class Plain:
      def __init__(self, cfg: Any, env: Any) -> None: ...

      def __call__(self, env: Any, factor: float) -> Any: ...

    class Event(ManagerTermBase):
      def __call__(self, env: Any, env_ids: Any, factor: float) -> None: ...

    for kind in (Init, Call, Reset, Plain):
      lines = (r"__init__\(self, env, \*, ", r"__call__\(self\)", r"reset\(self, mask\)")
      with pytest.raises(ConfigError, match=rf"class {kind.__name__} does not have {'[^$]*'.join(('', *lines))}"):
        rewards(env, kind, factor=1.0)
    with pytest.raises(ConfigError, match=r"class Event does not have [^$]*__call__\(self, mask\)"):
      EventManager({"e": EventTermCfg(Event, mode="reset", params={"factor": 1.0})}, env)

  def test_an_object_whose_reset_would_never_be_called(self, env):
    with pytest.raises(
      ConfigError, match=r"func is an object of Peak, and its reset would never be called; give the cl"
    ):
      rewards(env, Peak(env, factor=1.0))

  def test_commands_actions_and_recorders(self, env):
    class ResetGoal(Goal):
      def reset(self, env_ids: torch.Tensor) -> None: ...  # type: ignore

    class DrawnGoal(Goal):
      def resample(self, env_ids: torch.Tensor) -> None: ...  # type: ignore

    class ResetAct(Act):
      def reset(self, env_ids: torch.Tensor | None = None) -> None: ...  # type: ignore

    class Note(RecorderTerm):
      def record_post_step(self) -> None: ...

    for goal, method in ((ResetGoal, "reset"), (DrawnGoal, "resample")):
      with pytest.raises(ConfigError, match=rf"\.{method}\(self, env_ids\) must be {method}\(self, mask\)"):
        CommandManager({"c": GoalCfg(term=goal, resampling_time_range=None)}, env)
    with pytest.raises(ConfigError, match=r"ResetAct\.reset\(self, env_ids\) must be reset\(self, mask\)"):
      ActionManager({"a": ActCfg(term=ResetAct)}, env)
    with pytest.raises(ConfigError, match=r"method 'record_post_step' of mjlab 1.x is called 'post_step' here"):
      RecorderManager({"n": RecorderTermCfg(Note)}, env)


class TestWrittenScalars:
  """Scalars that a curriculum writes inside the step."""

  def test_a_trial_call_leaves_them(self, env):
    manager = env.reward_manager = rewards(env, scaled, scale=2.0)

    def widen(env: Any, mask: torch.Tensor) -> None:
      env.reward_manager.scalar("r", "scale").add_(mask.sum())

    curriculum = CurriculumManager({"c": CurriculumTermCfg(widen)}, env, others=[manager])
    curriculum.rehearse()
    assert manager.compute().tolist() == [2.0] * 4

  def test_another_change_keeps_value_and_memory(self, env):
    manager = rewards(env, scaled, scale=2.0)
    scale = manager.scalar("r", "scale")
    scale.fill_(3.0)
    manager.set_params("r", power=2)
    assert manager.compute().tolist() == [6.0] * 4
    scale.fill_(4.0)
    assert manager.compute().tolist() == [8.0] * 4
    manager.set_params("r", scale=2.0)
    assert manager.compute().tolist() == [4.0] * 4

  def test_a_refused_change_leaves_them(self, env):
    def broken(env: Any, *, scale: float, name: str = "values") -> torch.Tensor:
      return getattr(env, name)[:, 0] * scale

    manager = rewards(env, broken, scale=2.0)
    scale = manager.scalar("r", "scale")
    scale.fill_(3.0)
    before = manager.compute().clone()
    with pytest.raises(ConfigError, match="AttributeError"):
      manager.set_params("r", scale=5.0, name="valuse")
    assert torch.equal(manager.compute(), before)

  def test_an_equal_observation_of_another_group_does_not_follow(self, env):
    def reading(env: Any, *, gain: float) -> torch.Tensor:
      return env.values * gain

    groups = {
      name: ObservationGroupCfg(terms={"t": ObservationTermCfg(reading, params={"gain": 2.0})}) for name in ("a", "b")
    }
    manager = ObservationManager(groups, env)
    manager.scalar("b/t", "gain").fill_(5.0)
    assert env.recaptures
    seen: Any = manager.compute()
    assert torch.equal(seen["a"], env.values * 2.0)
    assert torch.equal(seen["b"], env.values * 5.0)


def test_terms_get_python_numbers_where_reads_on_the_host_cannot_be_seen(env, monkeypatch: pytest.MonkeyPatch):
  monkeypatch.setattr("mjlab_managers.terms.watch.SEES_OPERATIONS", False)
  manager = rewards(env, scaled, scale=2.0)
  assert manager.compute().tolist() == [2.0] * 4
  manager.set_params("r", scale=3.0)
  assert env.recaptures
  assert manager.compute().tolist() == [3.0] * 4
