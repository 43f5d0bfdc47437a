"""Help and listings import neither torch nor a simulator."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from mjlab.cli.shared._task_help import _read

HEAVY = {"torch", "warp", "mujoco", "mujoco_warp", "numpy", "scipy", "gymnasium", "rsl_rl", "tensordict"}
HEAVY |= {"rich", "tyro", "viser"}


def imported_by(statement: str) -> set[str]:
  """Return the top-level modules that a fresh interpreter has after a statement."""
  return {name.partition(".")[0] for name in modules_after(statement)}


def modules_after(statement: str) -> set[str]:
  """Return all modules that a fresh interpreter has after a statement."""
  report = f"{statement}\nimport json, sys\njson.dump(sorted(sys.modules), sys.stderr)"
  run = subprocess.run([sys.executable, "-c", report], capture_output=True, text=True, check=True)
  return set(json.loads(run.stderr.splitlines()[-1]))


def test_help_and_listing_import_nothing_heavy() -> None:
  words = "main train evaluate play export_scene demo viz_nan train_actuator new inspect_dr convert_motion export sysid"
  statements = ["import mjlab", "mjlab.__all__; dir(mjlab)", "assert mjlab.list_tasks()", "from mjlab import cli"]
  statements += [f"assert cli.{word}(['--help']) == 0" for word in [*words.split(), "list_envs"]]
  statements += [
    "assert cli.main(['--version']) == 0",
    "assert cli.list_envs([]) == 0",
    "assert cli.train(['Nope']) == 2",
  ]
  # One after another in one process: whatever one of them imports, stays.
  checked = "".join(f"{line}\nassert not heavy & set(sys.modules), {line!r}\n" for line in statements)
  imported_by(f"import sys; heavy = {HEAVY!r}\n{checked}assert len(sys.modules) < 350, len(sys.modules)")


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
  assert _read(kept)
  for stale in (json.dumps(contents), text[:100], "[]"):
    kept.write_text(stale)
    assert _read(kept) is None


def test_a_misspelt_task_is_refused_before_anything_heavy_is_imported() -> None:
  statement = (
    "import io, sys; err, sys.stderr = sys.stderr, io.StringIO()\n"
    "from mjlab.cli import train; assert train(['Mjlab-Velocty-Flat-Unitree-Go1']) == 2\n"
    "assert 'Mjlab-Velocity-Flat-Unitree-Go1' in sys.stderr.getvalue(); sys.stderr = err"
  )
  assert not imported_by(statement) & HEAVY


def test_the_page_of_the_demo_opens_without_learner_compiler_or_warp() -> None:
  loaded = modules_after(
    "from mjlab.cli import demo\nfrom mjlab.cli.shared import _watching\n_watching.until_interrupted = lambda run: 0\n"
    "assert demo('--device cpu --num-envs 1 --port 8740'.split()) == 0"
  )
  assert {"torch", "viser", "mjlab_viewer.browser.viewer"} <= loaded
  # A bundle runs in ONNX Runtime.
  unneeded = {"rsl_rl", "tensordict", "tensorboard", "git", "onnx", "matplotlib", "sympy", "av"}
  assert not (unneeded | {"warp", "mujoco_warp", "torch._dynamo", "torch._inductor", "torch.onnx"}) & loaded
