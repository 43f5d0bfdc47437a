"""Bundles are read as they were written, or refused in one line."""

import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from deploy_bundles import DEFAULT, DESCRIPTION, SCALE, WEIGHTS, write_bundle
from deploy_schema import PUBLISHED, bundle_schema
from mjlab_deploy import DeployError, Policy, describe, open_bundle, pack, write_description


@pytest.fixture
def folder(tmp_path: Path) -> Path:
  return write_bundle(tmp_path / "bundle", golden=True)


def edited(folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
  path = folder / "bundle.json"
  data = json.loads(path.read_text())
  change(data)
  path.write_text(json.dumps(data))
  return folder


def test_a_folder_and_its_zip_hold_the_same_policy(folder: Path, tmp_path: Path) -> None:
  pack(folder, tmp_path / "bundle.zip")
  numbers = {"joint/position": 0.4, "joint/velocity": -1.0, "command/angle": 0.2}
  readings = {name: np.array([number]) for name, number in numbers.items()}
  for path in (folder, tmp_path / "bundle.zip"):
    with open_bundle(path) as bundle:
      policy, action = Policy(bundle), 0.0
    for _ in range(2):
      step = policy.step(readings)
      # The last action is remembered.
      action = float(np.array([0.4 - DEFAULT, -1.0, action, 0.2]) @ WEIGHTS[:, 0])
      np.testing.assert_allclose(step.action, [action], rtol=1e-6)
      np.testing.assert_allclose(step.targets["target/position"], [DEFAULT + SCALE * action], rtol=1e-6)
    assert bundle.description.robot == DESCRIPTION.robot


def test_the_published_schema_is_that_of_the_code() -> None:
  assert json.loads(PUBLISHED.read_text(encoding="utf-8")) == bundle_schema()


@pytest.mark.parametrize(
  ("change", "message"),
  [
    (lambda d: d.update(format=99), "format 99 is not 1, which this mjlab-deploy reads; update it"),
    (lambda d: d.pop("format"), "format None is not 1"),
    (lambda d: d.pop("robot"), "required field 'robot' does not exist"),
    (lambda d: d.update(surprise=1), "field 'surprise' does not exist; there are "),
    (lambda d: d["robot"]["joints"][0].update(stiffness="high"), "joints[0].stiffness must be number, got 'high'"),
    (lambda d: d["robot"]["joints"][0].update(stiffness=float("nan")), "robot.joints[0].stiffness must be number"),
    (lambda d: d["robot"]["joints"][0].update(stiffness=10**400), "bundle.json: int too large to convert to float"),
    (lambda d: d["timing"].update(decimation=True), "timing.decimation must be integer, got 'True'"),
    (lambda d: d["targets"][0].update(quantity="magic"), "targets[0].quantity must be 'position' or 'velocity'"),
    (lambda d: d["files"].update({"../../etc/passwd": "0"}), "'../../etc/passwd' does not exist; there are "),
    (lambda d: d["files"].update({"policy.onnx": "0"}), "policy.onnx: changed since the bundle was made"),
    (lambda d: d["files"].pop("policy.onnx"), "files lacks 'policy.onnx'"),
    (lambda d: d.update(training=json.loads("[" * 200 + "]" * 200)), "training must be object"),
  ],
)
def test_a_description_that_breaks_the_schema_is_refused_by_name(
  folder: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
  with pytest.raises(DeployError) as caught, open_bundle(edited(folder, change)):
    pass
  assert message in str(caught.value)
  assert str(caught.value).startswith(f"bundle {folder}: bundle.json") or "policy.onnx" in message
  assert "\n" not in str(caught.value)


def test_inputs_that_the_graph_does_not_have_are_named(folder: Path) -> None:
  edited(folder, lambda data: data["inputs"][0].update(shape=[2]))
  message = r"input 'joint/position' is \(1, 1\), bundle.json says \(1, 2\)"
  with open_bundle(folder) as bundle, pytest.raises(DeployError, match=message):
    Policy(bundle)


def test_a_missing_reading_is_named(folder: Path) -> None:
  with open_bundle(folder) as bundle:
    policy = Policy(bundle)
    with pytest.raises(DeployError, match="reading 'command/angle' is missing"):
      policy.step({"joint/position": np.zeros(1), "joint/velocity": np.zeros(1)})


@pytest.mark.parametrize(
  ("descr", "shape", "message"),
  [
    ("'|O'", "(1,)", "holds an array of type '|O'"),
    ("'<f8'", "(10000000000,)", "holds more than 512 MiB"),
    ("'<f8'", "(3,)", "cannot reshape array of size 1"),
    ("'<f8'", "(-1,)", "shape (-1,)"),
    ("'<f8'", "__import__('os').abort()", "malformed node"),
  ],
)
def test_arrays_from_untrusted_files_are_measured_before_they_are_read(
  folder: Path, descr: str, shape: str, message: str
) -> None:
  header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
  with zipfile.ZipFile(folder / "golden.npz", "w") as archive:
    archive.writestr("x.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(8))
  edited(folder, lambda d: d["files"].pop("golden.npz"))
  with open_bundle(folder) as bundle, pytest.raises(DeployError, match=r"golden\.npz") as caught:
    bundle.arrays("golden.npz")
  assert message in str(caught.value)


def test_other_names_in_a_zip_are_not_unpacked(folder: Path, tmp_path: Path) -> None:
  pack(folder, tmp_path / "bundle.zip")
  with zipfile.ZipFile(tmp_path / "bundle.zip", "a") as archive:
    archive.writestr("../outside.txt", "x")
    archive.writestr("inside.txt", "x")
  with open_bundle(tmp_path / "bundle.zip") as bundle:
    assert not (bundle.folder / "inside.txt").exists()
    assert not (bundle.folder.parent / "outside.txt").exists()


def test_a_missing_bundle_is_not_called_damaged(tmp_path: Path) -> None:
  with (
    pytest.raises(DeployError, match=r"^bundle \S*missing: No such file or directory$"),
    open_bundle(tmp_path / "missing"),
  ):
    pass


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"not a zip"])
def test_a_damaged_zip_is_one_line(tmp_path: Path, data: bytes) -> None:
  (tmp_path / "x.zip").write_bytes(data)
  with pytest.raises(DeployError, match=r"not a zip that can be read|bundle\.json"), open_bundle(tmp_path / "x.zip"):
    pass


def test_a_graph_of_garbage_is_one_line(folder: Path) -> None:
  (folder / "policy.onnx").write_bytes(b"\x00garbage")
  write_description(folder, DESCRIPTION)
  with open_bundle(folder) as bundle, pytest.raises(DeployError, match="not a graph that ONNX Runtime takes"):
    Policy(bundle)


def test_describe_leaves_its_argument_alone(folder: Path) -> None:
  text = (folder / "bundle.json").read_text()
  data = json.loads(text)
  describe(data)
  assert data == json.loads(text)
