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


def test_an_image_is_written_whatever_there_is_of_opengl(tmp_path: Path) -> None:
  path = tmp_path / "stairs.png"
  command = [sys.executable, "-c", "from mjlab.cli import main; main()", "visualize-terrain", "stairs_up"]
  flags = ["--difficulty", "0.5", "--image", str(path), "--image-size", "160", "90"]
  run = subprocess.run([*command, *flags], capture_output=True, text=True, check=False)
  assert run.returncode == 0, run.stderr
  assert "(rendering)" in run.stdout or "(plot)" in run.stdout
  assert path.stat().st_size > 500


@pytest.mark.parametrize(
  ("words", "message"),
  [
    (["stair"], "type 'stair' does not exist. Nearest: stairs_up"),
    (["stairs_up", "--difficulty", "0", "0.5", "1"], "--difficulty must have at most 2 elements, got (0.0, 0.5, 1.0)"),
    (["stairs_up", "--set", "platform=9"], "make the platform at most 5.9 m"),
    (["stairs_up", "--set", "waves.amplitude=0,1"], "there is no type 'waves' here. There are stairs_up"),
    (["stairs_up", "--set", "hight=3"], "there is no setting 'hight'. There are border"),
    (["stairs_up", "--set", "step_height=3"], "must be like (0.0, 0.2), without brackets"),
    (["stairs_up", "--set", "holes"], "must be like False"),
    (["waves", "--seed", "-1"], "seed -1 must be at least 0"),
    (["waves", "--plot", "--image-size", "0", "9"], "--image-size must be at least 1, got (0, 9"),
  ],
)
def test_a_mistake_on_the_command_line_says_what_there_is(
  words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
  assert main([*words, "--image", "never.png"]) == 2
  assert message in capsys.readouterr().err
  assert not Path("never.png").exists()


def test_a_picture_that_cannot_be_written_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  (tmp_path / "file").touch()
  for image, code in ((tmp_path / "file" / "x.png", 1), (tmp_path / "x.jpg", 2)):
    assert main(["flat", "--plot", "--image", str(image), "--image-size", "80", "60"]) == code
    captured = capsys.readouterr()
    assert not captured.out
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert not image.exists()


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
