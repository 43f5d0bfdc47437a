"""`play`, `demo`, `export-scene` and films of trainings."""

import contextlib
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import mjlab
import mjlab.cli._play as play_command
import mjlab_pendulum
import mujoco
import numpy as np
import pytest
import torch
from mjlab import cli
from mjlab_envs import ManagerBasedRlEnv
from mjlab_motions import Kinematics, load_motion, shipped_clips
from mjlab_robots import g1_spec
from mjlab_scene.export import write_spec
from mjlab_viewer import BackgroundVideo, Playback
from mjlab_viewer.native.viewer import KEYS
from mjlab_viewer.snapshot import Snapshot

TASK = mjlab_pendulum.TASK
pytestmark = pytest.mark.usefixtures("pendulum")


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
  """Playbacks and checkpoints that viewers get; each takes ten steps."""
  seen: list[Any] = []

  def look(wanted: object, name: str, playback: Playback, checkpoints: object) -> int:
    playback.pause()
    for _ in range(10):
      playback.step_once()
    seen.append(SimpleNamespace(playback=playback, env=playback.env, policy=playback.policy, checkpoints=checkpoints))
    return 0

  monkeypatch.setattr(play_command, "_browser", look)
  monkeypatch.setattr(play_command, "_native", look)
  return seen


@pytest.fixture(scope="module")
def run_of_two_checkpoints(tmp_path_factory: pytest.TempPathFactory) -> Path:
  folder = tmp_path_factory.mktemp("logs")
  flags = ["--agent.max-iterations", "2", "--agent.save-interval", "1", "--env.rewards.alive.weight", "7", "--quiet"]
  with mjlab_pendulum.registered():
    assert cli.main(["train", TASK, "--log-root", str(folder), "--device", "cpu", *flags]) == 0
  return folder


@pytest.fixture
def logs(run_of_two_checkpoints: Path, tmp_path: Path) -> Path:
  return shutil.copytree(run_of_two_checkpoints, tmp_path, dirs_exist_ok=True)


def play(logs: Path, *flags: str) -> int:
  return cli.main(["play", TASK, "--log-root", str(logs), "--device", "cpu", "--viewer", "browser", *flags])


def test_the_newest_run_is_played_as_it_was_trained(
  logs: Path, watched: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
  assert play(logs) == 0
  (seen,) = watched
  env = seen.env
  assert "model_2.pt" in capsys.readouterr().out
  assert seen.playback.error is None
  assert seen.playback.step_count == 10
  # The weight of the run, with the change for watching.
  assert env.reward_manager.get_term_cfg("alive").weight == 7.0
  assert env.max_episode_length_s == 1e6
  assert env.num_envs == 8


def test_play_opens_a_window_on_a_screen_and_a_page_without_one(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  opened: list[str] = []
  for name in ("browser", "native"):
    monkeypatch.setattr(play_command, f"_{name}", lambda *_, name=name: opened.append(name) or 0)
  for screens in ({}, {"DISPLAY": ":7"}, {"WAYLAND_DISPLAY": "wayland-0"}):
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
      monkeypatch.delenv(variable, raising=False)
    for variable, screen in screens.items():
      monkeypatch.setenv(variable, screen)
    assert cli.main(["play", TASK, "--agent", "zero", "--device", "cpu", "--log-root", str(tmp_path)]) == 0
  assert opened == ["browser", "native", "native"]


def test_the_keys_of_the_window_are_listed(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  class Window(contextlib.nullcontext[Any]):
    def __init__(self, playback: Any, camera: Any) -> None:
      super().__init__(SimpleNamespace(run=lambda: None))

  monkeypatch.setattr("mjlab_viewer.NativeViewer", Window)
  words = ["--agent", "zero", "--device", "cpu", "--viewer", "native", "--log-root", str(tmp_path)]
  assert cli.main(["play", TASK, *words]) == 0
  said = capsys.readouterr().out
  for key, action in KEYS.items():
    assert f"  {key.replace(' ', 'SPACE'):5}  {action}\n" in said


def test_play_takes_a_checkpoint_and_flags_of_the_environment(logs: Path, watched: list[Any]) -> None:
  (checkpoint,) = logs.rglob("model_1.pt")
  assert play(logs, "--checkpoint", str(checkpoint), "--num-envs", "3", "--env.rewards.alive.weight", "2") == 0
  env = watched[0].env
  assert env.num_envs == 3
  assert env.reward_manager.get_term_cfg("alive").weight == 2.0


def test_the_viewer_can_load_other_checkpoints_of_the_run(logs: Path, watched: list[Any]) -> None:
  assert play(logs) == 0
  checkpoints = watched[0].checkpoints
  assert checkpoints.names() == ["model_1.pt", "model_2.pt"]
  assert checkpoints.loaded == "model_2.pt"
  observations = {group: torch.ones(8, 2) for group in ("actor", "critic")}
  with torch.no_grad():
    second = watched[0].policy(observations)
    first = checkpoints.load("model_1.pt")(observations)
  assert not torch.equal(first, second)


@pytest.mark.usefixtures("watched")
def test_a_student_acts_without_observations_of_its_teacher(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  mjlab.register_task("Test-Taught", mjlab_pendulum.taught)
  (teacher,) = logs.rglob("model_2.pt")
  flags = ["--log-root", str(logs), "--device", "cpu"]
  assert cli.main(["train", "Test-Taught", "--teacher", str(teacher), "--quiet", *flags]) == 0
  built: list[ManagerBasedRlEnv] = []

  def build(cfg: Any, *, device: str) -> ManagerBasedRlEnv:
    built.append(ManagerBasedRlEnv(cfg, device=device))
    return built[-1]

  monkeypatch.setattr("mjlab.environments.standard_env", build)
  assert cli.main(["play", "Test-Taught", *flags, "--viewer", "browser"]) == 0
  assert cli.main(["evaluate", "Test-Taught", *flags, "--eval.episodes", "4", "--quiet"]) == 0
  assert [list(env.get_observations()) for env in built] == [["actor"], ["actor"]]


def test_zero_and_random_actions_need_no_run(tmp_path: Path, watched: list[Any]) -> None:
  for agent in ("zero", "random"):
    assert play(tmp_path, "--agent", agent, "--num-envs", "2") == 0
  zero, random = (seen.env for seen in watched)
  assert zero.action_manager.action.abs().max() == 0.0
  assert random.action_manager.action.abs().max() > 0.0


def test_without_terminations_only_time_ends_an_episode(tmp_path: Path, watched: list[Any]) -> None:
  assert play(tmp_path, "--agent", "zero", "--no-terminations") == 0
  env = watched[0].env
  cfgs = [env.termination_manager.get_term_cfg(name) for name in env.termination_manager.active_terms]
  assert [cfg.time_out for cfg in cfgs if cfg.func.__name__ != "nan_detection"] == [True]


@pytest.mark.usefixtures("opengl")
def test_a_film_is_overwritten_only_with_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  film = tmp_path / "film.mp4"
  flags = ["--agent", "random", "--video", str(film), "--video-length", "0.4", "--video-width", "64"]
  arguments = ["play", TASK, "--device", "cpu", "--log-root", str(tmp_path), *flags, "--video-height", "48"]
  assert cli.main(arguments) == 0
  with av.open(str(film)) as container:
    assert container.streams.video[0].average_rate == 25  # every second of 50 steps
    assert sum(1 for _ in container.decode(video=0)) == 10
  before = film.read_bytes()
  assert cli.main(arguments) == 2
  assert "exists; --force overwrites it" in capsys.readouterr().err
  assert film.read_bytes() == before
  assert cli.main([*arguments, "--force"]) == 0


@pytest.mark.usefixtures("opengl")
def test_an_interrupted_film_is_kept(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  step = Playback.step_once

  def interrupted(self: Playback) -> None:
    if self.step_count == 3:
      raise KeyboardInterrupt
    step(self)

  monkeypatch.setattr(Playback, "step_once", interrupted)
  film = tmp_path / "film.mp4"
  flags = ["--agent", "zero", "--video", str(film), "--video-width", "64", "--video-height", "48"]
  assert cli.main(["play", TASK, "--device", "cpu", *flags]) == 130
  assert f"the film of 3 steps up to here is {film}" in capsys.readouterr().out
  with av.open(str(film)) as container:
    assert sum(1 for _ in container.decode(video=0)) == 2


@pytest.mark.usefixtures("opengl")
def test_a_film_of_tracking_shows_the_reference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  # Draw primitives, whose places are compared, although there may be meshes.
  monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
  drawn: list[list[np.ndarray]] = []
  add = BackgroundVideo.add

  def look(self: BackgroundVideo, snapshot: Snapshot) -> None:
    shapes = snapshot.drawings[0].shapes
    drawn.append([s.position[0] + (0.5 * s.direction[0] if s.kind == "line" else 0.0) for s in shapes])
    add(self, snapshot)

  monkeypatch.setattr(BackgroundVideo, "add", look)
  task = "Mjlab-Tracking-Flat-Unitree-G1"
  flags = ["--agent", "zero", "--num-envs", "1", "--no-terminations", "--video", str(tmp_path / "film.mp4")]
  flags += ["--video-length", "0.2", "--video-width", "64", "--video-height", "48"]
  assert cli.main(["play", task, "--device", "cpu", *flags]) == 0
  clip, robot = load_motion(shipped_clips()["squat_and_wave"]), Kinematics(g1_spec(meshes="never").compile())
  assert len(drawn) == 5
  for frame, middles in zip(range(1, 10, 2), drawn, strict=True):
    data = mujoco.MjData(robot.model)
    data.qpos[:] = torch.cat((clip.root_pos[frame], clip.root_quat[frame], clip.joint_pos[frame]))
    mujoco.mj_kinematics(robot.model, data)
    expected = data.geom_xpos[robot.model.geom_group == 2]
    assert len(expected) > 20
    np.testing.assert_allclose(middles, expected, atol=1e-4)


def test_a_film_without_opengl_is_refused_in_one_line(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  monkeypatch.setenv("MUJOCO_GL", "off")
  arguments = ["play", TASK, "--agent", "zero", "--device", "cpu", "--video", str(tmp_path / "film.mp4")]
  assert cli.main(arguments) == 1
  assert capsys.readouterr().err == "error: no pictures: MUJOCO_GL=off switches OpenGL off\n"


def test_an_exported_policy_acts_as_its_checkpoint(
  logs: Path, watched: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
  assert play(logs, "--num-envs", "3") == 0
  trained = watched[0].policy
  (checkpoint,) = logs.rglob("model_2.pt")
  exported = checkpoint.parent / "policy.onnx"
  mjlab_pendulum.write_onnx(checkpoint, exported)
  assert play(logs, "--num-envs", "3", "--checkpoint", str(exported)) == 0
  observations = {"actor": torch.randn(3, 2, generator=torch.Generator().manual_seed(0))}
  with torch.no_grad():
    torch.testing.assert_close(watched[1].policy(observations), trained(observations | {"critic": torch.zeros(3, 2)}))


def test_the_demo_comes_with_the_package_and_walks(monkeypatch: pytest.MonkeyPatch) -> None:
  walked: list[torch.Tensor] = []

  def look(wanted: object, name: str, playback: Playback, checkpoints: object) -> int:
    env = playback.env
    assert isinstance(env, ManagerBasedRlEnv)
    playback.pause()
    for world in range(8):
      env.steering()["twist"].steer(world, (0.8, 0.0, 0.0))
    robot = env.scene["robot"].data
    start = robot.root_link_pos_w.clone()
    for _ in range(200):
      playback.step_once()
    assert playback.error is None
    assert (robot.projected_gravity_b[:, 2] < -0.9).all()
    walked.append((robot.root_link_pos_w - start)[:, :2].norm(dim=1))
    return 0

  monkeypatch.setattr(play_command, "_browser", look)
  assert cli.main(["demo", "--task", "go1", "--device", "cpu", "--num-envs", "8", "--seed", "1"]) == 0
  # Four seconds at 0.8 m/s, less the time to start and turn.
  assert ((walked[0] > 2.4) & (walked[0] < 4.0)).all()


def test_the_demo_lifts_to_the_given_goal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
  away: list[torch.Tensor] = []

  def look(wanted: object, name: str, playback: Playback, checkpoints: object) -> int:
    env = playback.env
    assert isinstance(env, ManagerBasedRlEnv)
    playback.pause()
    goal = torch.tensor([0.4, 0.1, 0.3])
    for world in range(8):
      env.steering()["lift_height"].steer(world, tuple(goal.tolist()))
    # Within the first goal's time.
    for _ in range(150):
      playback.step_once()
    assert playback.error is None
    place = env.scene["cube"].data.root_link_pos_w - env.scene.env_origins
    away.append((place - goal).norm(dim=1))
    return 0

  monkeypatch.setattr(play_command, "_browser", look)
  assert cli.main(["demo", "--task=lift", "--device", "cpu", "--num-envs", "8", "--seed", "1"]) == 0
  # At most one of eight cubes may slip away.
  assert int((away[0] < 0.05).sum()) >= 7


def test_a_scene_is_exported_whole_and_replaced_only_by_force(
  tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
  folder = tmp_path / "my scene"
  assert cli.main(["export-scene", TASK, "--output", str(folder)]) == 0
  assert f"python -m mujoco.viewer --mjcf '{folder}/scene.xml'" in capsys.readouterr().out
  exported = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
  env = mjlab.make(TASK, num_envs=1, device="cpu")
  model = env.sim.mj_model
  env.close()
  for name in ("qpos0", "body_mass", "geom_size", "jnt_range", "actuator_gainprm"):
    np.testing.assert_allclose(getattr(exported, name), getattr(model, name), rtol=1e-5)
  assert exported.opt.timestep == model.opt.timestep
  (folder / "mine.txt").write_text("kept")
  assert cli.main(["export-scene", TASK, "--output", str(folder)]) == 2
  assert (folder / "mine.txt").exists()
  assert cli.main(["export-scene", TASK, "--output", str(folder), "--force"]) == 0
  assert sorted(path.name for path in tmp_path.rglob("*")) == ["my scene", "scene.xml"]
  (folder / "scene.xml").unlink()
  (folder / "mine.txt").write_text("kept")
  assert cli.main(["export-scene", TASK, "--output", str(folder), "--force"]) == 2
  assert (folder / "mine.txt").exists()
  assert "has no scene.xml, so it is not replaced" in capsys.readouterr().err


# Class: a name that is read from a file (here an asset of an MJCF) becomes part of a path.
@pytest.mark.parametrize(
  "name", ["../../hull.obj", "ABSOLUTE/hull.obj", "a/../../hull.obj", "\x1b[2J\n.obj", "my/hull.obj"]
)
def test_an_asset_is_exported_into_the_folder_of_its_scene(tmp_path: Path, name: str) -> None:
  corners = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
  name = name.replace("ABSOLUTE", str(tmp_path))
  spec = mujoco.MjSpec()
  spec.assets = {name: corners, "hull.obj": corners}
  for number, file in enumerate((name, "hull.obj")):
    spec.add_mesh(name=f"hull_{number}", file=file)
    spec.worldbody.add_body(name=f"boat_{number}").add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"hull_{number}")
  path = write_spec(spec, tmp_path / "export" / "scene")
  assert mujoco.MjModel.from_xml_path(str(path)).nmesh == 2
  files = [found for found in tmp_path.rglob("*") if found.is_file()]
  assert len(files) == 3
  assert all(found.is_relative_to(path.parent) and str(found).isprintable() for found in files)


def train(root: Path, *flags: str) -> int:
  quick = ["--agent.max-iterations", "2", "--agent.num-steps-per-env", "8", "--env.scene.num-envs", "6", "--seed", "3"]
  return cli.main(["train", TASK, "--log-root", str(root), "--device", "cpu", *quick, *flags])


@pytest.mark.usefixtures("opengl")
def test_films_and_viewer_do_not_change_a_training(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  flags = ["--video", "--video-interval", "10", "--video-length", "4", "--viewer", "--viewer-port", "8310"]
  assert train(tmp_path / "watched", *flags) == 0
  assert "watch at http://localhost:83" in capsys.readouterr().out
  films = sorted((tmp_path / "watched").rglob("*.mp4"))
  assert [film.name for film in films] == ["step_0.mp4", "step_10.mp4"]
  for film in films:
    with av.open(str(film)) as container:
      assert 1 <= sum(1 for _ in container.decode(video=0)) <= 4
  assert train(tmp_path / "alone") == 0
  watched, alone = (
    torch.load(next((tmp_path / name).rglob("model_2.pt")), weights_only=True) for name in ("watched", "alone")
  )
  for part in ("actor_state_dict", "critic_state_dict"):
    assert all(torch.equal(value, alone[part][key]) for key, value in watched[part].items())


def test_training_continues_without_films_if_opengl_is_missing(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
  monkeypatch.setenv("MUJOCO_GL", "off")
  assert train(tmp_path, "--video", "--video-interval", "4", "--video-length", "2") == 0
  assert list(tmp_path.rglob("model_2.pt"))
  assert [record.getMessage() for record in caplog.records if "films" in record.getMessage()] == [
    "training goes on without films: no pictures: MUJOCO_GL=off switches OpenGL off"
  ]
