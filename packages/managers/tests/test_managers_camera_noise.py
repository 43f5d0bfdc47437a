"""Noise of cameras: effects on colours and depth, world by world."""

from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_managers import CameraNoiseCfg, ObservationGroupCfg, ObservationManager, ObservationTermCfg

# Three colours, depth, validity.
SHAPE = (5, 16, 12)
RGBD: dict[str, Any] = {"color": (0, 1, 2), "depth": 3, "lost": (4,)}


class Images:
  """The images of all worlds, (N, *SHAPE), as a term."""

  def __init__(self, num_envs: int, level: float = 0.5) -> None:
    self.values = torch.full((num_envs, *SHAPE), level)

  def __call__(self, env: Any) -> torch.Tensor:
    return self.values.clone()


def manager_of(env: Any, noise: CameraNoiseCfg, level: float = 0.5, *, corrupt: bool = True) -> ObservationManager:
  term = ObservationTermCfg(Images(env.num_envs, level), noise=noise)
  return ObservationManager({"camera": ObservationGroupCfg(corrupt=corrupt, terms={"image": term})}, env)


def seen(manager: ObservationManager, *args: Any) -> torch.Tensor:
  images = manager.compute(*args)["camera"]
  assert isinstance(images, torch.Tensor)
  return images.clone()


def distance_from_uniform(values: torch.Tensor, lo: float, hi: float) -> float:
  """Kolmogorov and Smirnov's statistic times the root of the number of values; above 1.63 one time in a hundred."""
  share = ((values.double() - lo) / (hi - lo)).sort().values
  steps = torch.arange(len(share) + 1, dtype=torch.float64) / len(share)
  return float(torch.maximum(steps[1:] - share, share - steps[:-1]).max()) * len(share) ** 0.5


def test_every_world_has_a_separate_exposure_within_the_ranges(make_env) -> None:
  env = make_env(3000)
  quarter = 0.25
  for name, lo, hi, undo in (
    ("gain", 0.6, 1.5, lambda y: y / quarter),
    ("gamma", 0.7, 1.4, lambda y: y.log() / torch.tensor(quarter).log()),
    ("bias", -0.1, 0.2, lambda y: y - quarter),
  ):
    noise: Any = {name: (lo, hi)}
    images = seen(manager_of(env, CameraNoiseCfg(**RGBD, **noise), quarter))
    # One value for all pixels of all colours of a world, and depth is none.
    assert (images[:, :3].flatten(1) == images[:, :1, :1, 0].flatten(1)).all()
    assert (images[:, 3:] == quarter).all()
    assert distance_from_uniform(undo(images[:, 0, 0, 0]), lo, hi) < 1.63


def test_colours_are_gain_times_a_power_plus_bias_and_never_leave_their_range(env) -> None:
  fixed = CameraNoiseCfg(**RGBD, gain=(1.2, 1.2), gamma=(1.5, 1.5), bias=(0.05, 0.05))
  manager = manager_of(env, fixed)
  ramp = torch.linspace(0.0, 1.0, 12).expand(4, 3, 16, 12)
  manager.get_term_cfg("camera", "image").func.values[:, :3] = ramp
  torch.testing.assert_close(seen(manager)[:, :3], (1.2 * ramp**1.5 + 0.05).clamp(0.0, 1.0))


def test_pixels_flicker_as_much_as_their_world_does(make_env) -> None:
  env = make_env(600)
  manager = manager_of(env, CameraNoiseCfg(**RGBD, color_std=(0.01, 0.05)))
  one, two = seen(manager)[:, :3].flatten(1), seen(manager)[:, :3].flatten(1)
  assert distance_from_uniform(one.std(1), 0.01, 0.05) < 1.63
  # Frames differ, worlds keep their level, and nothing is biased.
  centred = (one - 0.5) / one.std(1, keepdim=True), (two - 0.5) / two.std(1, keepdim=True)
  assert abs(float((centred[0] * centred[1]).mean())) < 0.01
  assert float((one.std(1) / two.std(1) - 1.0).abs().mean()) < 0.05
  assert abs(float(one.mean()) - 0.5) < 1e-3


def test_noise_of_depth_grows_with_its_square_and_what_is_far_stays_far(make_env) -> None:
  env = make_env(400)
  manager = manager_of(env, CameraNoiseCfg(**RGBD, depth_std=(0.1, 0.1)))
  image = manager.get_term_cfg("camera", "image").func.values
  image[:, 3, :8], image[:, 3, 8:], image[:, 3, 15] = 0.2, 0.6, 1.0
  depth = seen(manager)[:, 3]
  assert float(depth[:, :8].std()) == pytest.approx(0.1 * 0.2**2, rel=0.02)
  assert float(depth[:, 8:15].std()) == pytest.approx(0.1 * 0.6**2, rel=0.02)
  assert float(depth[:, 8:15].mean()) == pytest.approx(0.6, abs=1e-3)
  assert (depth[:, 15] == 1.0).all()


def test_depth_comes_in_steps_of_its_inverse(env) -> None:
  manager = manager_of(env, CameraNoiseCfg(**RGBD, disparity_step=(0.1, 0.1)))
  ramp = torch.linspace(0.02, 1.0, 16 * 12).reshape(16, 12)
  manager.get_term_cfg("camera", "image").func.values[:, 3] = ramp
  depth = seen(manager)[0, 3]
  steps = 1.0 / depth / 0.1
  torch.testing.assert_close(steps, steps.round(), rtol=0.0, atol=1e-3)
  # Off by half a step at most, which is more the farther it is.
  assert ((1.0 / depth - 1.0 / ramp).abs() <= 0.05 + 1e-4).all()
  assert depth.unique().numel() < ramp.numel()
  assert (depth[ramp > 0.8].unique().diff() > 4 * depth[ramp < 0.3].unique().diff().median()).all()


def test_holes_read_far_are_marked_and_as_many_as_asked_for(make_env) -> None:
  env = make_env(1500)
  manager = manager_of(env, CameraNoiseCfg(**RGBD, hole_share=(0.0, 0.4), hole_size=1))
  manager.get_term_cfg("camera", "image").func.values[:, 4] = 1.0
  images = seen(manager)
  depth, valid = images[:, 3], images[:, 4]
  # What is lost is lost in both, what is left is as it was, and colours have no holes.
  assert torch.equal(valid == 0.0, depth == 1.0)
  assert torch.equal(valid == 1.0, depth == 0.5)
  assert (images[:, :3] == 0.5).all()
  share = (valid == 0.0).float().flatten(1).mean(1)
  assert float(share.mean()) == pytest.approx(0.2, abs=0.01)
  assert float(share.min()) < 0.02
  assert 0.35 < float(share.max()) < 0.55
  again = seen(manager)[:, 4]
  assert float((again == valid).float().mean()) < 0.9
  # The level of a world stays.
  assert float(torch.corrcoef(torch.stack([share, (again == 0.0).float().flatten(1).mean(1)]))[0, 1]) > 0.9


def test_holes_are_squares_that_begin_anywhere(make_env) -> None:
  env = make_env(2000)
  manager = manager_of(env, CameraNoiseCfg(**RGBD, hole_share=(0.2, 0.2), hole_size=4))
  lost = (seen(manager)[:, 3] == 1.0).float()
  # Every pixel as often as any other, and neighbours together.
  assert float((lost.mean(0) - 0.2).abs().max()) < 0.05
  beside = (lost[:, :, 1:] * lost[:, :, :-1]).mean() / 0.2
  assert float(beside) == pytest.approx(3 / 4 + 1 / 4 * 0.2, abs=0.02)
  edges = (lost[:, :, 1:] != lost[:, :, :-1]).float().mean((0, 1))
  assert float(edges.max() / edges.min()) < 1.3


def everything() -> CameraNoiseCfg:
  return CameraNoiseCfg(
    **RGBD,
    gain=(0.7, 1.3),
    gamma=(0.8, 1.2),
    bias=(-0.1, 0.1),
    color_std=(0.0, 0.02),
    depth_std=(0.0, 0.02),
    disparity_step=(0.0, 0.02),
    hole_share=(0.0, 0.1),
  )


def test_without_corruption_images_are_as_they_were_and_nothing_is_drawn(env) -> None:
  before = env.rng.get_state()
  manager = manager_of(env, everything(), corrupt=False)
  assert (seen(manager) == 0.5).all()
  manager.reset(env.mask(1))
  assert torch.equal(env.rng.get_state(), before)
  # Switched on and off while it runs.
  manager.get_term_cfg("camera").corrupt = True
  manager.sync()
  assert not (seen(manager) == 0.5).all()
  manager.get_term_cfg("camera").corrupt = False
  manager.sync()
  assert (seen(manager) == 0.5).all()
  assert len(env.recaptures) == 2


def test_a_reset_changes_the_cameras_of_its_worlds_and_no_other(env) -> None:
  manager = manager_of(env, CameraNoiseCfg(**RGBD, gain=(0.7, 1.3), gamma=(0.8, 1.2), bias=(-0.1, 0.1)))
  before = seen(manager)
  assert len(before[:, 0, 0, 0].unique()) == 4
  assert torch.equal(seen(manager), before)
  manager.reset(env.mask(2))
  after = seen(manager)
  assert torch.equal(after[[0, 1, 3]], before[[0, 1, 3]])
  assert not torch.equal(after[2], before[2])
  # Observing some worlds leaves what the others were shown.
  manager.reset(env.mask(1))
  shown = seen(manager, env.mask(1), env.mask(1))
  assert torch.equal(shown[[0, 2, 3]], after[[0, 2, 3]])


def test_a_change_of_something_else_keeps_the_cameras_and_another_config_makes_new_ones(env) -> None:
  manager = manager_of(env, CameraNoiseCfg(**RGBD, gain=(0.5, 0.9)))
  before, live = seen(manager), manager.get_term_cfg("camera", "image")
  live.scale = 2.0
  manager.sync()
  torch.testing.assert_close(seen(manager), 2.0 * before)
  live.noise = CameraNoiseCfg(**RGBD, gain=(0.1, 0.2))
  manager.sync()
  assert float(seen(manager)[:, :3].max()) <= 0.2


def test_a_step_asks_the_device_nothing(env, dispatched) -> None:
  manager = manager_of(env, everything())
  mask = env.mask(1, 3)
  dispatched(lambda: manager.reset(mask))
  assert len(dispatched(lambda: manager.compute(mask))) < 60


@pytest.mark.parametrize(
  ("options", "said"),
  [
    ({"color": (3, 4, 5)}, "color: channels must be neighbours from 0..4"),
    ({"color": (0, 2)}, "color: channels must be neighbours"),
    ({"depth": 7}, "depth: channels must be neighbours from 0..4"),
    ({"gain": (0.5, 1.0)}, "gain needs color, which names no channel"),
    ({"color": (0,), "hole_share": (0.0, 0.1)}, "hole_share needs depth, which names no channel"),
    ({"color": (0,), "gain": (1.2, 0.8)}, "gain"),
    ({"depth": 3, "hole_share": (0.0, 1.2)}, "hole_share"),
    ({"depth": 3, "hole_size": 0}, "hole_size must be at least 1, got 0"),
  ],
)
def test_wrong_options_are_errors_at_build(env, options: dict[str, Any], said: str) -> None:
  with pytest.raises(ConfigError, match=f"(?s)'camera/image': .*{said}"):
    manager_of(env, CameraNoiseCfg(**options))


def test_noise_of_cameras_is_for_images(env) -> None:
  term = ObservationTermCfg(lambda env: env.values, noise=CameraNoiseCfg())
  with pytest.raises(ConfigError, match=r"needs images \(channels, height, width\), not \(5,\)"):
    ObservationManager({"g": ObservationGroupCfg(corrupt=True, terms={"t": term})}, env)
