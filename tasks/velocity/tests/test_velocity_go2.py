"""Velocity tasks of the Go2: those of the Go1 with another robot."""

import copy
from typing import Any

import numpy as np
import pytest
import torch
from mjlab_envs import ManagerBasedRlEnv
from mjlab_velocity import go1_flat, go1_rough, go2_flat, go2_rough

FEET = ("FR", "FL", "RR", "RL")


@pytest.mark.parametrize(("ours", "other"), [(go2_flat, go1_flat), (go2_rough, go1_rough)])
def test_terms_are_those_of_the_go1(ours: Any, other: Any) -> None:
  task, like = ours(), other()
  for part in ("observations", "terminations", "commands", "curriculum", "metrics"):
    assert getattr(task.env, part) == getattr(like.env, part)
  for part in ("rewards", "events"):
    assert list(getattr(task.env, part)) == list(getattr(like.env, part))
  assert {k: v.weight for k, v in task.env.rewards.items()} == {k: v.weight for k, v in like.env.rewards.items()}
  agent = copy.deepcopy(like.agent)
  agent.experiment_name = "go2_velocity"
  assert (task.agent, task.play, task.evaluator) == (agent, like.play, like.evaluator)


def test_episodes_begin_with_feet_one_to_five_centimetres_above_the_ground_and_the_robot_stands() -> None:
  task = go2_flat()
  task.env.scene.num_envs = 16
  task.env.events["push_robot"] = None
  with ManagerBasedRlEnv(task.env, device="cpu") as env:
    env.reset(seed=0)
    model = env.sim.mj_model
    feet = [model.geom(f"robot/{foot}_foot_collision").id for foot in FEET]
    heights = env.sim.data.geom_xpos[:, feet, 2].numpy() - 0.022
    assert np.all(heights > 0.0099)
    assert np.all(heights < 0.0501)
    assert heights.max() - heights.min() > 0.02
    for _ in range(60):
      _, _, terminated, _, _ = env.step(torch.zeros(16, 12))
      assert not terminated.any()
    robot = env.scene["robot"].data
    assert 0.2 < float(robot.root_link_pos_w[:, 2].min()) < float(robot.root_link_pos_w[:, 2].max()) < 0.32
    assert bool((env.scene["feet_ground_contact"].data.found > 0).all())
