"""What a user waits for at every prompt imports neither torch nor a simulator."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = {"torch", "warp", "mujoco", "mujoco_warp", "numpy", "scipy", "gymnasium", "rsl_rl", "tensordict"}
HEAVY |= {"rich", "tyro", "viser"}


def imported_by(statement: str) -> set[str]:
  """Top-level modules that are loaded in a fresh interpreter after a statement."""
  return {name.partition(".")[0] for name in modules_after(statement)}


def modules_after(statement: str) -> set[str]:
  """All modules that are loaded in a fresh interpreter after a statement."""
  report = f"{statement}\nimport json, sys\njson.dump(sorted(sys.modules), sys.stderr)"
  run = subprocess.run([sys.executable, "-c", report], capture_output=True, text=True, check=True)
  return set(json.loads(run.stderr))


@pytest.mark.parametrize(
  "statement",
  [
    "import mjlab",
    "import mjlab; mjlab.__all__; dir(mjlab)",
    "import mjlab; assert mjlab.list_tasks()",
    "from mjlab.cli import main; assert main(['--help']) == 0",
    "from mjlab.cli import main; assert main(['--version']) == 0",
    "from mjlab.cli import train; assert train(['--help']) == 0",
    "from mjlab.cli import evaluate; assert evaluate(['--help']) == 0",
    "from mjlab.cli import play; assert play(['--help']) == 0",
    "from mjlab.cli import export_scene; assert export_scene(['--help']) == 0",
    "from mjlab.cli import demo; assert demo(['--help']) == 0",
    "from mjlab.cli import list_envs; assert list_envs(['--help']) == 0",
    "from mjlab.cli import list_envs; assert list_envs([]) == 0",
    "from mjlab.cli import viz_nan; assert viz_nan(['--help']) == 0",
    "from mjlab.cli import train_actuator; assert train_actuator(['--help']) == 0",
    "from mjlab.cli import new; assert new(['--help']) == 0",
    "from mjlab.cli import inspect_dr; assert inspect_dr(['--help']) == 0",
    "from mjlab.cli import convert_motion; assert convert_motion(['--help']) == 0",
    "from mjlab.cli import export; assert export(['--help']) == 0",
    "from mjlab.cli import sysid; assert sysid(['--help']) == 0",
  ],
)
def test_help_and_listing_import_nothing_heavy(statement: str) -> None:
  assert not imported_by(statement) & HEAVY


def test_help_on_a_word_imports_the_task_once_and_then_nothing_heavy(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
  statement = "from mjlab.cli import train; assert train(['Mjlab-Cartpole-Balance', '--help', 'seed']) == 0"
  assert "torch" in imported_by(statement)
  assert not imported_by(statement) & HEAVY
  # A module of the task that changed is read again.
  (kept,) = tmp_path.rglob("*.json")
  text = kept.read_text()
  contents = json.loads(text)
  assert any("mjlab_cartpole" in file for file in contents["files"])
  contents["files"][next(iter(contents["files"]))][1] += 1
  for stale in (json.dumps(contents), text[:100], "[]"):
    kept.write_text(stale)
    assert "torch" in imported_by(statement)


def test_a_misspelt_task_is_refused_before_anything_heavy_is_imported() -> None:
  statement = (
    "import io, sys; err, sys.stderr = sys.stderr, io.StringIO()\n"
    "from mjlab.cli import train; assert train(['Mjlab-Velocty-Flat-Unitree-Go1']) == 2\n"
    "assert 'Mjlab-Velocity-Flat-Unitree-Go1' in sys.stderr.getvalue(); sys.stderr = err"
  )
  assert not imported_by(statement) & HEAVY


def test_the_measure_sees_a_heavy_import() -> None:
  assert "torch" in imported_by("import mjlab; mjlab.Simulation")


def test_the_page_of_the_demo_opens_without_learner_compiler_or_warp() -> None:
  loaded = modules_after(
    "from mjlab.cli import _play, demo; _play._until_interrupted = lambda run: 0\n"
    "assert demo('--device cpu --num-envs 1 --port 8740'.split()) == 0"
  )
  assert {"torch", "viser", "mjlab_viewer.browser.viewer"} <= loaded
  # A bundle runs in ONNX Runtime.
  unneeded = {"rsl_rl", "tensordict", "tensorboard", "git", "onnx", "matplotlib", "sympy"}
  assert not (unneeded | {"warp", "mujoco_warp", "torch._dynamo", "torch._inductor", "torch.onnx"}) & loaded
