"""What the policies that see are given, against the geometry of the scene."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from manipulation_worlds import image_cfg, images, in_mujoco, lift
from mjlab_core.errors import ConfigError
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_manipulation import (
  lift_cube_depth,
  lift_cube_depth_env,
  lift_cube_rgb,
  lift_cube_rgb_env,
  lift_objects_depth,
  lift_objects_depth_env,
  lift_objects_rgb,
  lift_objects_rgb_env,
  multi_cube_seg,
  multi_cube_seg_env,
)
from mjlab_manipulation.lift import COMMAND
from mjlab_manipulation.objects import CUBES
from mjlab_rl import Console, train

pytestmark = pytest.mark.warp

Env = Callable[[], ManagerBasedRlEnvCfg]


def project(env: ManagerBasedRlEnv, world: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
  """Column and row of points in the image, (n, 2) [pixel], and how far ahead of the lens they are, (n,) [m]."""
  data, model = in_mujoco(env, world), env.sim.mj_model
  camera = data.camera("robot/camera_d405")
  local = (points - camera.xpos) @ camera.xmat.reshape(3, 3)
  focal = 16.0 / np.tan(0.5 * np.radians(model.cam_fovy[camera.id]))
  return 16.0 + focal * local[:, :2] * [1.0, -1.0] / -local[:, 2:], -local[:, 2]


@pytest.mark.parametrize(
  ("make", "channels", "poses"),
  [
    (lift_cube_depth_env, 1, 29),
    (lift_cube_rgb_env, 3, 29),
    (multi_cube_seg_env, 2, 29),
    (lift_objects_depth_env, 1, 38),
    (lift_objects_rgb_env, 3, 38),
  ],
)
def test_the_actor_has_images_and_the_critic_poses(make: Env, channels: int, poses: int) -> None:
  env, _ = lift(2, make)
  shapes = {group: tuple(v.shape[1:]) for group, v in env.get_observations().items() if isinstance(v, torch.Tensor)}
  assert shapes == {"actor": (26,), "critic": (poses,), "camera": (channels, 32, 32)}
  assert env.action_manager.total_action_dim == 7
  seen = images(env)
  assert seen.min() >= 0.0
  assert seen.max() <= 1.0


def test_depth_is_the_way_along_the_optical_axis() -> None:
  env, _ = lift(4, lift_cube_depth_env)
  seen = images(env)[:, 0]
  for world in range(4):
    centre = env.scene["cube"].data.root_link_pos_w[world].numpy()
    ((column, row),), (ahead,) = project(env, world, centre[None])
    # The cube's top is half an edge nearer than its centre.
    assert seen[world, int(row), int(column)] == pytest.approx((ahead - 0.02) / 0.5, abs=0.02)
    # Ground on the other side of the image.
    ground = in_mujoco(env, world).camera("robot/camera_d405").xpos * [1, 1, 0]
    ground[1] += 0.08 if centre[1] < ground[1] else -0.08
    ((column, row),), (ahead,) = project(env, world, ground[None])
    assert seen[world, int(row), int(column)] == pytest.approx(ahead / 0.5, abs=0.01)


def test_what_is_not_there_is_far_and_marked_as_such() -> None:
  def skyward() -> ManagerBasedRlEnvCfg:
    cfg = lift_cube_depth_env()
    image_cfg(cfg).params["channels"] = ("depth", "valid")
    return cfg

  env, _ = lift(2, skyward)
  robot = env.scene["robot"]
  # The wrist of the second arm looks over the horizon.
  position = robot.data.joint_pos.clone()
  position[1, 3] = 1.2
  robot.write_joint_state(position, torch.zeros_like(position))
  depth, valid = images(env).transpose(1, 0, 2, 3)
  raw = env.scene["wrist_camera"].data.depth[:, 0].numpy()
  missed = raw < 0.0
  assert not missed[0].any()
  assert missed[1].sum() > 100
  assert (depth[missed] == 1.0).all()
  assert (valid[missed] == 0.0).all()
  # Ground behind the cut-off is as far, and as little known.
  assert (depth[raw > 0.5] == 1.0).all()
  np.testing.assert_array_equal(valid, (raw >= 0.01) & (raw <= 0.5))


def first_hit(env: ManagerBasedRlEnv, world: int) -> tuple[np.ndarray, np.ndarray]:
  """Which cube the ray through the middle of each pixel meets first, -1 for none, and how far ahead [m], (32, 32)."""
  data, model = in_mujoco(env, world), env.sim.mj_model
  camera = data.camera("robot/camera_d405")
  focal = 16.0 / np.tan(0.5 * np.radians(model.cam_fovy[camera.id]))
  column, row = np.meshgrid(np.arange(32) + 0.5, np.arange(32) + 0.5)
  # One metre along the optical axis each.
  rays = np.stack([(column - 16.0) / focal, (16.0 - row) / focal, -np.ones((32, 32))], axis=-1)
  rays = rays @ camera.xmat.reshape(3, 3).T
  ahead, which = np.full((32, 32), np.inf), np.full((32, 32), -1)
  for number, name in enumerate(CUBES):
    cube = data.body(f"{name}/cube")
    axes = cube.xmat.reshape(3, 3)
    start, way = (camera.xpos - cube.xpos) @ axes, rays @ axes
    sides = np.stack([(-0.02 - start) / way, (0.02 - start) / way])
    enters, leaves = sides.min(0).max(-1), sides.max(0).min(-1)
    is_nearer = (enters < leaves) & (enters > 0.0) & (enters < ahead)
    ahead[is_nearer], which[is_nearer] = enters[is_nearer], number
  return which, ahead


def test_the_mask_is_where_rays_meet_the_cube_that_is_meant_first() -> None:
  env, term = lift(16, multi_cube_seg_env)
  depth, mask = images(env).transpose(1, 0, 2, 3)
  assert set(np.unique(mask)) == {0.0, 1.0}
  for world in range(16):
    which, ahead = first_hit(env, world)
    target = int(term.target[world])
    # Nothing but fingers may be nearer than a cube.
    is_free = depth[world] * 0.5 > ahead - 1e-3
    np.testing.assert_array_equal(mask[world] == 1.0, (which == target) & is_free)
    np.testing.assert_allclose(depth[world][(which >= 0) & is_free] * 0.5, ahead[(which >= 0) & is_free], atol=1e-4)
    assert mask[world].sum() > 8
  assert len(set(term.target.tolist())) == 3


def test_every_episode_draws_a_colour() -> None:
  env, _ = lift(6, lift_cube_rgb_env)
  geom = env.sim.mj_model.geom("cube/cube").id
  before = env.sim.model.geom_rgba[:, geom].numpy().copy()
  assert len(np.unique(before[:, :3])) == 18
  assert (before[:, 3] == 1.0).all()
  env.reset(env_ids=[2, 4])
  after = env.sim.model.geom_rgba[:, geom].numpy()
  changed = (before != after).any(1)
  assert changed.tolist() == [False, False, True, False, True, False]


def test_watching_shows_clean_images_and_training_runs(tmp_path: Path) -> None:
  for make in (lift_cube_depth, lift_cube_rgb, lift_objects_depth, lift_objects_rgb, multi_cube_seg):
    task: Any = make()
    assert not any(group.corrupt for group in task.play(make().env).observations.values() if group is not None)
    assert (task.agent.actor.hidden_dims, task.agent.max_iterations) == ((256, 256, 128), 3000)
    assert task.agent.obs_groups == {"actor": ("actor", "camera"), "critic": ("critic",)}
    task.env.scene.num_envs, task.env.seed = 4, 0
    task.agent.num_steps_per_env, task.agent.max_iterations, task.agent.algorithm.num_learning_epochs = 4, 1, 1
    console = Console("quiet")
    result = train(task, name="Seeing", make_env=ManagerBasedRlEnv, log_root=tmp_path, console=console)
    assert result.iterations == 1


@pytest.mark.parametrize(
  ("rnn_type", "sees"), [("gru", False), ("lstm", True)], ids=["critic of poses", "shared encoder"]
)
def test_a_policy_that_sees_and_remembers_is_trained(rnn_type: Any, sees: bool) -> None:
  task: Any = lift_cube_depth()
  task.agent.actor.rnn_type = rnn_type
  if sees:
    task.agent.critic = replace(task.agent.actor, distribution_cfg=None)
    task.agent.obs_groups["critic"] = ("critic", "camera")
    task.agent.algorithm.share_cnn_encoders = True
  task.env.scene.num_envs, task.env.seed = 4, 0
  task.agent.num_steps_per_env, task.agent.max_iterations, task.agent.algorithm.num_learning_epochs = 4, 2, 1
  result = train(task, name="Seeing", make_env=ManagerBasedRlEnv, log_root=None, console=Console("quiet"))
  assert result.iterations == 2


@pytest.mark.parametrize(
  ("params", "message"),
  [
    ({"channels": ("colour",)}, "'channels' 'colour' does not exist"),
    ({"channels": ("rgb",)}, "sensor 'wrist_camera': image 'rgb' does not exist"),
    ({"command": "lift"}, "lift_height"),
  ],
  ids=["channel", "data", "command"],
)
def test_bad_params_of_an_image_are_refused_at_build(params: dict[str, Any], message: str) -> None:
  def broken() -> ManagerBasedRlEnvCfg:
    cfg = multi_cube_seg_env()
    image_cfg(cfg).params.update(params)
    return cfg

  with pytest.raises(ConfigError, match=message):
    lift(2, broken)


def test_three_cubes_have_different_colours() -> None:
  env, term = lift(2, multi_cube_seg_env)
  colours = [env.sim.mj_model.geom(f"{name}/cube").rgba[:3] for name in CUBES]
  assert [int(np.argmax(colour)) for colour in colours] == [0, 1, 2]
  assert (term.cfg.start.x, term.cfg.goal.z) == ((0.25, 0.4), (0.2, 0.4))
  assert isinstance(term.cfg, type(env.cfg.commands[COMMAND]))
