import importlib
import io
import os
import shutil
import signal
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import mjlab
import mjlab_pendulum
import numpy as np
import pytest
import torch
from mjlab import cli
from mjlab.cli._train import _environment_line
from mjlab.nan_replay import NanReplay
from mjlab_command import running
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import checkpoints, load_run
from mjlab_sim import NanDump
from mjlab_viewer import SnapshotTaker

TASK = mjlab_pendulum.TASK
pytestmark = pytest.mark.usefixtures("pendulum")


def train(root: Path, *flags: str) -> int:
  return cli.main(["train", TASK, "--log-root", str(root), "--device", "cpu", *flags])


def runs(root: Path) -> list[Path]:
  return sorted((root / "pendulum").iterdir())


def test_training_writes_a_run_that_can_be_rebuilt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  assert train(tmp_path, "--env.rewards.joint-speed.weight", "-0.5", "--seed", "7", "--agent.run-name", "mine") == 0
  (directory,) = runs(tmp_path)
  assert directory.name.endswith("_mine")
  assert [path.name for path in checkpoints(directory)] == ["model_3.pt"]
  assert (directory / "progress.csv").read_text().count("\n") == 4
  run = load_run(directory)
  assert run.env.rewards["joint_speed"].weight == -0.5
  assert (run.env.seed, run.agent.seed, run.seed) == (7, 7, 7)
  assert run.command[:2] == ["train", TASK]
  assert run.play is mjlab_pendulum.for_watching
  shown = capsys.readouterr().out
  first = shown.splitlines()[:3]
  assert first[0].startswith(f"{TASK}: 8 environments (--env.scene.num-envs sets it) on cpu (")
  assert first[1] == "engine native, every step runs eagerly"
  versions = first[2].split(", ")
  for package in ("mjlab", "mujoco", "mujoco-warp", "rsl-rl-lib"):
    assert f"{package} {metadata.version(package)}" in versions
  backend = f"CUDA {torch.version.cuda}" if torch.version.cuda else "CPUs"
  assert f"torch {metadata.version('torch')} (built for {backend})" in versions
  assert f"done: 3 iterations, {directory / 'model_3.pt'}" in shown


def repository(folder: Path, **files: str) -> str:
  """Make a repository with one commit; return its name."""
  folder.mkdir()
  for name, text in files.items():
    (folder / f"{name}.py").write_text(text)
  git = ["git", "-C", str(folder), "-c", "user.name=Nobody", "-c", "user.email=nobody@example.org"]
  subprocess.run([*git, "init", "--quiet"], check=True)
  subprocess.run([*git, "add", "--all"], check=True)
  subprocess.run([*git, "commit", "--quiet", "--allow-empty", "--message", folder.name], check=True)
  return subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True).stdout.strip()


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_the_commit_of_a_run_is_that_of_the_code_of_its_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  code = "import mjlab_pendulum\n\n\ndef build():\n  return mjlab_pendulum.pendulum()\n"
  mine = repository(tmp_path / "mine", mjlab_task_of_mine=code)
  repository(tmp_path / "elsewhere")
  installed = tmp_path / "elsewhere" / "mjlab_installed_task.py"
  installed.write_text(code)
  monkeypatch.chdir(tmp_path / "elsewhere")
  for folder in ("mine", "elsewhere"):
    monkeypatch.syspath_prepend(str(tmp_path / folder))
  for name in ("mjlab_task_of_mine", "mjlab_installed_task"):
    mjlab.register_task(f"Test-{name}", importlib.import_module(name).build)
    flags = ["--log-root", str(tmp_path / name), "--device", "cpu", "--agent.max-iterations", "1", "--quiet"]
    assert cli.main(["train", f"Test-{name}", *flags]) == 0
  assert [load_run(runs(tmp_path / name)[0]).git for name in ("mjlab_task_of_mine", "mjlab_installed_task")] == [
    {"commit": mine, "dirty": False},
    None,
  ]


@pytest.mark.parametrize(
  ("device", "engine", "capture", "said"),
  [
    ("cuda", "warp", True, "engine warp, every step replayed as one recorded graph"),
    ("cuda", "warp", False, "engine warp, every step runs eagerly"),
    ("cpu", "warp", True, "engine warp, physics replayed as recorded graphs, the rest of every step runs eagerly"),
    ("cpu", "warp", False, "engine warp, every step runs eagerly"),
    ("cpu", "native", True, "engine native, every step runs eagerly"),
  ],
)
def test_the_line_about_the_engine_names_recorded_parts(device: str, engine: str, capture: bool, said: str) -> None:
  sim = SimpleNamespace(device=torch.device(device), engine=engine, cfg=SimpleNamespace(capture=capture))
  assert _environment_line(SimpleNamespace(sim=sim)) == said


def test_a_task_needs_no_flags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.chdir(tmp_path)
  assert cli.train([TASK]) == 0
  assert [path.name for path in checkpoints(*runs(Path("logs")))] == ["model_3.pt"]


def test_resume_takes_the_configuration_of_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  assert train(tmp_path, "--env.rewards.joint-speed.weight", "-0.5", "--env.scene.num-envs", "4", "--quiet") == 0
  assert capsys.readouterr().out == ""
  assert train(tmp_path, "--resume", "--agent.max-iterations", "5", "--env.rewards.alive.weight", "2") == 0
  first, second = runs(tmp_path)
  run = load_run(second)
  assert [run.env.rewards[name].weight for name in ("alive", "joint_speed")] == [2.0, -0.5]
  assert run.env.scene.num_envs == 4
  assert run.resumed_from == str(first / "model_3.pt")
  assert [path.name for path in checkpoints(second)] == ["model_5.pt"]
  assert "not restored" not in capsys.readouterr().out


def test_a_run_starts_from_the_policy_of_another_task(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  mjlab.register_task("Test-Taught", mjlab_pendulum.taught)
  assert train(tmp_path, "--quiet") == 0
  (teacher,) = runs(tmp_path)
  flags = ["--log-root", str(tmp_path), "--device", "cpu", "--quiet"]
  assert cli.main(["train", "Test-Taught", "--teacher", str(teacher), *flags]) == 0
  (student,) = (tmp_path / "taught").rglob("model_2.pt")
  for named in ("Test-Taught", str(student.parent), str(student)):
    capsys.readouterr()
    assert train(tmp_path, "--init-from", named) == 0
    assert f"starting from {student}" in capsys.readouterr().out
    begun = load_run(runs(tmp_path)[-1])
    assert begun.init_from is not None
    assert (begun.init_from.task, begun.init_from.iterations) == ("Test-Taught", 2)
  assert train(tmp_path, "--init-from", "Test-Taught", "--agent.actor.activation", "relu") == 1
  assert "agent.actor.activation was elu in its training and is relu here" in capsys.readouterr().err


def test_a_teacher_is_named_by_its_task(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  mjlab.register_task("Test-Taught", mjlab_pendulum.taught)
  flags = ["--log-root", str(tmp_path), "--device", "cpu"]
  assert cli.main(["train", "Test-Taught", "--teacher", "Test-Pendulun", *flags]) == 2
  assert "no teacher: 'Test-Pendulun' is neither" in (error := capsys.readouterr().err)
  assert "Nearest task: Test-Pendulum" in error
  assert train(tmp_path, "--agent.max-iterations", "1", "--quiet") == 0
  checkpoint = runs(tmp_path)[0] / "model_1.pt"
  assert cli.main(["train", "Test-Taught", "--teacher", TASK, *flags]) == 0
  assert f"imitating {checkpoint}\n" in capsys.readouterr().out
  assert cli.main(["train", "Test-Taught", "--teacher", TASK, str(checkpoint), *flags]) == 0
  assert f"imitating {checkpoint}, {checkpoint}\n" in capsys.readouterr().out


def test_a_given_number_of_environments_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setattr("mjlab.environments.default_num_envs", lambda device, configured: 2)
  for flags, worlds in (([], 2), (["--env.scene.num-envs", "8"], 8), (["--env.scene.num-envs=3"], 3)):
    assert train(tmp_path, "--agent.max-iterations", "1", *flags) == 0
    assert load_run(runs(tmp_path)[-1]).env.scene.num_envs == worlds


def test_names_that_the_terminal_cannot_show_are_escaped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  terminal = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
  monkeypatch.setattr(sys, "stdout", terminal)
  assert train(tmp_path / "Läufe", "--agent.max-iterations", "1") == 0
  terminal.flush()
  assert b"L\\xe4ufe" in terminal.buffer.getvalue()


def test_help_of_a_task_can_be_searched(capsys: pytest.CaptureFixture[str]) -> None:
  shown = []
  for words in (["help", "list-envs"], *(["train", TASK, *more] for more in (["-h"], ["-h", "joint_speed"]))):
    assert cli.main(words) == 0
    shown.append(capsys.readouterr().out)
  assert shown[0].startswith("usage: list-envs [KEYWORD]")
  assert "--agent.algorithm.learning-rate FLOAT" in shown[1]
  assert "--resume" in shown[1]
  assert "--env.rewards.joint-speed.weight FLOAT" in shown[2]
  assert "--agent" not in shown[2]
  assert cli.main(["train", TASK, "--help", "joint", "speed"]) == 0
  assert capsys.readouterr().out == shown[2]


def test_list_envs_filters_and_succeeds(capsys: pytest.CaptureFixture[str]) -> None:
  assert cli.list_envs(["pendul"]) == 0
  assert capsys.readouterr().out.splitlines()[1:] == ["Test-Pendulum  (registered)"]
  assert cli.list_envs(["no-such-task"]) == 0


def test_traceback_shows_the_traceback_of_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  assert train(tmp_path, "--env.decimation", "0", "--traceback") == 2
  assert "Traceback" in capsys.readouterr().err


def test_mistakes_and_viewers_without_a_trained_policy_import_no_learner(tmp_path: Path) -> None:
  code = """
import shlex, sys, mjlab.cli._play as play
from mjlab.cli import main
play._browser = lambda *_: 0
for line in sys.argv[1:]:
  print(line, main(shlex.split(line)))
  assert not {"rsl_rl", "tensordict", "torch._dynamo"} & set(sys.modules), line
"""
  task = "Mjlab-Cartpole-Balance"
  watching = f"play {task} --agent zero --viewer browser --device cpu --num-envs 1"
  codes = {
    f"train {task} --no-such-flag 1": 2,
    f"train {task} --resume nothing": 2,
    f"evaluate {task} --require nothing": 2,
    f"record-motion {task}": 2,
    f"inspect-dr {task} --num-envs 1": 2,
    watching: 0,
  }
  done = subprocess.run([sys.executable, "-c", code, *codes], cwd=tmp_path, capture_output=True, text=True, check=False)
  assert done.returncode == 0, done.stderr
  for line, expected in codes.items():
    assert f"{line} {expected}\n" in done.stdout


@pytest.mark.parametrize(
  ("given", "set_by_import"),
  [({}, ["PASSIVE", "1000"]), ({"OMP_WAIT_POLICY": "ACTIVE"}, ["ACTIVE", None])],
)
def test_import_lets_threads_of_torch_sleep(given: dict[str, str], set_by_import: list[str]) -> None:
  names = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
  env = {name: value for name, value in os.environ.items() if name not in names} | given
  code = f"import os, sys, mjlab; assert 'torch' not in sys.modules; print([os.environ.get(name) for name in {names}])"
  done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
  assert done.stdout.strip() == str(set_by_import)


def test_ctrl_c_saves_and_exits_cleanly(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  step, calls = ManagerBasedRlEnv.step, []

  def interrupted(env: ManagerBasedRlEnv, action: torch.Tensor) -> Any:
    calls.append(1)
    if len(calls) == 12:
      os.kill(os.getpid(), signal.SIGINT)
    return step(env, action)

  monkeypatch.setattr(ManagerBasedRlEnv, "step", interrupted)
  assert train(tmp_path, "--agent.max-iterations", "100_000", "--verbose") == 0
  rest = capsys.readouterr().out
  assert "stopped (SIGINT) after" in rest
  (directory,) = runs(tmp_path)
  assert f"continue with: train {TASK} --resume {directory}" in rest
  assert [path.name for path in checkpoints(directory)] == ["model_2.pt"]


def test_ctrl_c_ends_a_viewer_that_started_in_the_background() -> None:
  code = (
    "import sys, mjlab, mjlab_pendulum; mjlab.register_task('Test-Pendulum', mjlab_pendulum.pendulum);"
    "from mjlab.cli import main; sys.exit(main(sys.argv[1:]))"
  )
  flags = ["--viewer", "browser", "--port", "8640", "--agent", "zero", "--device", "cpu"]
  with running(code, "play", TASK, *flags, is_background=True, PYTHONPATH=str(Path(__file__).parent)) as viewer:
    viewer.wait_for(r"open http://\S+ \(Ctrl-C ends\)")
    assert viewer.interrupt().strip() == ""


def test_a_diverged_environment_leaves_a_dump_that_viz_nan_explains(
  tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
  assert train(tmp_path, "--env.sim.gravity", "0", "0", "-1e308") == 0
  (directory,) = runs(tmp_path)
  dumps = sorted((directory / "nan_dumps").iterdir())
  assert dumps
  capsys.readouterr()
  assert cli.main(["viz-nan", str(dumps[0])]) == 0
  report = capsys.readouterr().out
  assert "of joint 'robot/hinge' was " in report
  assert "MuJoCo C diverges too" in report
  assert f"see it: viz-nan {dumps[0]} --viewer browser" in report

  replay = NanReplay(NanDump.load(dumps[0]))
  shown = []
  for _ in range(replay.num_steps):
    shown.append(SnapshotTaker(replay).take([0]))
    replay.step(None)
  world = NanDump.load(dumps[0]).worlds[0]
  stored = [snapshot.data["qpos"][0] for snapshot in shown[-world.num_steps - 1 : -1]]
  qpos = world.states["qpos"][:-1]
  np.testing.assert_array_equal(stored, np.where(np.abs(qpos) <= 1e10, qpos, stored[-1]))
  # Values fit into single precision.
  assert all((np.abs(snapshot.data["xpos"]) < 1e12).all() for snapshot in shown)

  film = tmp_path / "film.mp4"
  if cli.main(["viz-nan", str(dumps[0]), "--video", str(film)]) == 0:
    with av.open(str(film)) as container:
      assert sum(1 for _ in container.decode(video=0)) == replay.num_steps
  else:
    assert "no pictures" in capsys.readouterr().err
