"""`evaluate`: reports, thresholds and exit codes."""

import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

import mjlab_pendulum
import mjlab_rl
import numpy as np
import onnx
import pytest
import torch
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from mjlab import cli
from mjlab.cli.shared import _plots

TASK = mjlab_pendulum.TASK
pytestmark = pytest.mark.usefixtures("pendulum_here")


def evaluate(*words: str) -> int:
  return cli.main(["evaluate", TASK, "--device", "cpu", "--eval.episodes", "6", *words])


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
  folder = tmp_path_factory.mktemp("logs")
  flags = ["--device", "cpu", "--env.rewards.alive.weight", "2.0", "--quiet", "--log-root", str(folder)]
  with mjlab_pendulum.registered():
    assert cli.main(["train", TASK, *flags]) == 0
  return folder


@pytest.fixture
def run(logs: Path, pendulum_here: None) -> Path:
  """Copy of the run for one test."""
  shutil.copytree(logs, "logs")
  (run,) = Path("logs/pendulum").iterdir()
  return run


def test_the_newest_run_is_evaluated_as_it_was_trained_into_its_folder(
  run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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


def test_an_evaluation_is_overwritten_only_with_force(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
  # Actions without a run write no report.
  assert not Path("logs").exists()


def test_progress_is_printed_in_lines_without_a_terminal(
  capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
  monkeypatch.setattr("mjlab.cli.shared._progress.INTERVAL", 0.0)
  assert evaluate("--agent", "zero") == 0
  lines = capsys.readouterr().err.splitlines()
  # 25 steps; the result follows the last one.
  assert len(lines) == 24
  assert re.fullmatch(r"evaluating: 48 %, 0 of 6 episodes done, ETA 0:\d\d:\d\d", lines[11])


def test_the_report_on_a_policy_in_a_package_is_written_into_the_working_folder(
  run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  package, here = tmp_path / "package", tmp_path / "here"
  here.mkdir()
  shutil.copytree(run, package / "policy")
  (package / "__init__.py").write_text("")
  monkeypatch.chdir(here)
  before = sorted(package.rglob("*"))
  assert evaluate("--checkpoint", str(package / "policy")) == 0
  assert (here / "evaluation" / "model_3" / "evaluation.json").is_file()
  assert sorted(package.rglob("*")) == before


@pytest.mark.parametrize("agent", ["trained", "random"])
@pytest.mark.usefixtures("run")
def test_two_evaluations_of_one_policy_agree(agent: str) -> None:
  numbers = []
  for folder in ("one", "two"):
    assert evaluate("--output", folder, "--agent", agent) == 0
    numbers.append(json.loads(Path(folder, "evaluation.json").read_text())["groups"])
  assert numbers[0] == numbers[1]


def test_an_exported_policy_has_the_results_of_its_checkpoint(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
  exported = run / "policy.onnx"
  mjlab_pendulum.write_onnx(run / "model_3.pt", exported)
  model = onnx.load(exported)
  names = {"joint_names": "hinge", "observation_names": "position,velocity", "default_joint_pos": "0.000"}
  onnx.helper.set_model_props(model, names)
  onnx.save(model, exported)
  onnx.helper.set_model_props(model, names | {"joint_names": "elbow"})
  onnx.save(model, run / "other.onnx")
  assert evaluate("--checkpoint", str(run / "other.onnx")) == 1
  assert "joint_names: elbow in the file and hinge here, from position 0" in capsys.readouterr().err
  found = {}
  for source in ("model_3.pt", "policy.onnx"):
    assert evaluate("--checkpoint", str(run / source)) == 0
    found[source] = json.loads((run / "evaluation" / Path(source).stem / "evaluation.json").read_text())
  # As it was trained, with a reward of two a second.
  assert found["policy.onnx"]["groups"]["all"]["return"]["mean"] > 0.8
  for metric, interval in found["model_3.pt"]["groups"]["all"].items():
    assert found["policy.onnx"]["groups"]["all"][metric] == pytest.approx(interval, rel=1e-4), metric
  assert "policy.onnx, 6 episodes on cpu" in capsys.readouterr().out


def test_pictures_show_each_group_without_missing_values(tmp_path: Path) -> None:
  seen: list[Figure] = []

  class Seen(Figure):
    def savefig(self, *arguments: Any, **options: Any) -> None:
      super().savefig(*arguments, **options)
      seen.append(self)

  groups = {
    name: {
      "success_rate": mjlab_rl.Interval(mean=mean, low=mean - 0.1, high=mean + 0.2, count=4),
      "time": mjlab_rl.Interval(mean=math.nan, low=math.nan, high=math.nan, count=0),
    }
    for name, mean in (("all", 0.5), ("a", 0.25), ("b", 0.75))
  }
  lines = {"all": [1.0, 2.0], "a": [1.0, 3.0], "b": [1.0, math.nan]}
  found = mjlab_rl.Evaluation(
    groups=groups, curves={"error": lines, "playing": lines}, units={"time": "s", "error": "m"}
  )
  with pytest.MonkeyPatch.context() as patched:
    patched.setattr("matplotlib.figure.Figure", Seen)
    _plots.plot_groups(found, tmp_path / "groups.png")
    _plots.plot_curves(found, tmp_path / "curves.png")
  for name in ("groups", "curves"):
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
  points, curves = seen
  rate, time = points.axes
  assert [label.get_text() for label in rate.get_yticklabels()] == ["all", "a", "b"]
  assert (rate.get_title(), time.get_title()) == ("success_rate", "time [s]")
  np.testing.assert_array_equal(rate.lines[0].get_xdata(), [0.5, 0.25, 0.75])
  (bars,) = rate.collections
  assert isinstance(bars, LineCollection)
  ends = np.array(bars.get_segments())[:, :, 0]
  np.testing.assert_allclose(ends, [[mean - 0.1, mean + 0.2] for mean in (0.5, 0.25, 0.75)])
  # In the middle of each second; "all" has no line beside its parts.
  error, playing = curves.axes
  assert [line.get_label() for line in error.lines] == ["a", "b"]
  np.testing.assert_array_equal([line.get_ydata() for line in error.lines], [lines["a"], lines["b"]])
  np.testing.assert_array_equal(error.lines[0].get_xdata(), [0.5, 1.5])
  assert (error.get_ylabel(), playing.get_ylabel()) == ("error\n[m]", "playing")


def test_help_shows_settings_of_the_evaluation(capsys: pytest.CaptureFixture[str]) -> None:
  assert cli.main(["evaluate", TASK, "--help", "eval"]) == 0
  assert "--eval.episodes" in capsys.readouterr().out


def test_an_evaluation_with_actions_that_are_not_finite_fails(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
  state = torch.load(run / "model_3.pt", weights_only=True)
  for value in state["actor_state_dict"].values():
    if value.is_floating_point():
      value.fill_(math.nan)
  torch.save(state, run / "model_4.pt")
  assert evaluate("--output", "nan") == 1
  assert "failed: 150 actions of the policy were NaN or infinite" in capsys.readouterr().out
  assert json.loads(Path("nan/evaluation.json").read_text())["nonfinite_actions"] == 150
  assert evaluate("--output", "whole", "--checkpoint", str(run / "model_3.pt")) == 0
  assert cli.main(["train", TASK, "--device", "cpu", "--resume", str(run / "model_4.pt")]) == 1
  assert "model_4.pt: the file has NaN or infinite weights in actor" in capsys.readouterr().err


def test_a_grid_plays_all_combinations(capsys: pytest.CaptureFixture[str]) -> None:
  words = ["Mjlab-Velocity-Flat-Unitree-Go1", "--agent", "zero", "--device", "cpu", "--quiet", "--eval.repeats", "1"]
  words += ["--eval.seconds", "0.06", "--grid", "payload=0,2.5 foot_friction_slide=0.3"]
  assert cli.main(["evaluate", *words]) == 0
  table = capsys.readouterr().out
  assert "payload 2.5" in table
  assert "push 1 m/s, payload 2.5" in table
