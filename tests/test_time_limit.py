"""The time limit of tests: a hanging test ends the run and is named."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
  ("code", "where"),
  [
    ("import time\ndef test_waiting():\n  time.sleep(1000)\n", "in test_waiting"),
    (
      "import threading, time\ndef wait():\n  time.sleep(1000)\n"
      "def test_leaving_a_thread():\n  threading.Thread(target=wait).start()\n",
      "in wait",
    ),
  ],
  ids=["a test", "a thread left behind"],
)
def test_a_hanging_test_ends_the_run_and_is_named(code: str, where: str, tmp_path: Path) -> None:
  file = tmp_path / "test_still.py"
  file.write_text(code)
  settings = ["-c", ROOT / "pyproject.toml", "-p", "conftest", "-p", "no:cacheprovider"]
  # A busy machine may need longer to reach the hanging line.
  for seconds in (1, 5, 25, 125):
    run = subprocess.run(
      [sys.executable, "-m", "pytest", *settings, "-o", f"faulthandler_timeout={seconds}", file],
      cwd=tmp_path,
      env=os.environ | {"PYTHONPATH": str(ROOT)},
      capture_output=True,
      text=True,
      check=False,
    )
    assert run.returncode == 1, run.stdout
    assert f"Timeout (0:{seconds // 60:02}:{seconds % 60:02})!" in run.stderr
    if where in run.stderr:
      break
  assert where in run.stderr
