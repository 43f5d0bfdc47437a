"""The clips that ship are those that the tool makes."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
import torch
from mjlab_motions import load_motion

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "packages/motions/src/mjlab_motions/clips"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
  spec = importlib.util.spec_from_file_location("make_clips", ROOT / "tools" / "make_clips.py")
  assert spec is not None
  assert spec.loader is not None
  tool = importlib.util.module_from_spec(spec)
  spec.loader.exec_module(tool)
  return tool


def test_all_clips_that_ship_are_made_by_the_tool_but_for_one_that_was_recorded(tool: ModuleType) -> None:
  assert sorted([*tool.SCORES, "go1_trot"]) == sorted(path.stem for path in FOLDER.glob("*.npz"))


@pytest.mark.parametrize("name", ["squat_and_wave", "march_in_place", "side_step_dance"])
def test_a_clip_that_ships_is_what_the_tool_makes(tool: ModuleType, name: str) -> None:
  made, shipped = tool.make(name), load_motion(FOLDER / f"{name}.npz")
  assert made.joint_names == shipped.joint_names
  assert made.rate == shipped.rate
  for part in ("root_pos", "root_quat", "joint_pos"):
    torch.testing.assert_close(getattr(made, part), getattr(shipped, part), atol=1e-4, rtol=0)
