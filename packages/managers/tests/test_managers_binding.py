"""Binding of terms to their parameters, and the messages about mistakes."""

import functools
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError, MjlabError
from mjlab_managers import (
  EventManager,
  EventTermCfg,
  ManagerTermBase,
  ObservationGroupCfg,
  ObservationManager,
  ObservationTermCfg,
  RewardManager,
  RewardTermCfg,
  SceneEntityCfg,
  TerminationManager,
  TerminationTermCfg,
)

ROBOT = SceneEntityCfg("robot")
KNEES = SceneEntityCfg("robot", joint_names=".*_knee")


def joints(env: Any, *, asset: SceneEntityCfg = KNEES) -> torch.Tensor:
  return env.values[:, asset.joint_ids].sum(1)


def observe(env: Any, func: Any, **params: Any) -> torch.Tensor:
  group = ObservationGroupCfg(terms={"term": ObservationTermCfg(func, params=params)})
  observation = ObservationManager({"group": group}, env).compute()["group"]
  assert isinstance(observation, torch.Tensor)
  return observation


class Counting(ManagerTermBase):
  """Term with a decorated call, which takes any arguments."""

  def __init__(self, env: Any) -> None:
    super().__init__(env)
    self.calls: list[int] = []

  def __call__(self, *args: Any) -> torch.Tensor:
    self.calls.append(len(args))
    return torch.ones(self.num_envs)


def reward(env: Any, func: Any, **params: Any) -> torch.Tensor:
  return RewardManager({"term": RewardTermCfg(func, weight=1.0, params=params)}, env, scale_by_dt=False).compute()


class TestSelection:
  def test_everything_and_neighbours_are_slices_and_the_rest_is_an_index_tensor(self, env):
    def resolve(**names):
      return SceneEntityCfg("robot", **names).resolve(env.scene, env.device)

    assert resolve().joint_ids == slice(None)
    assert resolve(joint_names=".*").joint_ids == slice(None)
    assert resolve(joint_names="F.*").joint_ids == slice(0, 4)
    assert resolve(joint_names="RL_hip").joint_ids == slice(4, 5)
    scattered = resolve(joint_names=".*_hip").joint_ids
    assert isinstance(scattered, torch.Tensor)
    assert scattered.tolist() == [0, 2, 4]
    assert scattered.dtype is torch.int64

  def test_names_follow_the_model_or_the_patterns(self, env):
    patterns = ("RL_hip", "FL_.*")
    natural = SceneEntityCfg("robot", joint_names=patterns).resolve(env.scene, env.device)
    assert natural.joint_names == ("FL_hip", "FL_knee", "RL_hip")
    ordered = SceneEntityCfg("robot", joint_names=patterns, preserve_order=True).resolve(env.scene, env.device)
    assert ordered.joint_names == ("RL_hip", "FL_hip", "FL_knee")
    assert isinstance(ordered.joint_ids, torch.Tensor)
    assert ordered.joint_ids.tolist() == [4, 0, 1]

  @pytest.mark.parametrize(("given", "ids"), [(2, slice(2, 3)), ((0, 1), slice(0, 2)), ([3, 1], [1, 3])])
  def test_indices_may_be_given_instead_of_names(self, env, given, ids):
    resolved = SceneEntityCfg("robot", joint_names=given).resolve(env.scene, env.device)
    assert (resolved.joint_ids if isinstance(ids, slice) else resolved.joint_ids.tolist()) == ids

  @pytest.mark.parametrize(
    ("given", "said"),
    [
      ((), "joint indices must have at least 1 element"),
      (7, r"joint indices must be in \[0, 4\]"),
      (-1, r"joint indices must be in \[0, 4\]"),
      ((1, 1), "must name each element once"),
      ((True,), "must be a whole number"),
      ("left_hip", "pattern 'left_hip' matches no joint. Nearest: FL_hip"),
      (("FL_.*", ".*_hip"), "'FL_hip' is matched by two patterns"),
    ],
  )
  def test_a_selection_that_means_nothing_is_an_error(self, env, given, said):
    with pytest.raises(ValueError, match=said):
      SceneEntityCfg("robot", joint_names=given).resolve(env.scene, env.device)

  def test_resolving_makes_a_copy_and_an_unresolved_one_cannot_be_used(self, env):
    cfg = SceneEntityCfg("robot", joint_names=".*_knee")
    cfg.resolve(env.scene, env.device)
    assert cfg == KNEES
    with pytest.raises(MjlabError, match="not resolved"):
      cfg.joint_ids  # noqa: B018


class TestParameters:
  def test_default_arguments_are_resolved(self, env):
    assert torch.equal(reward(env, joints), env.values[:, [1, 3]].sum(1))
    assert not KNEES.resolved

  def test_entities_are_resolved_however_deep(self, env):
    @dataclass
    class Options:
      asset: SceneEntityCfg

    def deep(env, *, options: Options, table: dict, pair: tuple) -> torch.Tensor:
      assert pair[0].resolved
      return env.values[:, options.asset.joint_ids].sum(1) + env.values[:, table["x"][0].joint_ids].sum(1)

    hips = SceneEntityCfg("robot", joint_names=".*_hip")
    got = reward(env, deep, options=Options(KNEES), table={"x": [hips]}, pair=(KNEES, 1))
    assert torch.equal(got, env.values.sum(1))
    assert not hips.resolved

  def test_partials_lambdas_methods_and_instances_are_terms(self, env):
    class Scaled:
      def __init__(self, factor: float) -> None:
        self.factor = factor

      def __call__(self, env, *, asset: SceneEntityCfg = ROBOT) -> torch.Tensor:
        return env.values[:, asset.joint_ids].sum(1) * self.factor

    expected = env.values.sum(1)
    assert torch.equal(reward(env, functools.partial(joints, asset=ROBOT)), expected)
    assert torch.equal(reward(env, lambda env, k=2.0: env.values.sum(1) * k, k=1.0), expected)
    assert torch.equal(reward(env, Scaled(1.0)), expected)
    assert torch.equal(reward(env, Scaled(1.0).__call__), expected)

  def test_every_mistake_of_a_manager_is_reported_at_once_with_term_and_way_out(self, env):
    def fine(env, *, std: float) -> torch.Tensor:
      return env.values[:, 0] * std

    with pytest.raises(ConfigError) as caught:
      RewardManager(
        {
          "typo": RewardTermCfg(fine, weight=1.0, params={"sdt": 1.0}),
          "entity": RewardTermCfg(joints, weight=1.0, params={"asset": SceneEntityCfg("robto")}),
          "shape": RewardTermCfg(lambda env: env.values, weight=1.0),
          "dtype": RewardTermCfg(lambda env: env.values[:, 0] > 0, weight=1.0),
          "number": RewardTermCfg(lambda env: 1.0, weight=1.0),
          "raises": RewardTermCfg(lambda env: env.scene["table"], weight=1.0),
          "argless": RewardTermCfg(lambda: None, weight=1.0),
          "not_callable": RewardTermCfg("joints", weight=1.0),  # type: ignore
          "params": RewardTermCfg(fine, weight=1.0, params=None),  # type: ignore
        },
        env,
      )
    message = str(caught.value)
    assert len(caught.value.problems) == 10
    for said in (
      "RewardManager: term 'typo': parameter 'sdt' does not exist. Nearest: std. All 1: std.",
      "term 'typo': missing parameter std.",
      "term 'entity': parameter 'asset': scene: entity 'robto' does not exist. Nearest: robot.",
      "term 'shape': must return float (4,) on cpu, returned float32 (4, 5)",
      "term 'dtype': must return float (4,) on cpu, returned bool (4,)",
      "term 'number': must return float (4,) on cpu, returned float 1.0",
      "term 'raises': KeyError in a trial call (test_managers_binding.py, line ",
      "): 'table'",
      "term 'argless': must take the environment",
      "term 'not_callable': func 'joints' is not callable",
      "term 'params': params must be a mapping, got None",
    ):
      assert said in message

  def test_a_termination_must_be_bool(self, env):
    with pytest.raises(ConfigError, match=r"'t': must return bool \(4,\) on cpu, returned float32"):
      TerminationManager({"t": TerminationTermCfg(lambda env: env.values[:, 0])}, env)

  def test_an_event_names_its_second_parameter(self, env):
    with pytest.raises(ConfigError, match=r"second parameter must be 'mask' .* it is 'ids'"):
      EventManager({"push": EventTermCfg(lambda env, ids: None, mode="step")}, env)

  def test_a_config_of_the_wrong_kind_is_named(self, env):
    with pytest.raises(ConfigError, match="expected a RewardTermCfg, got TerminationTermCfg"):
      RewardManager({"r": TerminationTermCfg(joints)}, env)  # type: ignore

  def test_none_removes_a_term(self, env):
    assert RewardManager({"a": None, "b": RewardTermCfg(joints, weight=1.0)}, env).active_terms == ["b"]

  def test_an_unknown_term_name_gets_a_suggestion(self, env):
    manager = RewardManager({"foot_slip": RewardTermCfg(joints, weight=1.0)}, env)
    with pytest.raises(KeyError, match="Nearest: foot_slip"):
      manager.get_term_cfg("foot_slp")


class Counter(ManagerTermBase):
  """Calls since the reset, (N,)."""

  def __init__(self, env, *, asset: SceneEntityCfg = ROBOT) -> None:
    super().__init__(env)
    assert asset.resolved
    self.calls = self.state()

  def __call__(self) -> torch.Tensor:
    return self.calls.add_(1.0).clone()


class TestClassTerms:
  def test_a_class_term_is_made_once_and_the_trial_call_leaves_no_trace(self, env):
    manager = RewardManager({"n": RewardTermCfg(Counter, weight=1.0)}, env, scale_by_dt=False)
    counter = manager.get_term_cfg("n").func
    assert isinstance(counter, Counter)
    assert counter.name == "n"
    assert manager.compute().tolist() == [1.0] * 4
    manager.reset(env.mask(1))
    assert manager.compute().tolist() == [2.0, 1.0, 2.0, 2.0]

  def test_managers_do_not_share_configs(self, env):
    cfg = RewardTermCfg(Counter, weight=1.0)
    first, second = RewardManager({"n": cfg}, env), RewardManager({"n": cfg}, env)
    assert cfg.func is Counter
    assert first.get_term_cfg("n").func is not second.get_term_cfg("n").func

  def test_a_class_that_cannot_be_called_or_made_is_named(self, env):
    class Broken(Counter):
      def __init__(self, env) -> None:
        raise ValueError("no such sensor")

    class Wrong(Counter):
      def __init__(self, env) -> None:
        raise TypeError("no such argument")

    class Uncallable(ManagerTermBase):
      pass

    for func, said in (
      (SimpleNamespace, r"class SimpleNamespace does not have the form.*\n  class SimpleNamespace\(ManagerTermBase\)"),
      (Uncallable, r"class Uncallable does not have the form[^$]*def __call__\(self\)"),
      (Broken, r"ValueError while making it \(test_managers_binding.py, line \d+\): no such sensor"),
      (Wrong, r"TypeError while making it \(test_managers_binding.py, line \d+\): no such argument"),
    ):
      with pytest.raises(ConfigError, match=f"term 'n': {said}"):
        RewardManager({"n": RewardTermCfg(func, weight=1.0)}, env)


def test_the_call_of_a_class_term_may_take_any_arguments(env):
  assert reward(env, Counting).tolist() == [1.0] * env.num_envs
  events = EventManager({"term": EventTermCfg(Counting, mode="step")}, env)
  events.apply("step")
  counting = events.get_term_cfg("term").func
  assert isinstance(counting, Counting)
  assert counting.calls[-1] == 1
