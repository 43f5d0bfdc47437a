"""`mjlab new task` writes packages that build, install and train."""

from pathlib import Path

import pytest
from mjlab.cli import main
from new_package import install, run_tests

QUADRUPED = Path(__file__).parent / "models" / "quadruped.xml"


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_packages_of_every_family_build_install_and_train(
  monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  assert main(["new", "robot", str(QUADRUPED), "--name", "four_legs"]) == 0
  monkeypatch.syspath_prepend("four_legs/src")
  assert main(["new", "task", "four_legs_walk", "--like", "velocity", "--robot", "four_legs"]) == 0
  names = [f"my_{family}" for family in ("velocity", "tracking", "lift", "empty")]
  for name in names:
    assert main(["new", "task", name, "--like", name.removeprefix("my_")]) == 0
  packages = [Path("four_legs_walk"), *map(Path, names)]
  installed = Path("installed").resolve()
  install(Path("four_legs"), *packages, into=installed)
  run_tests(*packages, installed=installed)
  monkeypatch.syspath_prepend(str(installed))
  capsys.readouterr()
  assert main(["list-envs", "my-"]) == 0
  assert "My-Velocity" in capsys.readouterr().out


@pytest.mark.parametrize(
  ("words", "message"),
  [
    ([], "no NAME given. usage: new task NAME"),
    (["My-Walk"], "is not a package name"),
    (["class"], "is not a package name"),
    (["torch"], "installed already"),
    (["mjlab_cartpole_balance"], "a task 'Mjlab-Cartpole-Balance' exists already"),
    (["walk", "--like", "velocty"], "--like"),
    (["walk", "--like", "lift", "--robot", "go1"], "only tasks like velocity take a robot"),
    (["walk", "--like", "velocity", "--robot", "os; import sys"], "is installed"),
    (["walk", "--output", "here"], "here exists; nothing is overwritten"),
  ],
)
def test_a_mistake_is_one_line_and_writes_nothing(
  words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
  Path("here").mkdir()
  assert main(["new", "task", *words]) == 2
  error = capsys.readouterr().err
  assert message in error
  assert len(error.splitlines()) == 1
  assert [*Path().rglob("*")] == [Path("here")]
