"""Command `visualize-terrain`."""

import subprocess
import sys
from pathlib import Path

import pytest
from mjlab import cli


def main(words: list[str]) -> int:
  return cli.main(["visualize-terrain", *words])


def test_an_image_is_written_without_opengl(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  path = tmp_path / "new" / "map.png"
  assert main(["all", "--rows", "2", "--plot", "--image", str(path), "--image-size", "680", "80"]) == 0
  assert "(plot)" in capsys.readouterr().out
  assert path.read_bytes().startswith(b"\x89PNG")


def test_an_image_is_written_with_and_without_opengl(tmp_path: Path) -> None:
  path = tmp_path / "stairs.png"
  command = [sys.executable, "-c", "from mjlab.cli import main; main()", "visualize-terrain", "stairs_up"]
  flags = ["--difficulty", "0.5", "--image", str(path), "--image-size", "160", "90"]
  run = subprocess.run([*command, *flags], capture_output=True, text=True, check=False)
  assert run.returncode == 0, run.stderr
  assert "(rendering)" in run.stdout or "(plot)" in run.stdout
  assert path.stat().st_size > 500


def test_settings_are_read_from_one_flag_and_from_several(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  words = ["stairs_up", "--plot", "--image-size", "80", "60", "--difficulty", "1", "--image"]
  for name, flags in {
    "one": ["--set", "step_height=0,0.3", "platform=2"],
    "several": ["--set", "step_height=0,0.3", "--set=platform=2"],
    "none": [],
  }.items():
    assert main([*words, str(tmp_path / name) + ".png", *flags]) == 0
  one, several, none = ((tmp_path / f"{name}.png").read_bytes() for name in ("one", "several", "none"))
  assert one == several != none
  assert "(plot)" in capsys.readouterr().out
