"""Shipped clips against those that the tool makes."""

from pathlib import Path

import make_clips
import pytest
import torch
from mjlab_motions import load_motion

FOLDER = Path(__file__).parents[1] / "packages/motions/src/mjlab_motions/clips"


def test_the_tool_makes_all_shipped_clips_but_the_recorded_one() -> None:
  assert sorted([*make_clips.SCORES, "go1_trot"]) == sorted(path.stem for path in FOLDER.glob("*.npz"))


@pytest.mark.parametrize("name", ["squat_and_wave", "march_in_place", "side_step_dance"])
def test_a_shipped_clip_is_the_clip_of_the_tool(name: str) -> None:
  made, shipped = make_clips.make(name), load_motion(FOLDER / f"{name}.npz")
  assert made.joint_names == shipped.joint_names
  assert made.rate == shipped.rate
  for part in ("root_pos", "root_quat", "joint_pos"):
    torch.testing.assert_close(getattr(made, part), getattr(shipped, part), atol=1e-4, rtol=0)
