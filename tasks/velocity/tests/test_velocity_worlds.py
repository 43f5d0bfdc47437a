"""What worlds do not do to each other, and what is remembered of a world."""

from typing import Any

import torch
from mjlab_envs import ManagerBasedRlEnv
from velocity_rollout import make_env, started_env

ROUGH = "Mjlab-Velocity-Rough-Unitree-G1"
"""The task with the most that could leak between worlds."""


def play(env: ManagerBasedRlEnv, steps: int, seed: int = 3) -> list[list[torch.Tensor]]:
  """Random actions; observations, reward and flags of each step."""
  generator = torch.Generator().manual_seed(seed)
  seen: list[list[torch.Tensor]] = []
  for _ in range(steps):
    action = 0.5 * torch.randn(env.num_envs, env.action_manager.total_action_dim, generator=generator)
    observations, reward, terminated, truncated, _ = env.step(action)
    seen.append([*(torch.as_tensor(observations[g]) for g in ("actor", "critic")), reward, terminated, truncated])
  return seen


def names(state: dict[str, Any], prefix: str = "") -> set[str]:
  found: set[str] = set()
  for name, value in state.items():
    found |= names(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name}
  return found


def test_observations_of_a_world_do_not_depend_on_resets_of_others() -> None:
  alone, disturbed = make_env(6, task=ROUGH), make_env(6, task=ROUGH)
  alone.reset()
  disturbed.reset()
  others = torch.tensor([True, True, False, True, False, True])
  for steps in (10, 10, 10):
    for one, other in zip(play(alone, steps), play(disturbed, steps), strict=True):
      assert all(torch.equal(a[others], b[others]) for a, b in zip(one, other, strict=True))
    disturbed.episode_length_buf.masked_fill_(~others, 999)
  assert not torch.equal(alone.sim.data.qpos[2], disturbed.sim.data.qpos[2])


def test_a_world_that_diverges_ends_is_counted_and_changes_no_other_world() -> None:
  healthy, ill = make_env(4, task=ROUGH), make_env(4, task=ROUGH)
  healthy.reset()
  ill.reset()
  play(healthy, 5)
  play(ill, 5)
  ill.drain_log()
  ill.sim.data.qvel[1, 7] = torch.nan
  others = torch.tensor([True, False, True, True])
  one, other = play(healthy, 40), play(ill, 40)
  for a, b in zip(one, other, strict=True):
    assert all(torch.equal(x[others], y[others]) for x, y in zip(a, b, strict=True))
    assert all(torch.isfinite(x).all() for x in b)
  assert other[0][3].tolist() == [False, True, False, False]
  assert ill.drain_log()["Episode_Termination/nan_detection"] == 1


def test_the_same_seed_gives_the_same_worlds_and_another_seed_others() -> None:
  runs = []
  for seed in (1, 1, 2):
    env = started_env(3, seed=seed)
    runs.append(play(env, 5))
  assert all(torch.equal(a, b) for one, other in zip(*runs[:2], strict=True) for a, b in zip(one, other, strict=True))
  assert not torch.equal(runs[0][0][1], runs[2][0][1])


def test_saved_names_do_not_depend_on_the_number_of_worlds() -> None:
  assert len({frozenset(names(make_env(num_envs).state_dict())) for num_envs in (1, 3, 4, 12, 37)}) == 1


def test_neighbours_are_two_metres_apart() -> None:
  origins = make_env(9).scene.env_origins
  assert not origins[:, 2].any()
  distance = torch.cdist(origins, origins) + 100.0 * torch.eye(9, dtype=origins.dtype)
  torch.testing.assert_close(distance.min(1).values, torch.full((9,), 2.0, dtype=origins.dtype))
