"""Task packages from elsewhere, written against the public API, train, play and are evaluated."""

import re
from pathlib import Path

import mjlab
import pytest
from mjlab.cli import main
from mjlab_core import RenderingError
from mjlab_viewer.pictures.opengl import make_context
from new_package import install

PORTS = Path(__file__).parent / "ports"
CPU = ["--device", "cpu"]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
  folder = tmp_path_factory.mktemp("installed") / "site"
  install(*sorted(path.parent for path in PORTS.glob("*/pyproject.toml")), into=folder)
  return folder


@pytest.mark.parametrize(
  ("task", "evaluation"),
  [
    ("Port-Wheeled-Biped-Balance", ["--eval.episodes", "4"]),
    ("Port-Trotting-Dog", ["--eval.repeats", "1", "--eval.pushes", "0.5", "--eval.seconds", "0.5"]),
  ],
)
def test_a_port_trains_plays_and_is_evaluated(
  task: str, evaluation: list[str], installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  monkeypatch.syspath_prepend(str(installed))
  monkeypatch.chdir(tmp_path)
  assert task in mjlab.list_tasks()
  size = ["--env.scene.num-envs", "4", "--agent.num-steps-per-env", "8", "--agent.max-iterations", "2"]
  assert main(["train", task, *CPU, *size, "--quiet"]) == 0
  assert list(tmp_path.rglob("model_*.pt"))
  assert main(["evaluate", task, *CPU, *evaluation, "--quiet"]) == 0
  try:
    make_context(32, 32).free()
  except RenderingError as error:
    pytest.skip(str(error))
  film = ["--video", "film.mp4", "--video-length", "0.1", "--video-width", "64", "--video-height", "48"]
  assert main(["play", task, *CPU, *film]) == 0
  assert Path("film.mp4").stat().st_size > 0


def test_ports_import_only_public_names() -> None:
  for path in PORTS.rglob("*.py"):
    for line in re.findall(
      r"^from (mjlab\S*) import|^import (mjlab\S*)", path.read_text(encoding="utf-8"), re.MULTILINE
    ):
      module = "".join(line)
      assert re.fullmatch(r"mjlab_\w+(\.mdp)?", module), f"{path.name}: {module}"
