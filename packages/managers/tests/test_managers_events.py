"""Events: modes, timers and derived constants."""

import functools
from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_managers import EventManager, EventTermCfg, ManagerTermBase


class Fired:
  """An event that notes where it fired."""

  def __init__(self) -> None:
    self.masks: list[list[bool]] = []

  def __call__(self, env: Any, mask: torch.Tensor) -> None:
    self.masks.append(mask.tolist())

  def __deepcopy__(self, memo: Any) -> "Fired":
    return self


def interval(env: Any, lo: float, hi: float, **options: Any) -> tuple[EventManager, Fired]:
  """Return a manager with one interval event."""
  fired = Fired()
  term = EventTermCfg(fired, mode="interval", interval_range_s=(lo, hi), **options)
  return EventManager({"push": term}, env), fired


def test_each_mode_fires_its_terms_in_the_worlds_of_the_mask(env):
  modes: tuple[Any, ...] = ("startup", "reset", "step")
  terms = {mode: Fired() for mode in modes}
  cfgs = {mode: EventTermCfg(terms[mode], mode=mode) for mode in modes}
  manager = EventManager({**cfgs, "none": None}, env)
  assert manager.available_modes == ["startup", "reset", "step"]
  manager.apply("startup")
  manager.apply("reset", env.mask(1))
  manager.apply("interval")
  assert [term.masks for term in terms.values()] == [[[True] * 4], [[False, True, False, False]], []]


def test_one_term_can_be_fired_whatever_its_mode_says(env):
  push, other = Fired(), Fired()
  manager = EventManager(
    {
      "push": EventTermCfg(push, mode="interval", interval_range_s=(5.0, 10.0)),
      "other": EventTermCfg(other, mode="interval", interval_range_s=(5.0, 10.0)),
    },
    env,
  )
  manager.fire("push")
  manager.fire("push", env.mask(2))
  assert push.masks == [[True] * 4, [False, False, True, False]]
  assert other.masks == []
  with pytest.raises(KeyError, match="Nearest: push"):
    manager.fire("pusch")


def test_the_mean_time_between_firings_is_the_middle_of_the_range(make_env):
  env = make_env(256)
  (manager, fired), steps = interval(env, 0.2, 0.6), 1000
  for _ in range(steps):
    manager.apply("interval")
  count = torch.tensor(fired.masks).sum().item()
  # A timer is only looked at once per step, so that a firing is half a step late on average. Of a renewal process of
  # mean m and standard deviation s, t / m - (1 - s^2 / m^2) / 2 firings come in a long time t.
  mean, variance = 0.4 + env.step_dt / 2, 0.4**2 / 12
  expected = steps * env.step_dt / mean - (1.0 - variance / mean**2) / 2.0
  assert count / 256 == pytest.approx(expected, rel=0.01)


@pytest.mark.usefixtures("nothing_skipped")
@pytest.mark.parametrize("is_global", [False, True])
@pytest.mark.parametrize("steps", [5, 100, 400])
def test_a_constant_interval_fires_exactly_on_time(env, steps, is_global):
  manager, fired = interval(env, steps * env.step_dt, steps * env.step_dt, is_global_time=is_global)
  for _ in range(2 * steps):
    manager.apply("interval", ~env.mask())
  assert [i + 1 for i, mask in enumerate(fired.masks) if all(mask)] == [steps, 2 * steps]


def test_a_reset_redraws_the_timer_of_its_world_but_not_a_global_one(env):
  own, _ = interval(env, 1.0, 9.0)
  before = own.state_dict()["_time_left"]
  own.reset(env.mask(2))
  assert (own.state_dict()["_time_left"] != before)[:, 0].tolist() == [False, False, True, False]
  shared, _ = interval(env, 1.0, 9.0, is_global_time=True)
  before = shared.state_dict()["_time_left"]
  shared.reset(env.mask(2))
  assert torch.equal(shared.state_dict()["_time_left"], before)
  assert len(before.unique()) == 1


@pytest.mark.usefixtures("nothing_skipped")
def test_a_global_timer_fires_everywhere_at_once(env):
  manager, fired = interval(env, 0.1, 0.3, is_global_time=True)
  for _ in range(100):
    manager.apply("interval", env.mask(0, 2))
  assert {tuple(mask) for mask in fired.masks} == {(True,) * 4, (False,) * 4}


def test_worlds_for_which_no_time_passed_keep_their_timer(env):
  manager, fired = interval(env, 0.02, 0.02)
  manager.apply("interval", ~env.mask(3))
  assert fired.masks == [[True, True, True, False]]
  manager, fired = interval(env, 0.0, 0.0)
  manager.apply("interval", ~env.mask(3))
  assert fired.masks == [[True, True, True, False]]


def test_a_firing_leaves_the_timers_of_other_events(env):
  often, seldom = (Fired() for _ in range(2))
  terms = {
    name: EventTermCfg(fired, mode="interval", interval_range_s=(steps * env.step_dt,) * 2)
    for name, fired, steps in (("often", often, 1), ("seldom", seldom, 3))
  }
  manager = EventManager(terms, env)
  for _ in range(6):
    manager.apply("interval")
  assert len([mask for mask in often.masks if all(mask)]) == 6
  assert len([mask for mask in seldom.masks if all(mask)]) == 2


@pytest.mark.usefixtures("nothing_skipped")
def test_a_minimal_step_count_lets_the_first_firing_through_and_then_counts_global_steps(env):
  fired = Fired()
  manager = EventManager({"dr": EventTermCfg(fired, mode="reset", min_step_count_between_reset=10)}, env)
  firings = []
  for step in range(0, 32, 4):
    env.common_step_counter.fill_(step)
    manager.apply("reset", env.mask(0) if step != 8 else env.mask(0, 1))
    if fired.masks[-1][0]:
      firings.append(step)
  assert firings == [0, 12, 24]
  assert [mask[1] for mask in fired.masks].count(True) == 1


def test_constants_are_recomputed_once_per_apply_where_something_fired(env):
  def mass(env: Any, mask: torch.Tensor) -> None: ...
  def friction(env: Any, mask: torch.Tensor) -> None: ...

  mass.model_fields, mass.needs_constants = ("body_mass", "body_inertia"), True  # type: ignore
  friction.model_fields = ("geom_friction",)  # type: ignore
  terms: dict[str, EventTermCfg | None] = {
    "mass": EventTermCfg(functools.partial(mass), mode="reset"),
    "again": EventTermCfg(mass, mode="reset", min_step_count_between_reset=5),
    "friction": EventTermCfg(friction, mode="reset"),
    "push": EventTermCfg(friction, mode="step"),
  }
  manager = EventManager(terms, env)
  assert manager.model_fields == ("body_mass", "body_inertia", "geom_friction")
  manager.apply("reset", env.mask(1, 3))
  manager.apply("step")
  assert env.recomputed == [[1, 3]]


def test_a_class_event_declares_its_fields_after_it_was_made(env):
  class Randomize(ManagerTermBase):
    def __init__(self, env: Any, *, field: str) -> None:
      super().__init__(env)
      self.model_fields = (field,)
      self.needs_constants = True

    def __call__(self, mask: torch.Tensor) -> None: ...

  term = EventTermCfg(Randomize, mode="startup", params={"field": "body_ipos"})
  manager = EventManager({"r": term}, env)
  assert manager.model_fields == ("body_ipos",)
  manager.apply("startup")
  assert env.recomputed == [[0, 1, 2, 3]]


def test_a_term_that_asks_for_indices_runs_outside_the_recording_and_only_if_there_are_any(env):
  calls: list[list[int]] = []

  def push(env: Any, env_ids: torch.Tensor, *, force: float = 1.0) -> None:
    calls.append(env_ids.tolist())

  manager = EventManager({"push": EventTermCfg(push, mode="reset")}, env)
  manager.apply("reset", env.mask(1, 3))
  manager.apply("reset", env.mask())
  assert calls == [[1, 3]]
  assert env.eager == ["event 'push'"] * 2


@pytest.mark.parametrize(
  ("options", "said"),
  [
    ({"mode": "restart"}, "mode 'restart' does not exist. Nearest: startup, reset"),
    ({"mode": "interval"}, "needs interval_range_s"),
    ({"mode": "interval", "interval_range_s": (2.0, 1.0)}, r"interval_range_s must not fall, got \(2.0, 1.0\)"),
    ({"mode": "interval", "interval_range_s": 2.0}, "interval_range_s must be a tuple, got 2.0"),
    ({"mode": "interval", "interval_range_s": (1.0, float("inf"))}, "interval_range_s must be finite"),
    ({"mode": "reset", "min_step_count_between_reset": 1.5}, "min_step_count_between_reset must be a whole number"),
    ({"mode": "reset", "interval_range_s": (1.0, 2.0)}, "interval_range_s is for mode interval, the mode is reset"),
    ({"mode": "step", "is_global_time": True}, "is_global_time is for mode interval"),
    ({"mode": "step", "min_step_count_between_reset": 3}, "is for mode reset, the mode is step"),
  ],
)
def test_wrong_options_are_errors_at_build(env, options, said):
  with pytest.raises(ConfigError, match=f"EventManager: term 'e'.*{said}"):
    EventManager({"e": EventTermCfg(Fired(), **options)}, env)


@pytest.mark.usefixtures("nothing_skipped")
def test_a_step_asks_the_device_nothing_and_absent_modes_do_nothing(env, dispatched):
  def nothing(env: Any, mask: torch.Tensor) -> None: ...

  terms: dict[str, EventTermCfg | None] = {
    **{f"i{i}": EventTermCfg(nothing, mode="interval", interval_range_s=(1.0, 2.0)) for i in range(5)},
    "g": EventTermCfg(nothing, mode="interval", interval_range_s=(1.0, 2.0), is_global_time=True),
    "r": EventTermCfg(nothing, mode="reset", min_step_count_between_reset=3),
  }
  manager = EventManager(terms, env)
  mask = env.mask(1)
  assert len(dispatched(lambda: manager.apply("interval", mask))) <= 16
  dispatched(lambda: manager.apply("reset", mask))
  dispatched(lambda: manager.reset(mask))
  assert dispatched(lambda: manager.apply("step", mask)) == []
