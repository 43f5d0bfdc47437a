import re
from collections.abc import Generator
from pathlib import Path
from typing import Any

import mjlab
import mjlab_pendulum
import pytest
from mjlab import cli
from mjlab_rl import TaskCfg

ROOT = Path(__file__).parents[3]
TASK = mjlab_pendulum.TASK
WITH_TASK = ("train", "play", "evaluate", "record-motion", "inspect-dr", "design-excitation", "sweep", "export-scene")
WITH_FILE = {
  "convert-motion": "a.csv",
  "export": "run",
  "viz-nan": "a.npz",
  "sysid": "a.csv",
  "train-actuator": "a.csv",
}

WRONG = [
  *((command, "no TASK given") for command in WITH_TASK),
  *((f"{command} Nope", "task 'Nope' does not exist") for command in WITH_TASK),
  *((f"{command} {TASK} --nope 1", "--nope: no such option") for command in WITH_TASK),
  *((f"{command} {TASK} --traceback 1", "--traceback: expected no value") for command in WITH_TASK[:-1]),
  *((command, " given. usage: ") for command in WITH_FILE),
  *((f"{command} {file} --nope 1", "--nope: no such option") for command, file in WITH_FILE.items()),
  ("trian", "command 'trian' does not exist. Nearest: train"),
  ("demo --task run", "demo 'run' does not exist"),
  ("demo walk", "'walk': not a flag"),
  ("list-envs --nope", "--nope: no such option"),
  ("visualize-terrain nope", "type 'nope' does not exist"),
  ("visualize-terrain --rows 0", "rows 0 must be at least 1"),
  (f"train {TASK} --device gpu", "device 'gpu' does not exist"),
  (f"train {TASK} --device cpu --resume gone", "'gone' is neither a checkpoint nor a run"),
  (f"train {TASK} --device cpu --agent.max-iterations 0", "agent.max_iterations must be at least 1, got 0"),
  (f"train {TASK} --device cpu --env.decimation 0", "env.decimation: must be at least 1, got 0"),
  (f"train {TASK} --device cpu --video --video-length 0", "--video-length must be at least 1, got 0"),
  (f"play {TASK} --device cpu --checkpoint gone.onnx", "'gone.onnx' is neither a checkpoint nor a run"),
  (f"evaluate {TASK} --device cpu --checkpoint gone", "'gone' is neither a checkpoint nor a run"),
  (f"evaluate {TASK} --agent zero --require x", "--require: threshold 'x'"),
  ("convert-motion gone.csv", "gone.csv: no such file"),
  ("convert-motion march_in_place --robot nope", "robot 'nope' does not exist"),
  ("convert-motion march_in_place --crop 5 1", "cannot crop it to 5 .. 1 s"),
  ("export gone", "'gone' is neither a checkpoint nor a run"),
  ("viz-nan gone.npz", "gone.npz: no such file"),
  ("train-actuator gone.csv", "gone.csv: no such file"),
]

FAILED = [
  ("convert-motion damaged.csv", "damaged.csv"),
  ("viz-nan damaged.npz", "not an .npz file"),
  ("train-actuator damaged.csv", "damaged.csv"),
  (f"export-scene {TASK} --output damaged.csv/folder", "damaged.csv"),
]


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[None]:
  monkeypatch.chdir(tmp_path)
  for name in ("damaged.csv", "damaged.npz"):
    Path(name).write_text("nothing\n")
  with mjlab_pendulum.registered():
    yield


@pytest.mark.parametrize(("line", "message"), WRONG)
def test_a_wrong_command_line_ends_with_two_and_one_line(
  line: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
  assert cli.main(line.split()) == 2
  error = capsys.readouterr().err
  assert error.startswith("error: ")
  assert error.count("\n") == 1
  assert message in error


@pytest.mark.parametrize(("line", "message"), FAILED)
def test_a_failure_ends_with_one_and_one_line(line: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
  assert cli.main(line.split()) == 1
  error = capsys.readouterr().err
  assert message in error
  assert error.count("\n") == 1


def test_a_configuration_that_is_wrong_without_flags_is_a_failure(capsys: pytest.CaptureFixture[str]) -> None:
  def broken() -> "TaskCfg[Any]":
    task = mjlab_pendulum.pendulum()
    task.env.decimation = 0
    return task

  mjlab.register_task("Test-Broken", broken)
  assert cli.main(["inspect-dr", "Test-Broken", "--num-envs", "2"]) == 1
  assert "decimation must be at least 1, got 0" in capsys.readouterr().err


def test_the_table_in_the_documents_has_every_command_and_only_flags_that_exist(
  capsys: pytest.CaptureFixture[str],
) -> None:
  assert cli.main([]) == 2
  commands = {line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("  ")}
  rows = re.findall(r"^\| `([\w-]+)` \|(.*)$", (ROOT / "docs/commands.md").read_text(), re.MULTILINE)
  assert {name for name, _ in rows} == commands
  for name, cells in rows:
    cli.main(["play" if name == "demo" else name, "--help"])
    shown = capsys.readouterr().out
    for flag in re.findall(r"`(--[\w-]+)`", cells):
      assert f"  {flag} " in shown, (name, flag)


@pytest.mark.parametrize("command", sorted({*WITH_TASK, *WITH_FILE, "demo", "visualize-terrain"}))
def test_every_flag_has_one_line_with_its_choices_and_default(command: str, capsys: pytest.CaptureFixture[str]) -> None:
  assert cli.main([command, "--help"]) == 0
  shown = capsys.readouterr().out.partition("flags:\n")[2].partition("  --help")[0]
  lines = [line for line in shown.splitlines() if line.startswith("  --")]
  assert lines
  for line in lines:
    assert re.match(r"  --[\w-]+( [^\[\]]+)? \[[^\]]+\]( |$)", line), line
