"""The rough tasks' ground, by rays of MuJoCo C, and where robots begin on it."""

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_terrain import Terrain
from mjlab_velocity.rough import rough_terrain
from velocity_facts import TASKS
from velocity_oracle import GROUND
from velocity_rollout import make_env

COLUMNS = ("flat", "stairs_up", "stairs_down", "slope_up", "slope_down", "random_rough", "waves")
ROWS = 10
Height = Callable[[float, float], float]


@pytest.fixture(scope="module")
def built() -> tuple[Terrain, mujoco.MjModel]:
  spec = mujoco.MjSpec()
  terrain = rough_terrain().add_to(spec)
  return terrain, spec.compile()


@pytest.fixture(scope="module")
def ground(built: tuple[Terrain, mujoco.MjModel]) -> Height:
  """Height at a point of the world; NaN where there is no ground."""
  _, model = built
  data = mujoco.MjData(model)
  mujoco.mj_forward(model, data)
  geom = np.zeros(1, dtype=np.int32)

  def height(x: float, y: float) -> float:
    start, down = np.array([x, y, 10.0]), np.array([0.0, 0.0, -1.0])
    distance = mujoco.mj_ray(model, data, start, down, GROUND, 1, -1, geom)
    return 10.0 - distance if distance >= 0.0 else np.nan

  return height


@pytest.fixture(scope="module")
def on(ground: Height) -> Callable[[str, int, float, float], float]:
  """Height at a point of a tile, from its middle."""

  def height(kind: str, row: int, x: float, y: float) -> float:
    return ground(8.0 * (row - 4.5) + x, 8.0 * (COLUMNS.index(kind) - 3.0) + y)

  return height


def rows() -> Iterator[tuple[int, float]]:
  return ((row, row / 9.0) for row in range(ROWS))


def test_there_are_ten_levels_of_seven_kinds_each_with_its_share(built: tuple[Terrain, mujoco.MjModel]) -> None:
  terrain, _ = built
  assert terrain.tile_size == (8.0, 8.0)
  assert [terrain.type_names[kind] for kind in terrain.tile_types[0]] == list(COLUMNS)
  assert (terrain.tile_types == terrain.tile_types[0]).all()
  np.testing.assert_allclose(terrain.column_shares, [0.2, 0.2, 0.2, 0.1, 0.1, 0.1, 0.1])
  np.testing.assert_allclose(terrain.difficulty, np.tile(np.arange(ROWS)[:, None] / 9.0, (1, 7)))
  # Of these, worlds begin on the easier six.
  assert [task.make().env.scene.max_init_terrain_level for task in TASKS.values() if task.rough] == [5, 5]


def test_a_level_border_of_twenty_metres_surrounds_the_grid(ground: Height) -> None:
  for x, y in product((-59.9, -41.0, 41.0, 59.9), (-47.9, -29.0, 29.0, 47.9)):
    assert ground(x, y) == pytest.approx(0.0, abs=1e-6)
  for x, y in ((60.1, 0.0), (-60.1, 0.0), (0.0, 48.1), (0.0, -48.1)):
    assert np.isnan(ground(x, y))


@pytest.mark.parametrize(("kind", "sign"), [("stairs_up", 1.0), ("stairs_down", -1.0)])
def test_stairs_have_five_steps_of_thirty_centimetres_and_rise_to_ten_each(
  on: Callable[[str, int, float, float], float], kind: str, sign: float
) -> None:
  for row, difficulty in rows():
    for x in (0.0, 1.45):
      assert on(kind, row, x, 0.0) == pytest.approx(sign * 0.6 * difficulty, abs=1e-6)
    for step in range(5):
      at, height = 1.65 + 0.3 * step, sign * 0.1 * difficulty * (5 - step)
      for x, y in ((at, 0.0), (0.0, at), (-at, 0.5), (0.5, -at), (at, at)):
        assert on(kind, row, x, y) == pytest.approx(height, abs=1e-6)
    assert on(kind, row, 3.1, 0.0) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("kind", "sign"), [("slope_up", 1.0), ("slope_down", -1.0)])
def test_slopes_reach_forty_five_degrees_and_platforms_two_metres(
  on: Callable[[str, int, float, float], float], kind: str, sign: float
) -> None:
  assert on(kind, 9, 0.0, 0.0) == pytest.approx(sign * 2.065, abs=0.005)
  for row, slope in rows():
    for x, y in product((-3.7, -2.5, -1.3, 0.0, 0.8, 1.9, 3.1), repeat=2):
      rise = slope * 3.8 * max(1.0 - abs(x) / 3.8, 0.0) * max(1.0 - abs(y) / 3.8, 0.0)
      assert on(kind, row, x, y) == pytest.approx(sign * min(rise, slope * 2.065), abs=0.011)


def waves(difficulty: float, x: float, y: float) -> float:
  return 0.1 * difficulty * (np.cos(2.0 * np.pi * x / 1.9) + np.cos(2.0 * np.pi * y / 1.9))


@pytest.mark.parametrize(("kind", "expected", "tol"), [("flat", lambda *_: 0.0, 1e-6), ("waves", waves, 0.008)])
def test_flat_tiles_and_waves_have_the_heights_of_the_table(
  on: Callable[[str, int, float, float], float], kind: str, expected: Callable[..., float], tol: float
) -> None:
  for row, difficulty in rows():
    for x, y in product((-3.0, -1.9, -0.95, -0.3, 0.0, 0.95, 1.4, 2.85), repeat=2):
      assert on(kind, row, x, y) == pytest.approx(expected(difficulty, x, y), abs=tol)


def test_rough_ground_grows_with_the_level_to_the_spread_of_the_table(
  on: Callable[[str, int, float, float], float],
) -> None:
  # Heights of 2 to 10 cm in steps of 2, all equally likely.
  spread = np.std([0.02, 0.04, 0.06, 0.08, 0.10])
  for row, difficulty in rows():
    z = np.array([on("random_rough", row, 0.1 * i, 0.1 * j) for i in range(-30, 31, 2) for j in range(-30, 31, 2)])
    assert abs(z.mean()) < 0.004
    assert z.std() == pytest.approx(spread * difficulty, rel=0.1, abs=1e-6)
    assert np.abs(z).max() <= 0.05 * difficulty + 1e-5


def test_robots_begin_on_the_surface_of_the_middle_of_their_tiles(
  built: tuple[Terrain, mujoco.MjModel], ground: Height
) -> None:
  terrain, _ = built
  heights = terrain.origins[-1, :, 2]
  np.testing.assert_allclose(heights[:5], [0.0, 0.6, -0.6, 2.065, -2.065], atol=0.005)
  for row, column in np.ndindex(ROWS, len(COLUMNS)):
    x, y, z = terrain.origins[row, column]
    middle = 8.0 * (row - 4.5), 8.0 * (column - 3.0)
    reach = 1.0 if COLUMNS[column] in ("random_rough", "waves") else 0.0
    assert max(abs(x - middle[0]), abs(y - middle[1])) <= reach + 1e-9
    assert ground(x, y) == pytest.approx(z, abs=2e-3)


@pytest.mark.parametrize("task", [name for name in TASKS if "Rough" in name])
def test_no_robot_begins_inside_the_ground_of_any_tile(task: str) -> None:
  env = make_env(70, task=task)
  levels: Any = env.scene.terrain_levels
  levels.levels.copy_(torch.arange(70) // 7)
  levels.columns.copy_(torch.arange(70) % 7)
  levels.move(torch.ones(70, dtype=torch.bool), torch.zeros(70, dtype=torch.bool), torch.zeros(70, dtype=torch.bool))
  model = env.sim.mj_model
  data = mujoco.MjData(model)
  feet = [model.site(f"robot/{foot}").id for foot in TASKS[task].robot.feet]
  terrain = model.body("terrain").id
  deepest: dict[str, float] = {}
  for _ in range(4):
    env.reset()
    for world, qpos in enumerate(env.sim.data.qpos.numpy()):
      data.qpos[:] = qpos
      mujoco.mj_fwdPosition(model, data)
      kind = COLUMNS[world % 7]
      gap = min((c.dist for c in data.contact if terrain in model.geom_bodyid[c.geom]), default=0.0)
      deepest[kind] = min(deepest.get(kind, 0.0), gap)
      # Near the ground, too: 1 to 5 cm above where it is highest.
      assert abs(data.site_xpos[feet, 2].mean() - float(env.scene.env_origins[world, 2]) - 0.05) < 0.05
  assert all(gap >= 0.0 for gap in deepest.values()), deepest
