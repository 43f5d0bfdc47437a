"""A run that was interrupted and resumed is the run that was not, on the CPU to the last bit."""

import copy
from pathlib import Path
from typing import Any

import mjlab
import pytest
import torch
from mjlab.environments import standard_env
from mjlab_rl import Console, TrainingResult, train

WORLDS = 8


def assert_same(a: Any, b: Any, where: str = "") -> None:
  if isinstance(a, torch.Tensor):
    assert torch.equal(a, b), where
  elif isinstance(a, dict):
    assert a.keys() == b.keys(), where
    for key in a:
      assert_same(a[key], b[key], f"{where}.{key}")
  elif isinstance(a, (list, tuple)):
    assert len(a) == len(b), where
    for i, (left, right) in enumerate(zip(a, b, strict=True)):
      assert_same(left, right, f"{where}[{i}]")
  else:
    assert a == b, where


@pytest.mark.parametrize(
  "name", ["Mjlab-Cartpole-Balance", "Mjlab-Velocity-Rough-Unitree-Go1", "Mjlab-Tracking-Flat-Unitree-G1"]
)
def test_two_iterations_and_two_more_equal_four(tmp_path: Path, name: str) -> None:
  task = mjlab.load_task(name)
  task.env.scene.num_envs = WORLDS
  task.env.episode_length_s = 0.5
  task.agent.num_steps_per_env = 16
  task.agent.logger = "none"

  def run(iterations: int, folder: str, resume: Path | None = None) -> TrainingResult:
    configured = copy.deepcopy(task)
    configured.agent.max_iterations = iterations
    return train(
      configured, name=name, make_env=standard_env, log_root=tmp_path / folder, resume=resume, console=Console("quiet")
    )

  whole, half = run(4, "whole"), run(2, "half")
  resumed = run(4, "resumed", half.checkpoint)
  assert whole.checkpoint is not None
  assert resumed.checkpoint is not None
  states = [torch.load(path, weights_only=True) for path in (whole.checkpoint, resumed.checkpoint)]
  for state in states:
    del state["mjlab"]["elapsed"]
  assert_same(*states)
