"""`design-excitation`: from a task's robot to a table of commands."""

from pathlib import Path

import numpy as np
import pytest
from mjlab import cli
from mjlab_sysid import read_records

TASK = "Mjlab-Velocity-Flat-Unitree-Go1"
WORDS = "--fit armature:FR_calf_joint --joints FR_(thigh|calf)_joint --seconds 1.5 --candidates 2".split()


def test_commands_begin_and_end_in_the_pose_of_the_task(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  output = tmp_path / "excitation.csv"
  assert cli.main(["design-excitation", TASK, *WORDS, "--rounds", "1", "--output", str(output)]) == 0
  shown = capsys.readouterr().out
  assert "design: iteration 2, smallest singular value" in shown
  assert "with one slow sine" in shown
  (found,) = read_records([output])
  assert found.joints == ("FR_thigh_joint", "FR_calf_joint")
  assert (found.period, found.num_rows) == (0.01, 150)
  targets = found.signals["position_target"]
  np.testing.assert_allclose(targets[[0, -1]], [[0.9, -1.8]] * 2, atol=1e-6)
  assert np.ptp(targets, axis=0).min() > 0.1
  assert cli.design_excitation([TASK, *WORDS, "--output", str(output)]) == 2
  assert "exists; --force overwrites it" in capsys.readouterr().err
