"""`record-motion`: clips of simulations."""

from pathlib import Path

import mjlab
import numpy as np
import pytest
import torch
from mjlab import cli
from mjlab_motions import Kinematics, load_motion, read_motion
from mjlab_robots import g1_spec

TASK = "Mjlab-Tracking-Flat-Unitree-G1"


def record(*words: str) -> int:
  return cli.main(["record-motion", TASK, "--device", "cpu", "--agent", "zero", *words])


def test_a_clip_has_the_motion_of_the_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  path = tmp_path / "still.npz"
  words = ["--output", str(path), "--seconds", "0.3", "--skip", "0.1", "--license", "CC0-1.0", "--seed", "3"]
  assert record(*words) == 0
  assert "wrote" in capsys.readouterr().out
  motion = load_motion(path)
  assert (motion.num_frames, motion.rate, motion.license) == (16, 50.0, "CC0-1.0")
  task = mjlab.load_task(TASK)
  assert task.play is not None
  cfg = task.play(task.env)
  cfg.scene.num_envs, cfg.seed = 1, 3
  with mjlab.ManagerBasedRlEnv(cfg, device="cpu") as env:
    env.reset(seed=3)
    for _ in range(5):
      env.step(torch.zeros(1, 29))
    for frame in range(16):
      data = env.scene["robot"].data
      np.testing.assert_allclose(motion.joint_pos[frame], data.joint_pos[0], atol=1e-6)
      np.testing.assert_allclose(motion.root_pos[frame], data.root_link_pos_w[0], atol=1e-6)
      env.step(torch.zeros(1, 29))
  # Readers accept it, with its bodies.
  read_motion(path, Kinematics(g1_spec(meshes="never").compile()))


def test_an_episode_that_ends_too_early_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  path = tmp_path / "fallen.npz"
  assert record("--output", str(path), "--seconds", "8") == 1
  assert "the episode ended after" in capsys.readouterr().err
  assert not path.exists()
