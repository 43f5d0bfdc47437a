"""Images of many worlds, each with a separate camera, light and table."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from manipulation_worlds import image_cfg, images, lift, place
from mjlab_dr import agreement, drawn_values
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg, mdp
from mjlab_manipulation import (
  lift_cube_depth_env,
  lift_cube_env,
  lift_cube_rgb,
  lift_cube_rgb_env,
  multi_cube_seg_env,
  plain_images,
  randomize_images,
)
from mjlab_manipulation.image_randomization import IMAGE_EVENTS
from mjlab_manipulation.lift import DECIMATION
from mjlab_sensors import CameraSensorCfg

pytestmark = pytest.mark.warp

Env = Callable[[], ManagerBasedRlEnvCfg]


def randomised(make: Env) -> ManagerBasedRlEnvCfg:
  return randomize_images(make())


def small(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """A config with images of 8 by 8 pixels, which are drawn in no time."""
  camera: Any = cfg.scene.sensors["wrist_camera"]
  camera.width = camera.height = 8
  return cfg


def steps(env: ManagerBasedRlEnv, number: int) -> np.ndarray:
  """What is seen in each of some steps in which the arm moves, (number, num_envs, channels, height, width)."""
  seen = []
  for step in range(number):
    camera: Any = env.step(torch.full((env.num_envs, 7), 0.3 if step % 4 < 2 else -0.3))[0]["camera"]
    seen.append(camera.numpy().copy())
  return np.array(seen)


def test_all_that_differs_is_drawn_as_asked_and_for_each_world_alone() -> None:
  env, _ = lift(192, lambda: small(randomised(lift_cube_rgb_env)))
  drawn: dict[str, np.ndarray] = {}
  for name in env.event_manager.active_terms:
    term = env.event_manager.get_term_cfg(name).func
    if not isinstance(term, mdp.randomize) or not (name.startswith(IMAGE_EVENTS) or name == "cube_color"):
      continue
    values = drawn_values(term.field)
    for axis, asked in zip(values, term.field.distributions.values(), strict=True):
      assert agreement(values[axis], asked) > 1e-3, (name, axis)
    alone = list(values)[:1] if term.field.cfg.isotropic else list(values)
    drawn |= {f"{name} {axis}": values[axis][:, 0].numpy() for axis in alone}
  assert len(drawn) >= 20
  # They are independent: 0.25 is three and a half standard deviations.
  correlation = np.corrcoef(np.array(list(drawn.values())))
  assert np.abs(correlation - np.eye(len(drawn))).max() < 0.3
  # Neighbouring worlds have nothing in common either.
  for name, values in drawn.items():
    assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 0.3, name


def test_worlds_see_one_scene_each_in_its_own_way() -> None:
  def one_scene() -> ManagerBasedRlEnvCfg:
    cfg = randomised(lift_cube_rgb_env)
    cfg.scene.env_spacing = 0.0
    cfg.events["cube_color"] = None
    return cfg

  env, _ = lift(4, one_scene)
  place(env, np.tile([0.3, 0.0, 0.02], (4, 1)))
  seen = images(env)
  assert all(np.abs(seen[i] - seen[j]).mean() > 0.02 for i in range(4) for j in range(i))
  assert seen.min() >= 0.0
  assert seen.max() <= 1.0
  # All of it in every world: what the cube hides of the ground is at another place in each, for cameras differ.
  camera = env.sim.mj_model.camera("robot/camera_d405").id
  assert np.abs(env.sim.model.cam_pos[:, camera].numpy()).max() <= 0.005


def test_each_of_them_alone_changes_what_is_seen() -> None:
  def clean() -> ManagerBasedRlEnvCfg:
    cfg = randomised(lift_cube_rgb_env)
    image = image_cfg(cfg)
    image.noise, image.delay_max_lag = None, 0
    cfg.scene.env_spacing = 0.0
    return cfg

  env, _ = lift(4, clean)
  place(env, np.tile([0.3, 0.0, 0.02], (4, 1)))
  events = [name for name in env.event_manager.active_terms if name.startswith(IMAGE_EVENTS) or name == "cube_color"]
  terms = {name: env.event_manager.term(name) for name in events}
  fields = ("cam_pos", "cam_quat", "cam_intrinsic", "cam_fovy", "light_pos", "light_diffuse", "geom_rgba")
  fields += ("mat_texid", "mat_rgba", "mat_texrepeat")
  everywhere = torch.ones(4, dtype=torch.bool)
  changed = {}
  for name, term in terms.items():
    # All worlds as compiled, but for what this one draws.
    for field in fields:
      values = env.sim.model[field]
      values.copy_(torch.as_tensor(getattr(env.sim.mj_model, field)).reshape(values.shape[1:]).expand_as(values))
    assert np.ptp(images(env), axis=0).max() == 0.0
    term(everywhere)
    seen = images(env)
    changed[name] = float(np.abs(seen - seen[:1]).max())
  assert len(changed) == 10
  assert min(changed.values()) > 0.01, changed


@pytest.mark.parametrize("make", [lift_cube_rgb_env, multi_cube_seg_env])
def test_a_reset_changes_what_its_worlds_see_and_no_bit_of_the_others(make: Env) -> None:
  env, _ = lift(4, lambda: randomised(make))
  steps(env, 3)
  before: Any = env.get_observations()["camera"]
  before = before.clone()
  looks = [env.sim.model[name].clone() for name in ("cam_pos", "cam_quat", "cam_intrinsic")]
  env.reset(env_ids=[1])
  after: Any = env.get_observations()["camera"]
  assert (after != before).flatten(1).any(1).tolist() == [False, True, False, False]
  # The camera of a world never changes.
  for old, name in zip(looks, ("cam_pos", "cam_quat", "cam_intrinsic"), strict=True):
    assert torch.equal(env.sim.model[name], old)


@pytest.mark.parametrize("make", [lift_cube_rgb_env, lift_cube_depth_env])
def test_without_it_images_are_what_they_are_in_the_plain_task(make: Env) -> None:
  def taken_back() -> ManagerBasedRlEnvCfg:
    return plain_images(randomised(make))

  (plain, _), (back, _) = lift(3, make), lift(3, taken_back)
  assert not any(name.startswith(IMAGE_EVENTS) for name in back.cfg.events)
  place(plain, np.tile([0.3, 0.0, 0.02], (3, 1)))
  place(back, np.tile([0.3, 0.0, 0.02], (3, 1)))
  np.testing.assert_allclose(images(back), images(plain), atol=1e-6)


def test_watching_is_without_it() -> None:
  task: Any = lift_cube_rgb()
  cfg = task.play(randomize_images(task.env))
  image = image_cfg(cfg)
  assert (image.noise, image.delay_max_lag) == (None, 0)
  assert not any(name.startswith(IMAGE_EVENTS) for name in cfg.events)


def test_images_come_as_late_as_their_world_drew_and_stay_so() -> None:
  def late() -> ManagerBasedRlEnvCfg:
    cfg = lift_cube_depth_env()
    whole = randomised(lift_cube_depth_env)
    mine, theirs = image_cfg(cfg), image_cfg(whole)
    mine.delay_max_lag, mine.delay_hold_prob = theirs.delay_max_lag, theirs.delay_hold_prob
    return small(cfg)

  (prompt, _), (delayed, _) = lift(16, lambda: small(lift_cube_depth_env())), lift(16, late)
  for env in (prompt, delayed):
    place(env, np.tile([0.3, 0.0, 0.02], (16, 1)))
  at_once, later = steps(prompt, 8), steps(delayed, 8)
  lags = []
  for world in range(16):
    fits = [lag for lag in range(3) if np.array_equal(later[3:, world], at_once[3 - lag : 8 - lag, world])]
    assert len(fits) == 1
    lags += fits
  assert set(lags) == {0, 1, 2}


def test_a_slower_camera_may_be_late_by_whole_periods_of_its_own() -> None:
  def slow(lag: int) -> ManagerBasedRlEnvCfg:
    cfg = lift_cube_depth_env()
    camera, image = cfg.scene.sensors["wrist_camera"], image_cfg(cfg)
    assert isinstance(camera, CameraSensorCfg)
    camera.update_period = 3 * DECIMATION
    image.delay_min_lag = image.delay_max_lag = lag
    return small(cfg)

  (prompt, _), (delayed, _) = lift(2, lambda: slow(0)), lift(2, lambda: slow(3))
  at_once, later = steps(prompt, 12), steps(delayed, 12)
  is_new = (at_once[1:] != at_once[:-1]).reshape(11, -1).any(1)
  assert is_new.tolist() == [step % 3 == 2 for step in range(1, 12)]
  np.testing.assert_array_equal(later[3:], at_once[:-3])


def test_holes_are_far_not_valid_and_not_of_the_object() -> None:
  def with_validity() -> ManagerBasedRlEnvCfg:
    cfg = multi_cube_seg_env()
    image_cfg(cfg).params["channels"] = ("depth", "valid", "object")
    randomize_images(cfg)
    noise: Any = image_cfg(cfg).noise
    assert (noise.depth, noise.lost) == (0, (1, 2))
    noise.hole_share = (0.3, 0.3)
    return cfg

  env, _ = lift(6, with_validity)
  depth, valid, mask = images(env).transpose(1, 0, 2, 3)
  # From the pose in which the arm begins, all that is there is within reach of the camera.
  assert np.array_equal(valid == 0.0, depth == 1.0)
  assert (1.0 - valid).mean() == pytest.approx(0.3, abs=0.05)
  assert not mask[depth == 1.0].any()
  assert mask.any(axis=(1, 2)).all()


def test_what_cannot_be_randomised_is_said() -> None:
  with pytest.raises(ValueError, match="which does not exist"):
    randomize_images(lift_cube_env())
  cfg = lift_cube_rgb_env()
  cfg.scene.spec_fn = lambda spec: None
  with pytest.raises(ValueError, match="the scene has a spec_fn"):
    randomize_images(cfg)
