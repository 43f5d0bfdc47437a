"""The log of a deployed policy is a record that `sysid` reads."""

from pathlib import Path

import numpy as np
from mjlab_deploy.robot.run_log import write_mcap
from mjlab_sysid import read_records


def test_sysid_reads_the_log_of_a_run(tmp_path: Path) -> None:
  """Each target is sent after the state that it answers to, so the next state is the first that it moves."""
  rng = np.random.default_rng(0)
  rows = {
    "time": 0.002 * np.arange(50),
    "position": rng.normal(size=(50, 3)),
    "velocity": rng.normal(size=(50, 3)),
    "target": rng.normal(size=(50, 3)),
    "is_policy": np.ones(50),
    "command_velocity": rng.normal(size=(50, 3)),
  }
  write_mcap(tmp_path / "run.mcap", ["hip", "thigh", "calf"], rows)
  (record,) = read_records([tmp_path / "run.mcap"])
  assert record.joints == ("hip", "thigh", "calf")
  np.testing.assert_allclose(record.time, rows["time"][1:] - rows["time"][1], atol=1e-9)
  for name, values in (("position", rows["position"][1:]), ("velocity", rows["velocity"][1:])):
    np.testing.assert_allclose(record.signals[name], values)
  np.testing.assert_allclose(record.signals["position_target"], rows["target"][:-1])
