"""`record-motion`: what happens in a simulation comes back as a clip."""

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


def test_a_clip_is_what_the_robot_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
  # Any reader takes it, the bodies included.
  read_motion(path, Kinematics(g1_spec(meshes="never").compile()))


def test_a_rollout_that_ends_too_early_is_no_clip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  path = tmp_path / "fallen.npz"
  assert record("--output", str(path), "--seconds", "8") == 1
  assert "the episode ended after" in capsys.readouterr().err
  assert not path.exists()


@pytest.mark.parametrize(
  ("words", "message"),
  [
    ([], "--output is missing: name the clip's file"),
    (["--output", "clip.csv"], "--output: clip.csv does not end in .npz"),
    (["--output", "clip.npz", "--seconds", "nan"], "--seconds must be a number, got nan"),
    (["--output", "clip.npz", "--skip", "-1"], "--skip must not be negative, got -1"),
    (["--output", "clip.npz", "--entity", "robbot"], "entity 'robbot' does not exist. Nearest: robot"),
  ],
)
def test_a_mistake_is_one_line(
  words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  monkeypatch.chdir(tmp_path)
  assert record(*words) in (1, 2)
  error = capsys.readouterr().err
  assert message in error
  assert error.count("\n") == 1


def test_a_file_that_is_there_is_not_overwritten_unasked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  path = tmp_path / "mine.npz"
  path.write_bytes(b"mine")
  assert record("--output", str(path)) == 2
  assert "--force" in capsys.readouterr().err
  assert path.read_bytes() == b"mine"
