"""Commands of the README for distillation, with small settings."""

import json
import re
import shlex
from pathlib import Path
from typing import Any

import mjlab
import pytest
import torch
from mjlab import cli
from mjlab.environments import standard_env
from mjlab_manipulation import LiftEvaluation
from mjlab_manipulation.mdp import lift_command
from mjlab_rl import Console, RslRlDistillationRunnerCfg, RslRlModelCfg, RslRlVecEnvWrapper, load_run
from mjlab_rl.onpolicy.distillation import runner_class

README = Path(__file__).parents[1] / "tasks" / "manipulation" / "README.md"
TEACHER = "Mjlab-Lift-Cube-Yam"
STUDENT = "Mjlab-Lift-Cube-Yam-Depth-Distill"
FEW = ["--env.scene.num-envs", "4", "--agent.num-steps-per-env", "8"]
SMALL = {
  "train": ["--quiet", *FEW],
  "evaluate": ["--eval.episodes", "2", "--eval.seconds", "1", "--quiet"],
  "play": ["--video", "film.mp4", "--video-length", "0.1", "--video-width", "64", "--video-height", "64"],
}


def recipe() -> list[list[str]]:
  (block,) = re.findall(r"## Distil a policy.*?```bash\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
  return [shlex.split(line, comments=True) for line in block.splitlines()]


def run(words: list[str], *more: str) -> int:
  return cli.main([*words, "--device", "cpu", *more])


@pytest.mark.warp
def test_the_recipe_of_the_readme_runs_from_teacher_to_resumed_student(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  monkeypatch.chdir(tmp_path)
  pixels = ["--env.scene.sensors.wrist-camera.width", "16", "--env.scene.sensors.wrist-camera.height", "16"]
  for words in recipe():
    small = [*SMALL[words[0]], *(pixels if words[0] == "train" and words[1] != TEACHER else [])]
    if "--agent.max-iterations" in words:
      small += ["--agent.max-iterations", "2"]
    elif words[0] == "train":
      small += ["--agent.max-iterations", "1"]
    assert run(words, *small) == 0, words
  (taught,), students = (sorted(Path("logs", name).iterdir()) for name in ("yam_lift_cube", "yam_lift_cube_distill"))
  assert (Path("film.mp4").stat().st_size > 0, len(students)) == (True, 2)
  for student in students:
    manifest = load_run(student)
    assert isinstance(manifest.agent, RslRlDistillationRunnerCfg)
    assert manifest.teacher is not None
    assert Path(manifest.teacher.checkpoint).parent.resolve() == taught.resolve()
    assert manifest.env.scene.sensors["wrist_camera"].width == 16
  assert (students[1] / "model_2.pt").is_file()
  (begun,) = Path("logs", "yam_lift_cube_vision").iterdir()
  source = load_run(begun).init_from
  assert source is not None
  assert Path(source.checkpoint).resolve() == (students[1] / "model_2.pt").resolve()
  header = (students[0] / "progress.csv").read_text().splitlines()[0].split(",")
  # The difference to the teacher, and what is said of any training of the task.
  assert {"Loss/behavior", "Episode_Reward/lift", "Episode_Metrics/held"} <= set(header)
  for directory in (taught, students[0]):
    (evaluation,) = directory.glob("evaluation/*/evaluation.json")
    assert "success_rate" in json.loads(evaluation.read_text())["groups"]["all"]


@pytest.mark.warp
def test_teacher_and_student_are_judged_on_the_same_starts_and_goals() -> None:
  def scenarios(name: str) -> torch.Tensor:
    task = mjlab.load_task(name)
    assert isinstance(task.evaluator, LiftEvaluation)
    task.evaluator.episodes = 4
    with standard_env(task.evaluator.configure(task.env), device="cpu") as env:
      env.reset(seed=task.evaluator.seed)
      term = lift_command(env, task.evaluator.command)
      friction = env.sim.model.geom_friction[:, 1:, 0]
      return torch.cat((term.object_pos_w, term.command, friction), dim=1)

  taught, seen = scenarios("Mjlab-Lift-Cube-Yam"), scenarios(STUDENT)
  assert torch.equal(taught, seen)
  assert not torch.equal(taught[0], taught[1])


@pytest.mark.parametrize(
  ("words", "message"),
  [
    ([STUDENT], "no teacher: no run of Mjlab-Lift-Cube-Yam with a checkpoint in logs/yam_lift_cube. Train one with"),
    ([STUDENT, "--teacher", "nowhere"], "no teacher: 'nowhere' is neither a checkpoint nor a run"),
    ([STUDENT, "--teacher", "x", "--resume", "y"], "exclude each other"),
    (["Mjlab-Lift-Cube-Yam-Depth", "--teacher", "x"], "--teacher applies to distillation tasks only"),
  ],
)
def test_a_wrong_teacher_is_refused_in_one_line(
  words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  monkeypatch.chdir(tmp_path)
  assert cli.train([*words, "--device", "cpu"]) != 0
  printed = capsys.readouterr().err
  assert message in printed
  assert printed.count("\n") == 1
  assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("name", ["Mjlab-Lift-Cube-Yam-Depth", STUDENT])
@pytest.mark.parametrize("rnn_type", [None, "gru", "lstm"])
def test_rollouts_that_see_never_wait_for_a_gpu(name: str, rnn_type: Any) -> None:
  task = mjlab.load_task(name)
  agent, device = task.agent, "cuda:0"
  getattr(agent, agent.policy).rnn_type = rnn_type
  if isinstance(agent, RslRlDistillationRunnerCfg):
    agent.teacher = RslRlModelCfg()
  task.env.scene.num_envs = 64
  with standard_env(task.env, device=device) as env:
    wrapped = RslRlVecEnvWrapper(env)
    made = runner_class(agent)(wrapped, agent, None, device, console=Console("quiet"))
    observations = made._collect(made.env.get_observations())
    made.alg.storage.clear()
    try:
      torch.cuda.set_sync_debug_mode("error")
      made._collect(observations)
    finally:
      torch.cuda.set_sync_debug_mode("default")
