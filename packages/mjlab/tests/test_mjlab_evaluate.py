"""`evaluate` as a user and as CI meet it."""

import json
from pathlib import Path

import mjlab
import mjlab.registry as registry
import mjlab_pendulum
import pytest
from mjlab import cli

TASK = "Test-Pendulum"


@pytest.fixture(autouse=True)
def _pendulum(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  monkeypatch.setattr(registry, "_registered", {})
  mjlab.register_task(TASK, mjlab_pendulum.pendulum)
  monkeypatch.chdir(tmp_path)


def evaluate(*words: str) -> int:
  return cli.main(["evaluate", TASK, "--device", "cpu", "--eval.episodes", "6", *words])


def trained() -> Path:
  assert cli.main(["train", TASK, "--device", "cpu", "--env.rewards.alive.weight", "2.0", "--quiet"]) == 0
  (run,) = Path("logs/pendulum").iterdir()
  return run


def test_the_newest_run_is_evaluated_as_it_was_trained_into_its_folder(capsys: pytest.CaptureFixture[str]) -> None:
  run = trained()
  assert evaluate() == 0
  folder = run / "evaluation" / "model_3"
  assert sorted(path.name for path in folder.iterdir()) == ["evaluation.json", "evaluation.txt", "groups.png"]
  data = json.loads((folder / "evaluation.json").read_text())
  assert data["task"] == TASK
  assert data["policy"].endswith("model_3.pt")
  assert data["groups"]["all"]["return"]["count"] == 6
  assert data["groups"]["all"]["length"]["mean"] == 25.0
  # The run's reward, twice that of the task: half a second at 2 a second, less a little for joint speed.
  assert 0.8 < data["groups"]["all"]["return"]["mean"] <= 1.0
  shown = capsys.readouterr().out
  assert (folder / "evaluation.txt").read_text() in shown
  assert f"wrote {folder}" in shown


def test_an_evaluation_that_is_there_is_not_overwritten_unasked(capsys: pytest.CaptureFixture[str]) -> None:
  run = trained()
  assert evaluate("--output", "mine") == 0
  before = Path("mine/evaluation.json").read_bytes()
  assert evaluate("--output", "mine") == 2
  assert "--force" in capsys.readouterr().err
  assert Path("mine/evaluation.json").read_bytes() == before
  assert evaluate("--output", "mine", "--force", "--checkpoint", str(run / "model_3.pt")) == 0


def test_the_exit_code_says_whether_thresholds_were_reached(capsys: pytest.CaptureFixture[str]) -> None:
  assert evaluate("--agent", "zero", "--require", "length>=25,failure_rate<=0") == 0
  assert evaluate("--agent", "zero", "--require", "length>=25,return>=99") == 1
  shown = capsys.readouterr().out
  assert "all: length 25 >= 25: yes" in shown
  assert ">= 99: NO" in shown
  # Nothing belongs to no run.
  assert not Path("logs").exists()


@pytest.mark.parametrize(
  ("words", "message"),
  [
    (["--agent", "zero", "--require", "length>25"], "expected [GROUP:]METRIC>=NUMBER"),
    (["--agent", "zero", "--require", "lenght>=25"], "metric 'lenght' does not exist. Nearest: length"),
    (["--checkpoint", "gone"], "'gone' is neither a checkpoint nor a run"),
    ([], "no run of Test-Pendulum with a checkpoint"),
    (["--eval.episode", "3"], "--eval.episodes"),
  ],
)
def test_a_mistake_is_one_line(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
  assert evaluate(*words) in (1, 2)
  error = capsys.readouterr().err
  assert message in error
  assert error.startswith("error: ")
  assert error.count("\n") == 1


@pytest.mark.parametrize("agent", ["trained", "random"])
def test_two_evaluations_of_one_policy_agree(agent: str) -> None:
  if agent == "trained":
    trained()
  numbers = []
  for folder in ("one", "two"):
    assert evaluate("--output", folder, "--agent", agent) == 0
    numbers.append(json.loads(Path(folder, "evaluation.json").read_text())["groups"])
  assert numbers[0] == numbers[1]


def test_help_names_what_can_be_set(capsys: pytest.CaptureFixture[str]) -> None:
  assert cli.main(["evaluate", "--help"]) == 0
  assert "--require" in capsys.readouterr().out
  assert cli.main(["evaluate", TASK, "--help", "eval"]) == 0
  assert "--eval.episodes" in capsys.readouterr().out
  assert cli.main(["evaluate", "Test-Pendulun"]) == 2
  assert "Nearest: Test-Pendulum" in capsys.readouterr().err
