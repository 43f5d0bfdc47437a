"""`verify` accepts a bundle that repeats its record, and names the first difference of another."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from deploy_bundles import DESCRIPTION, SCENE, write_bundle
from mjlab_deploy import DeployError, Golden, open_bundle, write_description
from mjlab_deploy.arrays import read_arrays, write_arrays
from mjlab_deploy.command import main
from mjlab_deploy.simulation.scene import load_scene, write_scene
from mjlab_deploy.simulation.verification import Report, verify

RECORDED = replace(DESCRIPTION, golden=Golden(steps=100, engine="native"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
  return write_bundle(tmp_path / "bundle", golden=True)


def report_on(folder: Path) -> Report:
  """Verify a bundle whose files were changed, with their new hashes."""
  write_description(folder, RECORDED)
  with open_bundle(folder) as bundle:
    return verify(bundle)


def tamper(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
  arrays = {name: value.copy() for name, value in read_arrays(folder / "golden.npz", 2**20).items()}
  change(arrays)
  write_arrays(folder / "golden.npz", arrays)


def test_a_bundle_that_repeats_its_record_is_verified(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
  assert main(["verify", str(folder)]) == 0
  shown = capsys.readouterr().out
  for part in ("replay: 100 steps of golden.npz", "closed loop: joint positions within", "stood for all 100 steps"):
    assert part in shown
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
def test_the_first_term_that_differs_is_named(folder: Path, name: str, column: int, message: str) -> None:
  def change(arrays: dict[str, Any]) -> None:
    arrays[name][7, column] += 0.01

  tamper(folder, change)
  report = report_on(folder)
  assert not report.passed
  assert message in report.failures[0]


def test_another_model_than_the_trainings_drifts(folder: Path) -> None:
  (folder / "scene.xml").write_text(SCENE.replace('armature="0.01"', 'armature="0.02"'))
  (failure,) = report_on(folder).failures
  assert "closed loop: joint positions within" in failure


def test_a_record_that_does_not_fit_is_refused(folder: Path) -> None:
  tamper(folder, lambda arrays: arrays.update(action=arrays["action"][:5]))
  with pytest.raises(DeployError, match=r"^golden\.npz: 'action' is missing or has not 100 steps$"):
    report_on(folder)


@pytest.mark.parametrize(
  "text",
  [
    '<include file="/etc/passwd"/>',
    '<asset><mesh file ="hull.obj"/></asset>',
    '<asset><texture name="sky" type="skybox" fileright="sky.png"/></asset>',
  ],
)
def test_a_scene_that_refers_to_other_files_is_refused(folder: Path, text: str) -> None:
  (folder / "scene.xml").write_text(f"<mujoco>{text}</mujoco>")
  with pytest.raises(DeployError, match=r"^scene\.xml: refers to other files or plugins, which is not read$"):
    report_on(folder)


def test_a_damaged_scene_is_refused(folder: Path) -> None:
  (folder / "scene.xml").write_text("<mujoco><worldbody></mujoco>")
  with pytest.raises(DeployError, match=r"scene\.xml"):
    report_on(folder)


def test_a_scene_without_the_root_of_the_robot_is_refused(folder: Path) -> None:
  (folder / "scene.xml").write_text(SCENE.replace('body name="robot/pole"', 'body name="robot/stick"'))
  with pytest.raises(DeployError, match=r"^scene\.xml: .*robot/pole"):
    report_on(folder)


def test_a_scene_without_its_drawn_meshes_keeps_masses_and_the_numbers_of_its_geoms(folder: Path) -> None:
  mesh = '<mesh name="hull" vertex="0 0 0  .3 0 0  0 .3 0  0 0 .3"/>'
  drawn = '<geom type="mesh" mesh="hull" contype="0" conaffinity="0" mass="2"/>'
  shell = f'<body name="shell"><joint/>{drawn}</body>'
  body = f'<body name="b"><freejoint/>{drawn}<geom name="foot" size=".1" mass="1"/>{shell}</body>'
  spec = mujoco.MjSpec.from_string(f"<mujoco><asset>{mesh}</asset><worldbody>{body}</worldbody></mujoco>")
  model = spec.compile()
  model.geom_size[1, 0], model.geom_friction[1, 0] = 0.07, 0.3
  assert write_scene(spec, folder, {"geom_size": model.geom_size, "geom_friction": model.geom_friction})
  write_description(folder, DESCRIPTION)
  with open_bundle(folder) as bundle:
    scene = load_scene(bundle)
  assert scene.ngeom == 1
  assert (scene.geom("foot").size[0], scene.geom("foot").friction[0]) == (0.07, 0.3)
  for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_subtreemass", "dof_M0"):
    np.testing.assert_array_equal(getattr(scene, name), getattr(model, name))


@pytest.mark.parametrize("name", ["nbody", "body_mass", "__class__"])
def test_numbers_of_a_scene_that_do_not_fit_are_refused(folder: Path, name: str) -> None:
  write_arrays(folder / "scene.npz", {name: np.zeros(77)})
  with pytest.raises(DeployError, match=r"scene\.npz: .* does not fit scene\.xml"):
    report_on(folder)


def test_names_from_a_file_cannot_add_lines(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
  text = (folder / "bundle.json").read_text()
  (folder / "bundle.json").write_text(text.replace('"hinge"', json.dumps("x\n\x1b[31mFAILED")))
  assert main(["verify", str(folder)]) == 1
  error = capsys.readouterr().err
  assert error.count("\n") == 1
  assert "\x1b" not in error
