"""The reference in viewers: its ghost, and a held target."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from mjlab_motions import Ghost
from tracking_env import make, still, zeros


def test_the_ghost_is_the_reference_of_the_worlds_that_are_shown(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  env, term = make(still(folder, failures=False))
  # The tests of mjlab-motions show that a ghost has its shapes where MuJoCo has them.
  drawn: list[torch.Tensor] = []
  monkeypatch.setattr(Ghost, "draw", lambda _, draw, *pose: drawn.extend(pose))
  worlds: Any = SimpleNamespace(worlds=(2, 0))
  term.debug_draw(worlds)
  pelvis = term.library.body_names.index("pelvis")
  expected = term.body_pos_w[[2, 0], pelvis], term.body_quat_w[[2, 0], pelvis], term.joint_pos[[2, 0]]
  torch.testing.assert_close(drawn, list(expected), rtol=0, atol=0)
  assert not torch.equal(drawn[0][0], drawn[0][1])
  assert "command motion" in env.drawers()


def test_a_held_target_stays_until_its_release(folder: Path) -> None:
  env, term = make(still(folder, failures=False, sampling="start"))
  (axis,) = term.axes
  assert axis == ("time [s]", 0.0, pytest.approx(0.8))
  assert "motion" in env.steering()
  term.steer(1, [0.4])
  # It acts at once, also without a step.
  assert term.frame.tolist() == [1, 20, 1, 1]
  assert not torch.equal(term.anchor_pos_w[1], term.anchor_pos_w[3])
  for _ in range(3):
    env.step(zeros(env))
  assert term.frame.tolist() == [4, 20, 4, 4]
  torch.testing.assert_close(term.joint_pos[1], term.library.table[term.library.offsets[term.clip[1]] + 20, :29])
  term.steer(1, None)
  env.step(zeros(env))
  assert term.frame.tolist() == [5, 21, 5, 5]
