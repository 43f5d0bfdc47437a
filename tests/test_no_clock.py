"""Tests wait for conditions and drive frames and events; they do not measure time."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
CLOCKS = {"sleep", "monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns", "process_time", "wait_for_timeout"}
# Each waits for a condition and gives up after minutes.
WAITS = {
  "packages/deploy/tests/test_deploy_unitree_dds.py",
  "packages/mjlab/tests/mjlab_command.py",
  "packages/viewer/tests/viewer_page.py",
}


def clocks(path: Path) -> Iterator[str]:
  for node in ast.walk(ast.parse(path.read_text())):
    if isinstance(node, ast.Call):
      name = getattr(node.func, "attr", getattr(node.func, "id", ""))
      if name in CLOCKS or ast.unparse(node.func) == "time.time":
        yield f"{path.relative_to(ROOT)}:{node.lineno} {ast.unparse(node.func)}"


def test_no_test_reads_a_clock() -> None:
  folders = [*ROOT.glob("packages/*/tests"), *ROOT.glob("tasks/*/tests"), ROOT / "tests"]
  files = [file for folder in folders for file in folder.rglob("*.py")]
  assert len(files) > 200
  found = [place for file in files for place in clocks(file)]
  assert {place.split(":")[0] for place in found} == WAITS, found
