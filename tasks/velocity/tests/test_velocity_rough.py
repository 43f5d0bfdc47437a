"""What only rough ground has: levels, bounds, contacts that end episodes, and the slope underfoot."""

from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_envs import ManagerBasedRlEnv
from mjlab_envs.mdp import contact_count, illegal_contact
from mjlab_scene import EntityCfg, TerrainLevels
from mjlab_terrain import TerrainGridCfg
from mjlab_velocity.mdp import plane_normal
from velocity_facts import TASKS
from velocity_oracle import fitted_normal
from velocity_rollout import make_env, started_env

GO1, G1 = "Mjlab-Velocity-Rough-Unitree-Go1", "Mjlab-Velocity-Rough-Unitree-G1"
KINDS = ("flat", "stairs_up", "stairs_down", "slope_up", "slope_down", "random_rough", "waves")


@pytest.fixture(scope="module")
def shared() -> ManagerBasedRlEnv:
  return make_env(40, task=GO1)


@pytest.fixture
def env(shared: ManagerBasedRlEnv) -> ManagerBasedRlEnv:
  shared.reset()
  return shared


def levels_of(env: ManagerBasedRlEnv) -> TerrainLevels:
  assert env.scene.terrain_levels is not None
  return env.scene.terrain_levels


def end_episodes(env: ManagerBasedRlEnv, walked: np.ndarray, command: np.ndarray) -> np.ndarray:
  """Levels after all episodes ended `walked` [m] from where they began, with these last commands, (worlds, 3)."""
  env.command_manager.get_command("twist").copy_(torch.tensor(command))
  angle = torch.arange(env.num_envs) * 2.4
  away = torch.tensor(walked)[:, None] * torch.stack([angle.cos(), angle.sin()], 1)
  env.sim.data.qpos[:, :2] = env.scene.env_origins[:, :2] + away
  env.curriculum_manager.compute(torch.ones(env.num_envs, dtype=torch.bool))
  return levels_of(env).levels.numpy().copy()


def test_levels_are_the_scenes_state_and_not_the_curriculums_even_with_a_world_for_each_type() -> None:
  env = make_env(len(KINDS), task=GO1)
  assert not env.curriculum_manager.state_dict()["_stateful_terms"]["terrain_levels"]


def post_spec() -> mujoco.MjSpec:
  return mujoco.MjSpec.from_string('<mujoco><worldbody><body name="post"><geom size=".1"/></body></worldbody></mujoco>')


def test_fixed_entities_move_with_their_world_to_another_tile() -> None:
  task: Any = TASKS[GO1].make()
  task.env.scene.num_envs, task.env.seed = 16, 7
  task.env.scene.entities["post"] = EntityCfg(spec_fn=post_spec)
  env = ManagerBasedRlEnv(task.play(task.env), device="cpu")
  before = env.scene.env_origins.clone()
  env.reset()
  assert not torch.equal(env.scene.env_origins, before)
  torch.testing.assert_close(env.scene["post"].data.root_link_pos_w, env.scene.env_origins)


def test_levels_follow_the_distance_walked_and_what_was_asked(env: ManagerBasedRlEnv) -> None:
  levels = levels_of(env)
  levels.levels.copy_(torch.arange(40) % 10)
  before = levels.levels.numpy().copy()
  env.episode_length_buf.fill_(1000)
  rng = np.random.default_rng(0)
  walked = rng.uniform(0.0, 8.0, 40)
  walked[:4] = 3.99, 4.01, 3.99, 4.01
  command = rng.uniform(-0.5, 0.5, (40, 3)).astype(np.float32)
  command[:2] = 0.0
  after = end_episodes(env, walked, command)
  asked = 0.5 * 20.0 * np.hypot(command[:, 0], command[:, 1])
  expected = np.where(walked > 4.0, before + 1, np.where(walked < asked, np.maximum(before - 1, 0), before))
  drawn = expected == 10
  assert (after[~drawn] == expected[~drawn]).all()
  assert drawn.any()
  assert (after[drawn] < 10).all()
  assert all(kind in set(np.sign(after - before)) for kind in (-1, 0, 1))
  # Worlds that moved begin on the new tile.
  terrain: Any = env.scene.terrain
  np.testing.assert_allclose(env.scene.env_origins.numpy(), terrain.origins[after, levels.columns.numpy()])


def test_the_first_reset_moves_no_world(env: ManagerBasedRlEnv) -> None:
  fresh = make_env(20, task=GO1)
  before = levels_of(fresh).levels.clone()
  fresh.reset()
  assert torch.equal(levels_of(fresh).levels, before)
  assert not fresh.episode_length_buf.any()
  walked, command = np.full(40, 6.0), np.zeros((40, 3), dtype=np.float32)
  kept = levels_of(env).levels.numpy().copy()
  assert (end_episodes(env, walked, command) == kept).all()


def test_mean_and_greatest_level_and_that_of_each_kind_of_ground_are_logged(env: ManagerBasedRlEnv) -> None:
  levels = levels_of(env)
  before = levels.columns.clone()
  # On the columns that worlds began on, and on others, as after a resume or an event that moves them.
  for columns in (before, before.roll(7)):
    env.drain_log()
    levels.levels.copy_(torch.arange(40) % 10)
    levels.columns.copy_(columns)
    env.episode_length_buf.fill_(1000)
    env.step(torch.zeros(40, 12))
    now = levels.levels.numpy()
    log = {key.rsplit("/", 1)[1]: value for key, value in env.drain_log().items() if "terrain_levels" in key}
    expected = {"mean": now.mean(), "max": now.max()}
    expected |= {kind: now[columns.numpy() == column].mean() for column, kind in enumerate(KINDS)}
    assert log == pytest.approx(expected, abs=1e-5)
  levels.columns.copy_(before)


def test_a_kind_of_ground_without_robots_logs_finite_values() -> None:
  env = started_env(2, task=GO1)
  env.episode_length_buf.fill_(1000)
  env.step(torch.zeros(2, 12))
  assert all(np.isfinite(value) for value in env.drain_log().values())


@pytest.mark.parametrize("task", [GO1, G1])
def test_episodes_are_truncated_thirty_centimetres_before_the_end_of_the_terrain(task: str) -> None:
  env = started_env(8, task=task)
  x, y = [59.6, 59.8, -59.6, -59.8, 0.0, 0.0, 0.0, 9.0], [0.0, 0.0, 47.6, 0.0, 47.6, 47.8, -47.6, -47.8]
  env.sim.data.qpos[:, :2] = torch.tensor([x, y]).double().T
  env.sim.data.qpos[:, 2] = 1.0
  _, _, terminated, truncated, _ = env.step(torch.zeros(8, len(TASKS[task].robot.joints)))
  assert truncated.tolist() == [False, True, False, True, False, True, False, True]
  assert not terminated.any()


class _Reading:
  """Stands in for an environment whose one sensor remembers these forces, (worlds, contacts, substeps) [N]."""

  def __init__(self, strengths: list[Any]) -> None:
    strength = torch.tensor(strengths, dtype=torch.float64)
    direction = torch.tensor([0.6, 0.0, -0.8], dtype=torch.float64)
    data = type("Data", (), {"force_history": strength[..., None] * direction})
    self.scene = {"touch": type("Sensor", (), {"data": data})}


def test_substeps_with_a_strong_contact_are_counted_however_many_there_are_in_each() -> None:
  env: Any = _Reading(
    [
      [[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]],
      [[9.99, 10.01, 9.99, 0.0], [9.99, 0.0, 0.0, 0.0]],
      [[20.0, 20.0, 0.0, 0.0], [0.0, 20.0, 20.0, 0.0]],
      [[500.0, 500.0, 500.0, 500.0], [500.0, 500.0, 500.0, 500.0]],
    ]
  )
  assert contact_count(env, sensor="touch").tolist() == [0.0, 1.0, 3.0, 4.0]
  assert illegal_contact(env, sensor="touch").tolist() == [False, True, True, True]
  assert contact_count(env, sensor="touch", threshold=100.0).tolist() == [0.0, 0.0, 0.0, 4.0]


def test_the_normal_is_that_of_least_squares_over_what_rays_hit() -> None:
  rng = np.random.default_rng(1)
  points = rng.uniform([-0.8, -0.5, -0.3], [0.8, 0.5, 0.3], (50, 32, 3))
  points[:25, :, 2] = points[:25] @ np.array([0.9, -0.4, 0.0]) + 0.01 * points[:25, :, 2]
  points[:, :, :2] += rng.uniform(-60.0, 60.0, (50, 1, 2))
  valid = rng.random((50, 32)) < rng.uniform(0.2, 1.0, (50, 1))
  ours = plane_normal(torch.tensor(points), torch.tensor(valid)).numpy()
  for world in range(50):
    seen = np.where(valid[world][:, None], points[world], np.nan)
    np.testing.assert_allclose(ours[world], fitted_normal(seen), atol=1e-8)
  single = plane_normal(torch.tensor(points, dtype=torch.float32), torch.tensor(valid)).numpy()
  np.testing.assert_allclose(single, ours, atol=1e-3)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_the_normal_is_vertical_where_hits_make_no_plane(dtype: torch.dtype) -> None:
  rng = np.random.default_rng(2)
  points = rng.uniform([-0.8, -0.5, -1.0], [0.8, 0.5, 1.0], (6, 32, 3)) + np.array([47.0, -31.0, 0.0])
  valid = np.zeros((6, 32), dtype=bool)
  valid[1, 5] = valid[2, 3:5] = valid[3:] = True
  # On a line; on a line across the axes; all on one point.
  points[3, :, 1] = points[3, :1, 1]
  points[4, :, 1] = 2.0 * points[4, :, 0] - 125.0
  points[5] = points[5, :1]
  normal = plane_normal(torch.tensor(points, dtype=dtype), torch.tensor(valid))
  assert torch.equal(normal, torch.tensor([[0.0, 0.0, 1.0]], dtype=dtype).expand(6, 3))


@pytest.mark.parametrize("slope", ["slope_up", "slope_down"])
def test_a_go1_that_lies_along_the_slope_is_upright_and_one_that_stands_level_is_not(slope: str) -> None:
  env = started_env(2, task=GO1)
  x, y = 8.0 * 4.5 + 2.4, 8.0 * (KINDS.index(slope) - 3.0)
  sign = 1.0 if slope == "slope_up" else -1.0
  # Half-way down the side the ground falls by 1 in 1 along x; the second world is turned along with it.
  half = sign * np.pi / 8.0
  env.sim.data.qpos[:, :3] = torch.tensor([x, y, sign * 1.4 + 0.6], dtype=torch.float64)
  env.sim.data.qpos[:, 3:7] = torch.tensor(
    [[1.0, 0.0, 0.0, 0.0], [np.cos(half), 0.0, np.sin(half), 0.0]], dtype=torch.float64
  )
  level, along = env.reward_manager.term("upright")().tolist()
  assert level < 0.15
  assert along > 0.85


def test_the_height_scan_sees_slopes_that_rise_above_the_body(env: ManagerBasedRlEnv) -> None:
  x, y = 8.0 * 4.5 + 3.0, 8.0 * (KINDS.index("slope_up") - 3.0)
  env.sim.data.qpos[:, :3] = torch.tensor([x, y, 0.8 + 0.3], dtype=torch.float64)
  env.sim.data.qpos[:, 3:7] = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64)
  scan = env.scene["terrain_scan"].data
  # Turned about: what lies ahead is uphill, above the trunk.
  above = scan.hit_pos_w[0, :, 2] - env.sim.data.qpos[0, 2]
  assert scan.valid.all()
  middle = above.reshape(11, 17)[5].numpy()
  np.testing.assert_allclose(middle[:16], np.linspace(-1.1, 0.4, 16), atol=0.02)
  assert middle[16] == above.max() == pytest.approx(0.5, abs=0.02)


def test_random_ground_of_watching_puts_robots_on_the_tile_that_was_drawn() -> None:
  task: Any = TASKS[GO1].make()
  task.env.scene.num_envs, task.env.seed = 60, 7
  env = ManagerBasedRlEnv(task.play(task.env), device="cpu")
  assert isinstance(env.cfg.scene.terrain, TerrainGridCfg)
  tiles = []
  for _ in range(2):
    env.reset()
    levels = levels_of(env)
    terrain: Any = env.scene.terrain
    origins = terrain.origins[levels.levels.numpy(), levels.columns.numpy()]
    assert np.abs(env.sim.data.qpos[:, :2].numpy() - origins[:, :2]).max() <= 0.5 + 1e-9
    tiles.append(levels.levels.numpy() * 5 + levels.columns.numpy())
  assert len(set(tiles[0])) > 15
  assert (tiles[0] != tiles[1]).mean() > 0.8
