"""Blind tasks: what the actor no longer sees, and all else as in the tasks that they are made from."""

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_rl import TaskCfg
from mjlab_velocity import blind, g1_flat, g1_rough, go1_flat, go1_rough, go2_flat, go2_rough

Make = Callable[[], TaskCfg[ManagerBasedRlEnvCfg]]
SIGHTED: dict[str, Make] = {
  "Mjlab-Velocity-Flat-Unitree-G1-Blind": g1_flat,
  "Mjlab-Velocity-Flat-Unitree-Go1-Blind": go1_flat,
  "Mjlab-Velocity-Flat-Unitree-Go2-Blind": go2_flat,
  "Mjlab-Velocity-Rough-Unitree-Go2-Blind": go2_rough,
  "Mjlab-Velocity-Rough-Unitree-G1-Blind": g1_rough,
  "Mjlab-Velocity-Rough-Unitree-Go1-Blind": go1_rough,
}


@pytest.mark.parametrize("name", SIGHTED)
def test_only_the_actor_and_the_name_of_the_experiment_differ(name: str) -> None:
  (entry,) = entry_points(group="mjlab.tasks", name=name)
  task, sighted = entry.load()(), SIGHTED[name]()
  actor, seeing = task.env.observations["actor"], sighted.env.observations["actor"]
  assert seeing is not None
  assert list(actor.terms) == ["base_ang_vel", "projected_gravity", "joint_pos", "joint_vel", "actions", "command"]
  assert all(term == seeing.terms[key] for key, term in actor.terms.items())
  assert (actor.history_length, actor.corrupt) == (5, True)
  task.env.observations["actor"] = seeing
  assert task.env == sighted.env
  assert task.agent.experiment_name == f"{sighted.agent.experiment_name}_blind"
  assert (task.play, task.evaluator) == (sighted.play, sighted.evaluator)


def test_the_actor_sees_its_last_frames_and_a_start_without_a_past() -> None:
  task = blind(go1_flat())
  task.env.scene.num_envs = 2
  actor: Any = task.env.observations["actor"]
  actor.corrupt = False
  with ManagerBasedRlEnv(task.env, device="cpu") as env:
    observations, _ = env.reset(seed=0)
    frames: list[torch.Tensor] = []
    for _ in range(7):
      seen: Any = observations["actor"]
      assert seen.shape == (2, 5 * 45)
      gyro = seen[:, :15].unflatten(1, (5, 3))
      frames.append(gyro[:, -1])
      # Before the first frame there is none, so the oldest is repeated.
      past = [frames[max(len(frames) - 5 + i, 0)] for i in range(5)]
      assert torch.equal(gyro, torch.stack(past, 1))
      observations, *_ = env.step(torch.randn(2, 12, generator=torch.Generator().manual_seed(len(frames))))
  assert not torch.equal(frames[0], frames[-1])


def test_a_task_without_an_actor_is_refused() -> None:
  task = go1_flat()
  del task.env.observations["actor"]
  with pytest.raises(ConfigError, match="needs an observation group 'actor'"):
    blind(task)
