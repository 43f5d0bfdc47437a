"""`export` writes bundles of the pendulum's runs."""

import io
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mjlab
import mjlab_pendulum
import numpy as np
import pytest
import torch
from mjlab import cli, demos
from mjlab.cli import _export, _play
from mjlab_deploy import Policy, open_bundle
from mjlab_envs import mdp
from mjlab_managers import ObservationTermCfg
from mjlab_rl import CheckpointPolicy, policy_bundle, policy_graph
from PIL import Image

TASK = mjlab_pendulum.TASK
pytestmark = pytest.mark.usefixtures("pendulum_here")


def trained(*words: str) -> Path:
  assert cli.main(["train", TASK, "--device", "cpu", "--quiet", *words]) == 0
  (run,) = Path("logs/pendulum").iterdir()
  return run


def test_a_run_becomes_a_bundle_that_repeats_its_record(capsys: pytest.CaptureFixture[str]) -> None:
  run = trained("--env.observations.actor.terms.velocity.history-length", "3", "--agent.clip-actions", "0.5")
  assert cli.main(["export", str(run), "--output", "out", "--steps", "30"]) == 0
  assert "mjlab-deploy verify out" in capsys.readouterr().out
  for path in ("out", "out.zip"):
    with open_bundle(path) as bundle:
      description, golden, policy = bundle.description, bundle.arrays("golden.npz"), Policy(bundle)
      for i in range(30):
        if golden["episode_start"][i]:
          policy.reset()
        step = policy.step({name[6:]: row[i] for name, row in golden.items() if name.startswith("input/")})
        np.testing.assert_allclose(step.action, golden["action"][i], atol=1e-5)
        np.testing.assert_allclose(step.observations["actor"], golden["observation/actor"][i], atol=1e-5)
        np.testing.assert_allclose(step.targets["target/effort"], step.action, atol=1e-6)
  assert [joint.name for joint in description.robot.joints] == ["hinge"]
  assert [(term.name, term.sources) for term in description.observations] == [
    ("position", ("joint/position",)),
    ("velocity", ("joint/velocity",)),
  ]
  assert description.training["iterations"] == 3
  assert description.timing.decimation == 2


def test_the_action_that_acts_is_the_one_that_the_graph_remembers(
  monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  """Rounding that a policy amplifies through its last action is no wrong source of an observation."""

  def task() -> Any:
    made = mjlab_pendulum.pendulum()
    group = made.env.observations["actor"]
    assert group is not None
    group.terms["last"] = ObservationTermCfg(mdp.last_action)
    return made

  mjlab.register_task("Test-Last", task)
  assert cli.main(["train", "Test-Last", "--device", "cpu", "--quiet"]) == 0
  (run,) = Path("logs/pendulum").iterdir()
  call = CheckpointPolicy.__call__
  monkeypatch.setattr(CheckpointPolicy, "__call__", lambda self, obs: call(self, obs) + 1e-3)
  assert cli.main(["export", str(run), "--output", "out", "--steps", "5"]) == 0, capsys.readouterr().err


def test_a_picture_is_a_png() -> None:
  pixels = np.arange(72, dtype=np.uint8).reshape(6, 4, 3)
  data = _export._picture(SimpleNamespace(render_mode=None, render=lambda: pixels))
  assert data is not None
  np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(data))), pixels)


def test_an_existing_folder_is_not_replaced_unasked(capsys: pytest.CaptureFixture[str]) -> None:
  run = trained()
  Path("mine").mkdir()
  assert cli.main(["export", str(run), "--output", "mine", "--steps", "0"]) == 2
  assert "mine exists; --force" in capsys.readouterr().err
  assert cli.main(["export", str(run), "--output", "mine", "--steps", "0", "--force"]) == 2
  assert "mine has no bundle.json, so it is not replaced" in capsys.readouterr().err
  assert not list(Path("mine").iterdir())


@pytest.mark.parametrize(
  ("words", "message"),
  [
    ([], "no RUN|CHECKPOINT given"),
    (["gone"], "'gone' is neither a checkpoint nor a run"),
    (["gone", "--steps", "-1"], "--steps must not be negative"),
  ],
)
def test_a_mistake_is_one_line(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
  assert cli.main(["export", *words]) in (1, 2)
  error = capsys.readouterr().err
  assert message in error
  assert error.count("\n") == 1


def unsourced(env: Any) -> torch.Tensor:
  return torch.zeros(env.num_envs, 2)


@pytest.mark.parametrize("source", [None, "pole/strain"])
def test_a_term_without_a_source_is_refused_by_name(
  source: str | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  def task() -> Any:
    made = mjlab_pendulum.pendulum()
    group = made.env.observations["actor"]
    assert group is not None
    group.terms["strain"] = ObservationTermCfg(unsourced, source=source)
    group.terms["last"] = ObservationTermCfg(mdp.last_action)
    return made

  mjlab.register_task("Test-Strain", task)
  assert cli.main(["train", "Test-Strain", "--device", "cpu", "--quiet"]) == 0
  (run,) = Path("logs/pendulum").iterdir()
  code = cli.main(["export", str(run), "--output", "out", "--steps", "5"])
  if source is None:
    assert code == 1
    assert "term 'actor/strain' declares no source" in capsys.readouterr().err
    assert not Path("out").exists()
  else:
    assert code == 0
    data = json.loads(Path("out/bundle.json").read_text())
    assert data["inputs"][2]["name"] == "pole/strain"
    assert data["memories"][0]["input"] == "memory/last_action"


def test_a_training_keeps_its_newest_policy_as_a_bundle(monkeypatch: pytest.MonkeyPatch) -> None:
  exported: list[Any] = []

  def counted(graph: Any, *parts: Any) -> Any:
    exported.append(graph)
    return policy_graph.export_onnx(graph, *parts)

  monkeypatch.setattr(policy_bundle, "export_onnx", counted)
  run = trained("--agent.save-interval", "2", "--agent.actor.obs-normalization")
  # Traced once at iteration 2; iteration 3 brought only new weights.
  assert len(exported) == 1
  with open_bundle(run / "bundle") as bundle:
    assert bundle.description.training == {"checkpoint": "model_3.pt", "iterations": 3}
    newest = Policy(bundle)
  assert cli.main(["export", str(run), "--output", "out", "--steps", "0"]) == 0
  with open_bundle("out") as bundle:
    again = Policy(bundle)
  readings = {"joint/position": np.array([0.3]), "joint/velocity": np.array([-1.0])}
  np.testing.assert_allclose(newest.step(readings).action, again.step(readings).action, atol=1e-6)
  assert len(exported) == 2


def test_a_training_whose_policy_cannot_be_exported_says_so_and_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
  def task() -> Any:
    made = mjlab_pendulum.pendulum()
    group = made.env.observations["actor"]
    assert group is not None
    group.terms["strain"] = ObservationTermCfg(unsourced)
    return made

  mjlab.register_task("Test-Strain", task)
  assert cli.main(["train", "Test-Strain", "--device", "cpu", "--agent.save-interval", "1"]) == 0
  shown = capsys.readouterr().out
  assert shown.count("no policy bundle is written: ObservationManager: term 'actor/strain' declares no source") == 1


def with_memory() -> Any:
  """The pendulum with a history and its last action, which a policy remembers for each world."""
  made = mjlab_pendulum.pendulum()
  group = made.env.observations["actor"]
  assert group is not None
  group.corrupt = False
  group.terms["last"] = ObservationTermCfg(mdp.last_action, history_length=3)
  return made


def test_a_bundle_is_played_in_its_task(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
  mjlab.register_task("Test-Memory", with_memory)
  assert cli.main(["train", "Test-Memory", "--device", "cpu", "--quiet"]) == 0
  (run,) = Path("logs/pendulum").iterdir()
  bundle = Path("package/demo_policies/track")
  assert cli.main(["export", str(run), "--output", str(bundle), "--steps", "0"]) == 0
  compared: list[str] = []

  def look(wanted: object, name: str, playback: Any, checkpoints: object) -> int:
    env, policy = playback.env, playback.policy
    trained = CheckpointPolicy(env, with_memory().agent)
    trained.load(run / "model_3.pt")
    playback.pause()
    policy.reset(None)
    for step in range(12):
      seen = env.get_observations()
      with torch.no_grad():
        action = policy(seen)
        torch.testing.assert_close(action, trained(seen), atol=1e-5, rtol=0)
      env.step(action)
      if step == 5:
        # Worlds of other ages.
        mask = torch.tensor([True, False, False])
        env.reset(env_ids=mask)
        policy.reset(mask)
    compared.append(name)
    return 0

  monkeypatch.setattr(_play, "_browser", look)
  flags = ["--viewer", "browser", "--num-envs", "3", "--device", "cpu"]
  for path in (str(bundle), f"{bundle}.zip"):
    assert cli.main(["play", "Test-Memory", "--checkpoint", path, *flags]) == 0, capsys.readouterr().err
  # A policy that ships is a folder.
  monkeypatch.setattr(demos, "files", lambda name: Path("package"))
  assert cli.main(["demo", "--task", "track", *flags]) == 0
  assert compared == ["Test-Memory"] * 3
  assert cli.main(["demo", "--help"]) == 0
  assert "policies that ship: track\n" in capsys.readouterr().out
  data = json.loads((bundle / "bundle.json").read_text())
  for part, change, message in (
    (data["inputs"][1], {"columns": ["elbow"]}, "does not fit: 'joint/velocity' is (1,) elbow in it and (1,) hinge"),
    (data, {"format": 99}, "format 99 is not 1"),
  ):
    part.update(change)
    (bundle / "bundle.json").write_text(json.dumps(data))
    assert cli.main(["play", "Test-Memory", "--checkpoint", str(bundle), *flags]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
