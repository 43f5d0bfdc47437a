"""`train --agent NAME`: another learner behind the same commands."""

from pathlib import Path

import mjlab_pendulum
import pytest
from mjlab import cli
from mjlab_rl import OffPolicyRunnerCfg, load_run

TASK = mjlab_pendulum.TASK
SMALL = (
  "--agent.actor.hidden-dims", "16", "16", "--agent.critic.hidden-dims", "16", "16",
  "--agent.algorithm.batch-size", "32", "--agent.algorithm.learning-starts", "5", "--agent.num-steps-per-env", "10",
  "--agent.algorithm.updates-per-step", "1",
  "--agent.save-replay", "--agent.logger", "none",
)  # fmt: skip

pytestmark = pytest.mark.usefixtures("pendulum_here")


def run(*words: str) -> None:
  assert cli.main(list(words)) == 0


@pytest.mark.parametrize("name", ["fastsac", "flashsac"])
def test_a_learner_trains_resumes_plays_is_evaluated_and_exported(
  name: str, capsys: pytest.CaptureFixture[str]
) -> None:
  run("train", TASK, "--agent", name, "--device", "cpu", "--agent.max-iterations", "2", *SMALL)
  assert "replay memory:" in capsys.readouterr().out
  (first,) = Path("logs/pendulum").iterdir()
  assert first.name.endswith(f"_{name}")
  assert (first / "replay.pt").is_file()
  assert isinstance(load_run(first).agent, OffPolicyRunnerCfg)
  run("train", TASK, "--resume", "--device", "cpu", "--agent.max-iterations", "3", "--quiet")
  second = next(path for path in Path("logs/pendulum").iterdir() if path != first)
  assert (second / "model_3.pt").is_file()
  run("evaluate", TASK, "--checkpoint", str(second), "--device", "cpu")
  run("export", str(second), "--output", "out", "--steps", "5")
  assert "mjlab-deploy verify out" in capsys.readouterr().out


def test_help_shows_the_flags_of_the_given_learner(capsys: pytest.CaptureFixture[str]) -> None:
  task = "Mjlab-Cartpole-Balance"
  for words, flag in ((["--agent", "fastsac"], "combine"), ([], "clip-param"), (["--agent=flashsac"], "combine")):
    run("train", task, *words, "--help", "algorithm")
    assert f"--agent.algorithm.{flag}" in capsys.readouterr().out
  run("train", task, "--help")
  assert "--agent NAME" in capsys.readouterr().out
