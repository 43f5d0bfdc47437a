"""A run folder from a stranger does nothing, whichever command reads it: one line says what is refused."""

import importlib
import json
from pathlib import Path
from typing import Any

import mjlab
import mjlab.registry as registry
import pytest
from mjlab import cli

PACKAGES = Path(__file__).parents[1] / "packages"
TASK = "Test-Pendulum"
ENTRIES = {
  "evaluate": ["evaluate", TASK, "--output", "out", "--checkpoint"],
  "play": ["play", TASK, "--video", "film.mp4", "--checkpoint"],
  "resume": ["train", TASK, "--resume"],
  "init-from": ["train", TASK, "--init-from"],
  "teacher": ["train", f"{TASK}-Distill", "--teacher"],
}


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
  root = tmp_path_factory.mktemp("stranger")
  with pytest.MonkeyPatch.context() as patched:
    register(patched)
    assert cli.main(["train", TASK, "--device", "cpu", "--quiet", "--log-root", str(root)]) == 0
  (run,) = (root / "pendulum").iterdir()
  return run


def register(monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.syspath_prepend(PACKAGES / "mjlab" / "tests")
  monkeypatch.syspath_prepend(PACKAGES / "rl" / "tests")
  import mjlab_pendulum

  monkeypatch.setattr(registry, "_registered", {})
  mjlab.register_task(TASK, mjlab_pendulum.pendulum)
  mjlab.register_task(f"{TASK}-Distill", mjlab_pendulum.taught)


@pytest.mark.parametrize(("offset", "entry"), list(enumerate(ENTRIES)))
def test_a_hostile_manifest_is_refused_by_every_command(
  offset: int, entry: str, run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
  register(monkeypatch)
  hostile_manifests: Any = importlib.import_module("hostile_manifests")

  monkeypatch.chdir(tmp_path)
  checkpoint = str(run_folder / "model_3.pt")
  words = [*ENTRIES[entry], checkpoint, "--device", "cpu"]
  manifest = run_folder / "manifest.json"
  original = manifest.read_text()
  try:
    # The first refusal imports what the command needs.
    manifest.write_text("{}")
    assert cli.main(words) == 1
    variants = hostile_manifests.hostile(json.loads(original))[offset :: len(ENTRIES) - 1]
    assert len(variants) >= 60
    capsys.readouterr()
    for reference, variant in variants:
      manifest.write_text(json.dumps(variant))
      with hostile_manifests.nothing_happens():
        assert cli.main(words) == 1, variant
      error = capsys.readouterr().err
      assert error.count("\n") == 1, error
      assert error.startswith(f"error: manifest {manifest}: ")
      assert reference[:40] in error
  finally:
    manifest.write_text(original)
  assert list(tmp_path.iterdir()) == []
