"""The clips that ship are those that the tool makes."""

import importlib.util
from pathlib import Path

import torch
from mjlab_tracking import load_motion

ROOT = Path(__file__).parents[1]


def test_a_clip_that_ships_is_what_the_tool_makes() -> None:
  spec = importlib.util.spec_from_file_location("make_clips", ROOT / "tools" / "make_clips.py")
  assert spec is not None
  assert spec.loader is not None
  tool = importlib.util.module_from_spec(spec)
  spec.loader.exec_module(tool)
  folder = ROOT / "tasks/tracking/src/mjlab_tracking/clips"
  # That of the Go1 was recorded from a policy.
  assert sorted([*tool.SCORES, "go1_trot"]) == sorted(path.stem for path in folder.glob("*.npz"))
  made, shipped = tool.make("squat_and_wave"), load_motion(folder / "squat_and_wave.npz")
  assert made.joint_names == shipped.joint_names
  torch.testing.assert_close(made.joint_pos, shipped.joint_pos, atol=1e-4, rtol=0)
  torch.testing.assert_close(made.root_pos, shipped.root_pos, atol=1e-4, rtol=0)
