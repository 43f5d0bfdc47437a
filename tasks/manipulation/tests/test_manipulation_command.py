"""Where objects begin, where they are to go, and when a goal is over."""

import itertools
from typing import Any

import numpy as np
import pytest
import torch
from manipulation_worlds import COLOURS, lift, room_in_sight, three_cubes
from mjlab_core.errors import ConfigError
from mjlab_dr import randomize_field
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg, mdp
from mjlab_managers import EventTermCfg, SceneEntityCfg
from mjlab_manipulation import lift_cube_env, multi_cube_seg_env
from mjlab_manipulation.mdp import Region
from mjlab_manipulation.objects import CUBE_EDGE


def places(env: ManagerBasedRlEnv, names: tuple[str, ...]) -> np.ndarray:
  """Where objects are from the origin of their world, (num_envs, objects, 3)."""
  return np.stack([(env.scene[n].data.root_link_pos_w - env.scene.env_origins).numpy() for n in names], axis=1)


def test_starts_and_goals_fill_their_regions() -> None:
  env, term = lift(600)
  # Of a cube that stands upright, the lowest point is half an edge below its centre.
  start, goal = places(env, ("cube",))[:, 0] - [0.0, 0.0, 0.5 * CUBE_EDGE], term.command.numpy()
  for values, region in ((start, term.cfg.start), (goal, term.cfg.goal)):
    for axis, (lo, hi) in zip(values.T, (region.x, region.y, region.z), strict=True):
      assert lo - 1e-9 <= axis.min() < lo + 0.02 * (hi - lo)
      assert hi - 0.02 * (hi - lo) < axis.max() <= hi + 1e-9
      assert abs(axis.mean() - 0.5 * (lo + hi)) < 5 * (hi - lo) / np.sqrt(12 * 600)
  quat = env.scene["cube"].data.root_link_quat_w.numpy()
  yaw = 2.0 * np.arctan2(quat[:, 3], quat[:, 0])
  assert np.abs(quat[:, 1:3]).max() == 0.0
  assert abs(np.exp(1j * yaw).mean()) < 0.15
  assert not env.scene["cube"].data.root_link_lin_vel_w.any()
  # All draws are independent.
  drawn = np.column_stack([start, goal, np.cos(yaw), term.goal_time.numpy()])
  assert np.abs(np.corrcoef(drawn.T) - np.eye(8)).max() < 0.2


def test_cubes_never_overlap_and_take_every_order() -> None:
  env, term = lift(300, three_cubes)
  orders, gaps = set(), []
  for _ in range(4):
    env.reset()
    where = places(env, COLOURS)
    for a, b in itertools.combinations(range(3), 2):
      # Two cubes whose centres are further apart than a diagonal touch for no yaw.
      assert np.linalg.norm(where[:, a, :2] - where[:, b, :2], axis=-1).min() > CUBE_EDGE * np.sqrt(2)
    orders |= set(map(tuple, where[..., 1].argsort(axis=1)))
    gaps.append(np.diff(np.sort(where[..., 1], axis=1), axis=1))
    assert where[..., 1].min() >= -0.103 - 1e-9
    assert where[..., 1].max() <= 0.103 + 1e-9
  assert len(orders) == 6
  # A row of rods on a line: gaps reach from the least to all the room there is.
  gaps = np.concatenate(gaps)
  assert gaps.min() < 0.06 + 0.002
  assert gaps.max() > 0.06 + 0.07
  assert np.bincount(term.target.numpy()).min() > 60


def test_cubes_that_are_larger_in_some_worlds_stand_further_apart_there() -> None:
  def of_many_sizes() -> ManagerBasedRlEnvCfg:
    cfg = three_cubes()
    for name in COLOURS:
      size = randomize_field("geom_size", ".*", (0.5, 2.2), operation="scale", isotropic=True)
      cfg.events[f"size_{name}"] = EventTermCfg(
        mdp.randomize, mode="startup", params={"randomizer": size, "asset": SceneEntityCfg(name)}
      )
    return cfg

  env, _ = lift(300, of_many_sizes)
  where = places(env, COLOURS)[..., 1]
  geoms = [env.sim.mj_model.geom(f"{name}/cube").id for name in COLOURS]
  radius = np.sqrt(2) * env.sim.model.geom_size[:, geoms, 0].numpy()
  for a, b in itertools.combinations(range(3), 2):
    assert (np.abs(where[:, a] - where[:, b]) > radius[:, a] + radius[:, b] - 1e-9).all()
  # Where there is room, all stand in their region; elsewhere they stand about its middle.
  needed = 2.0 * np.sort(radius)[:, 1:].sum(1)
  large = needed > 0.206
  assert np.abs(where[~large]).max() <= 0.103 + 1e-9
  assert large.sum() > 5
  np.testing.assert_allclose(where[large].mean(1), 0.0, atol=1e-9)
  assert where[~large].mean(1).std() > 0.005


@pytest.mark.parametrize("make", [lift_cube_env, multi_cube_seg_env], ids=["one", "three"])
def test_the_wrist_camera_sees_all_of_every_cube_wherever_it_begins(make: Any) -> None:
  env, term = lift(1, make)
  assert 0.0 < room_in_sight(env, term.cfg.start, (CUBE_EDGE,) * 3) < 0.02


def test_a_new_goal_is_the_end_of_an_episode_and_no_failure() -> None:
  env, term = lift(6, goal_time_range=(0.1, 0.2))
  lengths: list[int] = []
  age = torch.zeros(6, dtype=torch.int64)
  for _ in range(40):
    goal, cube = term.command.clone(), places(env, ("cube",))[:, 0]
    _, _, terminated, truncated, _ = env.step(torch.zeros(6, 7))
    age += 1
    assert not terminated.any()
    same = (term.command == goal).all(-1)
    # A goal that changes ends the episode, and none changes but by that; nor does any cube jump.
    assert torch.equal(~same, truncated)
    jump = np.linalg.norm(places(env, ("cube",))[:, 0] - cube, axis=-1)
    assert jump[~truncated.numpy()].max(initial=0.0) < 0.02
    lengths += age[truncated].tolist()
    age[truncated] = 0
  assert set(lengths) == {6, 7, 8, 9, 10}


def test_draws_of_a_world_do_not_depend_on_resets_of_others() -> None:
  (one, first), (other, second) = lift(4), lift(4)
  one.reset(env_ids=[1])
  other.reset(env_ids=[0, 1, 3])
  assert torch.equal(first.command[1], second.command[1])
  assert np.array_equal(places(one, ("cube",))[1], places(other, ("cube",))[1])
  assert not torch.equal(first.command[0], second.command[0])


def test_a_goal_can_be_steered_until_steering_ends() -> None:
  env, term = lift(3)
  before = term.command.clone()
  term.steer(1, (0.4, 0.1, 0.3))
  env.step(torch.zeros(3, 7))
  assert term.command[1].tolist() == pytest.approx([0.4, 0.1, 0.3])
  assert torch.equal(term.command[[0, 2]], before[[0, 2]])
  assert [low < high for _, low, high in term.axes] == [True] * 3
  term.steer(1, None)
  env.reset(env_ids=[1])
  assert term.command[1].tolist() != pytest.approx([0.4, 0.1, 0.3])


@pytest.mark.parametrize(
  ("options", "message"),
  [
    ({"objects": ("ball",)}, "ball"),
    ({"objects": ("robot",)}, "'robot' cannot be lifted: its base is fixed"),
    ({"min_distance": 0.5, "objects": ("cube", "cube")}, "0.206 m wide, too little for 2 objects 0.5 m apart"),
    ({"min_distance": 0.05, "objects": ("cube", "cube")}, "min_distance is 0.05 m, but objects may touch below 0.0565"),
    ({"goal": Region(x=(0.5, 0.3), y=(0.0, 0.0), z=(0.2, 0.4))}, "goal: x must not fall"),
    ({"goal_time_range": (0.0, 1.0)}, "goal_time_range"),
    ({"resampling_time_range": (1.0, 2.0)}, "resets draw the command"),
  ],
  ids=lambda value: "" if isinstance(value, str) else next(iter(value)),
)
def test_a_bad_command_is_refused_at_build(options: dict[str, Any], message: str) -> None:
  with pytest.raises(ConfigError, match=message):
    lift(2, **options)
