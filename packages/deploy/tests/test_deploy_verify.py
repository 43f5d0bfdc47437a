"""`verify` passes what repeats its record, and names what differs first."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from deploy_bundles import DESCRIPTION, write_bundle
from mjlab_deploy import DeployError, Golden, open_bundle, write_description
from mjlab_deploy.arrays import read_arrays, write_arrays
from mjlab_deploy.command import main
from mjlab_deploy.scene import load_scene, write_scene
from mjlab_deploy.verification import verify

RECORDED = replace(DESCRIPTION, golden=Golden(steps=100, engine="native"))


def tampered(tmp_path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
  folder = write_bundle(tmp_path / "bundle")
  arrays = {name: value.copy() for name, value in read_arrays(folder / "golden.npz", 2**20).items()}
  change(arrays)
  write_arrays(folder / "golden.npz", arrays)
  write_description(folder, RECORDED)
  return folder


def test_a_bundle_that_repeats_its_record_is_verified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  assert main(["verify", str(write_bundle(tmp_path / "bundle"))]) == 0
  shown = capsys.readouterr().out
  assert "replay: 100 steps of golden.npz" in shown
  assert "closed loop: joint positions within" in shown
  assert "stood for all 100 steps" in shown
  assert shown.endswith("verified\n")


@pytest.mark.parametrize(
  ("name", "column", "message"),
  [
    ("observation/actor", 1, "observation 'actor/joint_vel' differs first, in step 7: column 0"),
    ("observation/actor", 2, "observation 'actor/actions' differs first, in step 7"),
    ("action", 0, "action differs first, in step 7"),
    ("target/position", 0, "'target/position' differs first, in step 7"),
  ],
)
def test_the_first_term_that_differs_is_named(tmp_path: Path, name: str, column: int, message: str) -> None:
  def change(arrays: dict[str, Any]) -> None:
    arrays[name][7, column] += 0.01

  with open_bundle(tampered(tmp_path, change)) as bundle:
    report = verify(bundle)
  assert not report.passed
  assert message in report.failures[0]


def test_another_model_than_the_trainings_drifts(tmp_path: Path) -> None:
  folder = write_bundle(tmp_path / "bundle")
  scene = folder / "scene.xml"
  scene.write_text(scene.read_text().replace('armature="0.01"', 'armature="0.02"'))
  write_description(folder, RECORDED)
  with open_bundle(folder) as bundle:
    report = verify(bundle)
  assert len(report.failures) == 1
  assert "closed loop: joint positions within" in report.failures[0]


def test_a_record_that_does_not_fit_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  def shorter(arrays: dict[str, Any]) -> None:
    arrays["action"] = arrays["action"][:5]

  assert main(["verify", str(tampered(tmp_path, shorter))]) == 1
  error = capsys.readouterr().err
  assert "golden.npz: 'action' is missing or has not 100 steps" in error
  assert error.count("\n") == 1


@pytest.mark.parametrize("text", ['<mujoco><include file="/etc/passwd"/></mujoco>', "<mujoco><worldbody></mujoco>"])
def test_a_hostile_scene_is_refused(tmp_path: Path, text: str) -> None:
  folder = write_bundle(tmp_path / "bundle")
  (folder / "scene.xml").write_text(text)
  write_description(folder, RECORDED)
  with open_bundle(folder) as bundle, pytest.raises(DeployError, match=r"scene\.xml"):
    verify(bundle)


def test_a_scene_without_its_drawn_meshes_keeps_masses_and_the_numbers_of_its_geoms(tmp_path: Path) -> None:
  mesh = '<mesh name="hull" vertex="0 0 0  .3 0 0  0 .3 0  0 0 .3"/>'
  drawn = '<geom type="mesh" mesh="hull" contype="0" conaffinity="0" mass="2"/>'
  body = f'<body name="b"><freejoint/>{drawn}<geom name="foot" size=".1" mass="1"/></body>'
  spec = mujoco.MjSpec.from_string(f"<mujoco><asset>{mesh}</asset><worldbody>{body}</worldbody></mujoco>")
  model = spec.compile()
  model.geom_size[1, 0], model.geom_friction[1, 0] = 0.07, 0.3
  folder = write_bundle(tmp_path / "bundle")
  assert write_scene(spec, folder, {"geom_size": model.geom_size, "geom_friction": model.geom_friction})
  write_description(folder, DESCRIPTION)
  with open_bundle(folder) as bundle:
    scene = load_scene(bundle)
  assert scene.ngeom == 1
  assert (scene.geom("foot").size[0], scene.geom("foot").friction[0]) == (0.07, 0.3)
  for name in ("mass", "inertia", "ipos", "iquat"):
    np.testing.assert_array_equal(getattr(scene.body("b"), name), getattr(model.body("b"), name))


@pytest.mark.parametrize("name", ["nbody", "body_mass", "__class__"])
def test_numbers_of_a_scene_that_do_not_fit_are_refused(tmp_path: Path, name: str) -> None:
  folder = write_bundle(tmp_path / "bundle")
  write_arrays(folder / "scene.npz", {name: np.zeros(77)})
  write_description(folder, RECORDED)
  with open_bundle(folder) as bundle, pytest.raises(DeployError, match=r"scene\.npz: .* does not fit scene\.xml"):
    verify(bundle)


def test_names_from_a_file_cannot_add_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  folder = write_bundle(tmp_path / "bundle")
  data = json.loads((folder / "bundle.json").read_text())
  data["evaluation"] = {}
  data["robot"]["joints"][0]["name"] = "x\n\x1b[31mFAILED"
  (folder / "bundle.json").write_text(json.dumps(data))
  assert main(["verify", str(folder)]) == 1
  error = capsys.readouterr().err
  assert error.count("\n") == 1
  assert "\x1b" not in error
