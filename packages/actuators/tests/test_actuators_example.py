"""The example that stands alone: it runs, does what it says, and needs nothing above this package."""

import re
import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).parents[1] / "examples" / "plain_mujoco.py"
REPORT = "; import sys; print('imports', *sorted({name.split('.')[0] for name in sys.modules}))"


def test_the_example_drives_both_wheels_to_their_target_with_this_package_alone() -> None:
  code = f"import runpy; runpy.run_path({str(EXAMPLE)!r}, run_name='__main__')" + REPORT
  run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
  assert run.returncode == 0, run.stderr
  reached = [float(angle) for angle in re.findall(r": (\S+) rad after", run.stdout)]
  assert len(reached) == 2
  assert all(abs(angle - 2.0) < 0.02 for angle in reached), run.stdout
  fastest = re.search(r"fastest: (\S+) rad/s", run.stdout)
  assert fastest is not None
  assert float(fastest[1]) < 6.0
  imported = run.stdout.split("imports ")[1].split()
  assert {name for name in imported if name.startswith("mjlab") or name == "warp"} == {"mjlab_core", "mjlab_actuators"}
