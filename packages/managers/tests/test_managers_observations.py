"""The observation pipeline: noise, clip, scale, NaN policy, delay, history, concatenate."""

import copy
from typing import Any

import pytest
import torch
from mjlab_core.buffers import HistoryBuffer
from mjlab_core.errors import ConfigError, DivergedError, MjlabError
from mjlab_managers import (
  ConstantNoiseCfg,
  GaussianNoiseCfg,
  ManagerTermBase,
  NoiseModelWithAdditiveBiasCfg,
  ObservationGroupCfg,
  ObservationManager,
  ObservationTermCfg,
  UniformNoiseCfg,
)


def values(env: Any, *, columns: int = 5) -> torch.Tensor:
  return env.values[:, :columns]


def term(columns: int = 5, **options: Any) -> ObservationTermCfg:
  return ObservationTermCfg(values, params={"columns": columns}, **options)


def manager_of(
  env: Any, options: dict[str, Any] | None = None, /, **terms: ObservationTermCfg | None
) -> ObservationManager:
  """Return a manager with one group, "g", which has these options and terms."""
  return ObservationManager({"g": ObservationGroupCfg(terms=terms, **(options or {}))}, env)


def one(env: Any, **options: Any) -> ObservationManager:
  return manager_of(env, {"corrupt": True}, t=term(2, **options))


def tensor(observation: Any) -> torch.Tensor:
  assert isinstance(observation, torch.Tensor)
  return observation.clone()


def seen(manager: ObservationManager, *args: Any, **kwargs: Any) -> torch.Tensor:
  return tensor(manager.compute(*args, **kwargs)["g"])


class TestOrder:
  def test_noise_then_clip_then_scale(self, env):
    env.values[:] = 1.0
    # 1 + 4 = 5, clipped to 3, times 10. Any other order gives another number.
    manager = one(env, noise=ConstantNoiseCfg(bias=4.0), clip=(-3.0, 3.0), scale=10.0)
    assert (seen(manager) == 30.0).all()

  def test_infinity_is_clipped_before_the_nan_policy_and_nan_becomes_zero_after_the_scale(self, env, logged):
    env.values[0, 0], env.values[1, 0] = torch.inf, torch.nan
    manager = one(env, clip=(-3.0, 3.0), scale=2.0)
    got = seen(manager)
    assert got[0, 0] == 6.0
    assert got[1, 0] == 0.0
    assert logged(manager) == {"Nonfinite/observation/g/t": 1.0}
    manager.clear_log()
    env.values[1, 0] = 0.0
    manager.compute()
    assert str(logged(manager)["Nonfinite/observation/g/t"]) == "nan"
    # Only worlds that are observed count.
    env.values[1, 0] = torch.nan
    manager.compute(env.mask(2), env.mask(2))
    assert str(logged(manager)["Nonfinite/observation/g/t"]) == "nan"

  def test_delay_comes_before_history_and_sanitised_frames_enter_it(self, env):
    manager = one(env, delay_min_lag=1, delay_max_lag=1, history_length=2)
    frames = []
    for step in range(4):
      env.values[:] = float(step) if step != 1 else torch.nan
      frames.append(seen(manager)[0].tolist())
    # Delayed by one: 0 0 (nan->)0 2; windows of two, oldest first, two columns each.
    assert frames == [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 2, 2]]

  def test_terms_are_concatenated_in_order_in_float32(self, make_env):
    env = make_env(dtype=torch.float64)
    manager = manager_of(env, b=term(3, scale=2.0), none=None, a=term(1))
    got = seen(manager)
    assert got.dtype is torch.float32
    assert torch.equal(got, torch.cat([env.values[:, :3] * 2, env.values[:, :1]], 1).float())
    assert manager.active_terms == {"g": ["b", "a"]}
    assert manager.group_obs_dim == {"g": (4,)}
    assert manager.group_obs_term_dim == {"g": [(3,), (1,)]}
    assert manager.group_obs_concatenate == {"g": True}


class TestNoise:
  def test_uniform_noise_stays_in_its_range_and_only_corrupted_groups_have_it(self, make_env):
    env = make_env(4000)
    terms: Any = {"quiet": term(2), "loud": term(1, noise=UniformNoiseCfg(n_min=-0.5, n_max=1.5))}
    env.values[:] = 0.0
    groups = {name: ObservationGroupCfg(corrupt=name == "actor", terms=terms) for name in ("actor", "critic")}
    actor, critic = map(tensor, ObservationManager(groups, env).compute().values())
    assert (critic == 0).all()
    assert (actor[:, :2] == 0).all()
    noise = actor[:, 2]
    assert noise.min() >= -0.5
    assert noise.max() <= 1.5
    assert noise.mean() == pytest.approx(0.5, abs=0.05)
    assert noise.std() == pytest.approx(2 / 12**0.5, rel=0.05)

  @pytest.mark.parametrize(("operation", "expected"), [("add", 3.0 + 2.0), ("scale", 3.0 * 2.0), ("abs", 2.0)])
  def test_operations_hold_on_their_own_columns(self, env, operation, expected):
    env.values[:] = 3.0
    noisy, added = ConstantNoiseCfg(bias=2.0, operation=operation), ConstantNoiseCfg(bias=(1.0, 2.0))
    manager = manager_of(env, {"corrupt": True}, n=term(1, noise=noisy), plain=term(1), add=term(2, noise=added))
    assert seen(manager)[0].tolist() == [expected, 3.0, 4.0, 5.0]

  def test_gaussian_noise_has_its_moments(self, make_env):
    env = make_env(8000)
    env.values[:] = 0.0
    got = seen(one(env, noise=GaussianNoiseCfg(mean=1.0, std=(0.1, 2.0))))
    assert got.mean(0).tolist() == pytest.approx([1.0, 1.0], abs=0.1)
    assert got.std(0).tolist() == pytest.approx([0.1, 2.0], rel=0.05)

  def test_the_bias_keeps_its_distribution_over_many_resets_and_is_constant_between_them(self, make_env):
    env = make_env(2000)
    env.values[:] = 0.0
    bias = GaussianNoiseCfg(std=0.08)
    manager = one(env, noise=NoiseModelWithAdditiveBiasCfg(bias_noise_cfg=bias))
    everyone = torch.ones(2000, dtype=torch.bool)
    for _ in range(50):
      manager.reset(everyone)
    before = seen(manager)
    assert before.std() == pytest.approx(0.08, rel=0.1)
    assert torch.equal(seen(manager), before)
    manager.reset(env.mask(3))
    after = seen(manager)
    assert (after != before).any(1).nonzero().flatten().tolist() == [3]

  def test_a_bias_may_be_one_draw_for_all_components(self, env):
    env.values[:] = 0.0
    cfg = NoiseModelWithAdditiveBiasCfg(bias_noise_cfg=UniformNoiseCfg(), sample_bias_per_component=False)
    got = seen(one(env, noise=cfg))
    assert torch.equal(got[:, 0], got[:, 1])
    assert len(set(got[:, 0].tolist())) == env.num_envs


class TestTime:
  def test_history_is_oldest_to_newest_and_term_major_and_the_first_frame_fills_it(self, env):
    negative = ObservationTermCfg(lambda env: -env.values[:, :1], history_length=2)
    manager = manager_of(env, a=term(2, history_length=3), now=term(1), b=negative)
    env.values[:] = 1.0
    assert seen(manager)[0].tolist() == [1, 1, 1, 1, 1, 1, 1, -1, -1]
    env.values[:] = 2.0
    manager.compute()
    env.values[:] = 3.0
    assert seen(manager)[0].tolist() == [1, 1, 2, 2, 3, 3, 3, -2, -3]
    columns = [(layout.name, layout.columns) for layout in manager.layout("g")]
    assert columns == [("a", slice(0, 6)), ("now", slice(6, 7)), ("b", slice(7, 9))]

  def test_fresh_rows_show_the_new_frame_in_the_whole_window_and_the_others_go_on(self, env):
    manager = one(env, history_length=3)
    for step in range(3):
      env.values[:] = float(step)
      manager.compute()
    env.values[:] = 9.0
    got = seen(manager, fresh=env.mask(2))
    assert got[2].tolist() == [9.0] * 6
    assert got[0].tolist() == [1, 1, 2, 2, 9, 9]

  def test_a_group_history_overrides_the_terms(self, env):
    options = {"history_length": 2, "flatten_history_dim": False, "concatenate_terms": False}
    observation = manager_of(env, options, t=term(history_length=7)).compute()["g"]
    assert isinstance(observation, dict)
    assert observation["t"].shape == (4, 2, 5)

  @pytest.mark.parametrize("options", [{}, {"delay_hold_prob": 0.9}, {"delay_update_period": 5}])
  def test_a_delayed_term_is_never_younger_than_its_smallest_lag(self, make_env, options):
    env = make_env(64)
    manager = one(env, delay_min_lag=2, delay_max_lag=4, **options)
    last_reset = torch.full((64,), -100)
    for step in range(40):
      env.values[:] = float(step)
      fresh = torch.rand(64) < 0.1
      last_reset[fresh] = step
      got = seen(manager, fresh=fresh)[:, 0]
      age = step - got
      known = step - last_reset.clamp(min=0)
      assert (age >= known.clamp(max=2)).all()
      assert (age <= 4).all()

  def test_a_delay_that_is_held_is_drawn_for_each_world_at_its_resets_and_kept_between(self, make_env):
    env = make_env(3000)
    manager = one(env, delay_min_lag=1, delay_max_lag=3, delay_hold_prob=1.0)

    def ages(first: int, *fresh: torch.Tensor) -> torch.Tensor:
      """How old what is seen is in each world after four more steps [steps], (num_envs,)."""
      for step in range(first, first + 3):
        env.values[:] = float(step)
        seen(manager, *(fresh if step == first else ()))
      env.values[:] = float(first + 3)
      return first + 3 - seen(manager)[:, 0]

    before = ages(0)
    # Uniform: the chi-squared statistic of three counts exceeds 9.21 one time in a hundred.
    counts = before.long().bincount(minlength=4)
    assert counts[0] == 0
    assert float(((counts[1:] - 1000) ** 2 / 1000).sum()) < 9.21
    assert torch.equal(ages(4), before)
    fresh = torch.arange(3000) < 1500
    after = ages(8, fresh)
    assert torch.equal(after[~fresh], before[~fresh])
    changed = (after != before)[fresh].float().mean()
    assert float(changed) == pytest.approx(2 / 3, abs=0.05)

  def test_between_steps_nothing_advances(self, env):
    manager = one(env, history_length=3, delay_min_lag=1, delay_max_lag=2)
    manager.compute()
    before = tensor(manager.buffers["g"])
    env.values += 1
    assert torch.equal(tensor(manager.buffers["g"]), before)

  def test_buffers_stay_in_their_memory(self, env):
    manager = one(env, history_length=3)
    before = manager.buffers["g"]
    for fresh, advance in ((None, None), (env.mask(1), None), (env.mask(1), env.mask(1))):
      assert manager.compute(fresh, advance)["g"] is before

  @pytest.mark.parametrize("flatten", [True, False])
  def test_an_observation_of_nothing_has_a_history_of_nothing(self, env, flatten):
    past: dict[str, Any] = {"history_length": 3, "flatten_history_dim": flatten}
    terms: Any = {"none": term(0, **past), "some": term(2, **past)}
    groups = {
      "both": ObservationGroupCfg(terms=terms, concatenate_terms=flatten),
      "none": ObservationGroupCfg(terms={"none": terms["none"]}, history_length=5),
    }
    manager = ObservationManager(groups, env)
    manager.compute()
    env.values.add_(1.0)
    got = manager.compute()
    both = got["both"]
    some = both.unflatten(1, (3, 2)) if isinstance(both, torch.Tensor) else both["some"]
    assert torch.equal(some, torch.stack([env.values[:, :2] - 1.0] * 2 + [env.values[:, :2]], dim=1))
    assert tensor(got["none"]).shape == (4, 0)


class Window(ManagerTermBase):
  """The last two values, (N, 2), which the term itself keeps."""

  def __init__(self, env: Any) -> None:
    super().__init__(env)
    self.window = HistoryBuffer(2, self.num_envs, (1,), self.device)

  def __call__(self) -> torch.Tensor:
    self.window.append(self.env.values[:, :1])
    return self.window.read().flatten(1)


class TestIndependence:
  # As many worlds as the window is long, as it has ticks, and neither.
  @pytest.mark.parametrize("num_envs", [1, 2, 4])
  def test_a_window_of_a_terms_own_begins_with_the_frame_that_a_reset_shows(self, make_env, num_envs):
    env = make_env(num_envs)
    last = num_envs - 1
    manager = manager_of(env, w=ObservationTermCfg(Window))

    def observe(value: float, *args: torch.Tensor) -> list[list[float]]:
      env.values.fill_(value)
      return seen(manager, *args).tolist()

    for value in (1.0, 2.0, 3.0):
      observe(value)
    manager.reset(env.mask(last))
    assert observe(10.0, env.mask(last), env.mask(last)) == [[2.0, 3.0]] * last + [[10.0, 10.0]]
    assert observe(11.0) == [[3.0, 11.0]] * last + [[10.0, 11.0]]
    assert observe(12.0) == [[11.0, 12.0]] * num_envs


class TestEvaluation:
  def test_what_two_groups_have_in_common_is_evaluated_once_and_noised_separately(self, env):
    calls = []

    def counted(env: Any, *, gain: float = 1.0) -> torch.Tensor:
      calls.append(gain)
      return env.values * gain

    terms: Any = {
      "same": ObservationTermCfg(counted, noise=UniformNoiseCfg()),
      "other": ObservationTermCfg(counted, params={"gain": 2.0}),
    }
    groups = {name: ObservationGroupCfg(corrupt=name == "actor", terms=terms) for name in ("actor", "critic")}
    manager = ObservationManager(groups, env)
    calls.clear()
    manager.compute()
    assert sorted(calls) == [1.0, 2.0]
    # A parameter changed for one group splits them.
    manager.set_params("critic/other", gain=3.0)
    assert env.recaptures
    calls.clear()
    observation = manager.compute()
    assert sorted(calls) == [1.0, 2.0, 3.0]
    assert torch.equal(tensor(observation["critic"])[:, 5:], env.values * 3)
    assert torch.equal(tensor(observation["actor"])[:, 5:], env.values * 2)

  def test_scale_and_noise_replaced_on_the_host_take_effect_at_the_next_sync(self, env):
    manager = one(env, scale=2.0)
    manager.compute()
    manager.sync()
    assert env.recaptures == []
    manager.get_term_cfg("g", "t").scale = 3.0
    manager.sync()
    assert torch.equal(seen(manager), env.values[:, :2] * 3)
    assert "noise, clip, scale" in env.recaptures[0]

  def test_corruption_switched_off_on_the_host_leaves_the_plain_values(self, env):
    manager = one(env, noise=NoiseModelWithAdditiveBiasCfg(bias_noise_cfg=GaussianNoiseCfg()))
    noisy = seen(manager)
    manager.get_term_cfg("g", "t").scale = 2.0
    manager.sync()
    # The bias of the episode outlives the change of something else.
    torch.testing.assert_close(seen(manager), noisy * 2)
    manager.get_term_cfg("g").corrupt = False
    manager.sync()
    assert torch.equal(seen(manager), env.values[:, :2] * 2)

  def test_images_keep_their_shape_as_the_only_term_or_in_a_dict(self, env):
    def image(env: Any) -> torch.Tensor:
      return torch.arange(env.num_envs * 6.0).reshape(env.num_envs, 1, 2, 3)

    camera = ObservationTermCfg(image)
    assert torch.equal(seen(manager_of(env, camera=camera)), image(env))
    parts = manager_of(env, {"concatenate_terms": False}, camera=camera, v=term()).compute()["g"]
    assert isinstance(parts, dict)
    assert torch.equal(parts["camera"], image(env))
    assert torch.equal(parts["v"], env.values)
    with pytest.raises(ConfigError, match=r"'g/camera': shape \(1, 2, 3\) cannot be concatenated"):
      manager_of(env, camera=camera, v=term())

  def test_the_error_policy_names_term_and_worlds(self, env):
    manager = manager_of(env, {"nan_policy": "error"}, t=term())
    manager.compute()
    env.values[2, 1] = torch.nan
    with pytest.raises(DivergedError, match="'g/t' is NaN or infinite in 1 worlds: 2"):
      manager.compute()

  def test_a_disabled_policy_lets_nan_through_beside_a_group_that_does_not(self, env, logged):
    groups = {
      "raw": ObservationGroupCfg(terms={"t": term()}, nan_policy="disabled"),
      "clean": ObservationGroupCfg(terms={"t": term()}),
    }
    env.values[2, 1] = torch.nan
    manager = ObservationManager(groups, env)
    got = manager.compute()
    assert tensor(got["raw"])[2, 1].isnan()
    assert tensor(got["clean"])[2, 1] == 0.0
    assert logged(manager)["Nonfinite/observation/clean/t"] == 1.0
    assert str(logged(manager)["Nonfinite/observation/raw/t"]) == "nan"

  @pytest.mark.parametrize(
    ("options", "said"),
    [
      ({"clip": (1.0, -1.0)}, "clip must not fall"),
      ({"scale": (1.0, 2.0, 3.0)}, "scale: 3 numbers for 2 components"),
      ({"clip": (1.0,)}, "clip must have 2 elements"),
      ({"scale": float("nan")}, "scale must be a number, got nan"),
      ({"delay_min_lag": 3, "delay_max_lag": 1}, "needs delay_min_lag <= delay_max_lag, got 3 and 1"),
      ({"delay_min_lag": -1}, "delay_min_lag must not be negative"),
      ({"delay_max_lag": 1.5}, "delay_max_lag must be a whole number, got 1.5"),
      ({"delay_max_lag": 3, "delay_update_period": 0.5}, "delay_update_period must be a whole number"),
      ({"history_length": -1}, "history_length must not be negative"),
      ({"history_length": None}, "history_length must be a whole number, got None"),
      ({"noise": GaussianNoiseCfg(std=float("nan"))}, "std must be a number"),
      ({"noise": ConstantNoiseCfg(bias=float("inf"))}, "finite"),
      ({"noise": 0.1}, "expected a NoiseCfg or a NoiseModelCfg, got float 0.1"),
      ({"noise": UniformNoiseCfg(n_min=1.0, n_max=-1.0)}, "must not fall"),
      ({"noise": UniformNoiseCfg(n_min=(0.0,) * 3)}, "3 numbers for 2 components"),
      ({"noise": GaussianNoiseCfg(std=-1.0)}, "std must not be negative"),
      ({"noise": ConstantNoiseCfg(operation="mul")}, "operation 'mul' does not exist"),  # type: ignore
    ],
  )
  def test_wrong_options_are_errors_at_build(self, env, options, said):
    with pytest.raises(ConfigError, match=f"(?s)g/t.*{said}"):
      one(env, **options)

  def test_a_history_of_a_group_that_is_no_count_is_an_error_at_build(self, env):
    with pytest.raises(ConfigError, match="group 'g': history_length must not be negative, got -1"):
      manager_of(env, {"history_length": -1}, t=term())

  def test_a_replaced_option_that_is_wrong_is_an_error_until_it_is_replaced_again(self, env):
    manager = one(env, scale=2.0)
    live = manager.get_term_cfg("g", "t")
    live.scale = (1.0, 2.0, 3.0)
    for _ in range(2):
      with pytest.raises(ConfigError, match="scale: 3 numbers for 2 components") as raised:
        manager.sync()
      assert len(raised.value.problems) == 1
    live.scale = 3.0
    manager.sync()
    torch.testing.assert_close(seen(manager), 3.0 * env.values[:, :2])

  def test_configs_of_built_terms_are_read_only_except_for_live_fields(self, env):
    manager = one(env, noise=UniformNoiseCfg(), history_length=2)
    group, term = manager.get_term_cfg("g"), manager.get_term_cfg("g", "t")
    for change in (
      lambda: setattr(term, "history_length", 3),
      lambda: setattr(term.noise, "n_min", 0.0),
      lambda: term.params.update(columns=3),
      lambda: group.terms.clear(),
    ):
      with pytest.raises(MjlabError, match=r"ObservationManager: .*'g"):
        change()
    term.scale, group.corrupt = 2.0, False
    manager.sync()
    assert torch.equal(seen(manager)[:, 2:], env.values[:, :2] * 2)
    copied = copy.deepcopy(term)
    copied.history_length, copied.params["columns"] = 3, 3

  def test_a_term_without_a_component_axis_is_an_error_at_build(self, env):
    with pytest.raises(ConfigError, match="at least two dimensions"):
      manager_of(env, t=ObservationTermCfg(lambda env: env.values[:, 0]))

  def test_a_step_asks_the_device_nothing_and_needs_few_operations(self, env, dispatched):
    columns: Any = {f"t{i}": term(scale=2.0, noise=UniformNoiseCfg()) for i in range(20)}
    groups = {name: ObservationGroupCfg(corrupt=name == "actor", terms=columns) for name in ("actor", "critic")}
    flat, mask = ObservationManager(groups, env), env.mask(1, 3)
    assert len(dispatched(lambda: flat.compute(mask))) <= 12
