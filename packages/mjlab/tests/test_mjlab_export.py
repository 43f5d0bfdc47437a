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
from mjlab_rl import CheckpointPolicy
from mjlab_rl.bundles import policy_bundle, policy_graph
from PIL import Image

TASK = mjlab_pendulum.TASK
pytestmark = pytest.mark.usefixtures("pendulum_here")


def unsourced(env: Any) -> torch.Tensor:
  return torch.zeros(env.num_envs, 2)


def registered(**terms: ObservationTermCfg) -> str:
  """Return the name of the pendulum's task with more observations, without noise."""

  def task() -> Any:
    made = mjlab_pendulum.pendulum()
    group = made.env.observations["actor"]
    assert group is not None
    group.corrupt = False
    group.terms |= terms
    return made

  mjlab.register_task("Test-More", task)
  return "Test-More"


def trained(task: str, *words: str) -> Path:
  before = set(Path("logs").glob("pendulum/*"))
  assert cli.main(["train", task, "--device", "cpu", "--quiet", *words]) == 0
  (run,) = set(Path("logs").glob("pendulum/*")) - before
  return run.absolute()


def test_a_run_becomes_a_bundle_that_repeats_its_record(capsys: pytest.CaptureFixture[str]) -> None:
  strain = ObservationTermCfg(unsourced, source="pole/strain")
  task = registered(strain=strain, last=ObservationTermCfg(mdp.last_action))
  history = "--env.observations.actor.terms.velocity.history-length"
  run = trained(task, history, "3", "--agent.clip-actions", "0.5")
  Path("mine").mkdir()
  export = ["export", str(run), "--steps", "30", "--output"]
  assert cli.main([*export, "mine"]) == 2
  assert "mine exists; --force" in capsys.readouterr().err
  assert cli.main([*export, "mine", "--force"]) == 2
  assert "mine has no bundle.json, so it is not replaced" in capsys.readouterr().err
  assert not list(Path("mine").iterdir())
  assert cli.main([*export, "out"]) == 0
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
    ("strain", ("pole/strain",)),
    ("last", ("last_action",)),
  ]
  assert description.inputs[2].name == "pole/strain"
  assert description.memories[-1].input == "memory/last_action"
  assert description.training["iterations"] == 3
  assert description.timing.decimation == 2


def test_a_picture_is_a_png() -> None:
  pixels = np.arange(72, dtype=np.uint8).reshape(6, 4, 3)
  data = _export._picture(SimpleNamespace(render_mode=None, render=lambda: pixels))
  assert data is not None
  np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(data))), pixels)


def test_a_training_keeps_its_newest_policy_as_a_bundle(monkeypatch: pytest.MonkeyPatch) -> None:
  exported: list[Any] = []

  def counted(graph: Any, *parts: Any) -> Any:
    exported.append(graph)
    return policy_graph.export_onnx(graph, *parts)

  monkeypatch.setattr(policy_bundle, "export_onnx", counted)
  run = trained(TASK, "--agent.save-interval", "2", "--agent.actor.obs-normalization")
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


def test_a_policy_with_a_term_without_a_source_is_trained_but_not_exported(capsys: pytest.CaptureFixture[str]) -> None:
  task = registered(strain=ObservationTermCfg(unsourced))
  assert cli.main(["train", task, "--device", "cpu", "--agent.save-interval", "1"]) == 0
  reason = "ObservationManager: term 'actor/strain' declares no source"
  assert capsys.readouterr().out.count(f"no policy bundle is written: {reason}") == 1
  (run,) = Path("logs/pendulum").iterdir()
  assert cli.main(["export", str(run), "--output", "out", "--steps", "5"]) == 1
  assert reason in capsys.readouterr().err
  assert not Path("out").exists()


def test_a_bundle_is_played_in_its_task(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
  # A history and the last action, which a policy remembers for each world.
  task = registered(last=ObservationTermCfg(mdp.last_action, history_length=3))
  run = trained(task)
  bundle = Path("package/demo_policies/track")
  with monkeypatch.context() as patched:
    # Rounding that a policy amplifies through its last action is no wrong source of an observation.
    call = CheckpointPolicy.__call__
    patched.setattr(CheckpointPolicy, "__call__", lambda self, obs: call(self, obs) + 1e-3)
    code = cli.main(["export", str(run), "--output", str(bundle), "--steps", "5"])
    assert code == 0, capsys.readouterr().err
  compared: list[str] = []

  def look(wanted: object, name: str, playback: Any, checkpoints: object) -> int:
    env, policy = playback.env, playback.policy
    trained = CheckpointPolicy(env, mjlab.load_task(task).agent)
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
    assert cli.main(["play", task, "--checkpoint", path, *flags]) == 0, capsys.readouterr().err
  # A policy that ships is a folder.
  monkeypatch.setattr(demos, "files", lambda name: Path("package"))
  assert cli.main(["demo", "--task", "track", *flags]) == 0
  assert compared == [task] * 3
  assert cli.main(["demo", "--help"]) == 0
  assert "policies that ship: track\n" in capsys.readouterr().out
  data = json.loads((bundle / "bundle.json").read_text())
  for part, change, message in (
    (
      data["inputs"][1],
      {"columns": ["elbow"]},
      "does not fit: 'joint/velocity' is (1,) elbow in the bundle and (1,) hinge",
    ),
    (data, {"format": 99}, "format 99 is not 1"),
  ):
    part.update(change)
    (bundle / "bundle.json").write_text(json.dumps(data))
    assert cli.main(["play", task, "--checkpoint", str(bundle), *flags]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
