"""The example that stands alone: it runs, does what it says, and needs nothing above this package."""

import re
import runpy
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[1] / "examples" / "plain_mujoco.py"


def test_the_example_drives_both_wheels_to_their_target_with_this_package_alone(
  capsys: pytest.CaptureFixture[str],
) -> None:
  runpy.run_path(str(EXAMPLE), run_name="__main__")
  printed = capsys.readouterr().out
  reached = [float(angle) for angle in re.findall(r": (\S+) rad after", printed)]
  assert len(reached) == 2
  assert all(abs(angle - 2.0) < 0.02 for angle in reached), printed
  fastest = re.search(r"fastest: (\S+) rad/s", printed)
  assert fastest is not None
  assert float(fastest[1]) < 6.0
  assert set(re.findall(r"mjlab_\w+", EXAMPLE.read_text(encoding="utf-8"))) == {"mjlab_actuators"}
