"""Worlds of `tools/parity.py` against Gymnasium's own environments."""

import parity
import pytest
import torch
from gymnasium_worlds import Hopper, SceneCfg, WorldsCfg


@pytest.mark.parametrize("name", parity.TASKS)
def test_worlds_are_those_of_gymnasium(name: str) -> None:
  assert parity.difference_from_gymnasium(parity.TASKS[name]) < 1e-3


def test_returns_of_episodes_are_kept_and_the_last_observation_is_that_of_the_fall() -> None:
  env = Hopper(WorldsCfg(scene=SceneCfg(num_envs=3), seed=1))
  env.reset()
  total = torch.zeros(3)
  while True:
    seen, reward, fallen, _, extras = env.step(torch.ones(3, 3))
    total += reward
    if fallen.any():
      break
  last = extras["final_obs"]["actor"][fallen]
  assert ((last[:, 0] < 0.7) | (last[:, 1].abs() > 0.2)).all()
  assert (seen["actor"][fallen, 0] > 1.2).all()
  steps, value = env.returns[0]
  assert steps == env.steps_done
  assert value == pytest.approx(float(total[fallen][0]), rel=1e-5)
