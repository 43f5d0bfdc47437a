"""Policy bundles on disk: a folder, or a zip of it."""

import contextlib
import dataclasses
import hashlib
import json
import os
import tempfile
import zipfile
from collections.abc import Generator
from pathlib import Path
from typing import Any

from mjlab_deploy.arrays import Arrays, read_arrays
from mjlab_deploy.decoding import decode
from mjlab_deploy.description import FORMAT, Description
from mjlab_deploy.errors import DeployError, check_known, read_limited, reading

MAX_BYTES = {
  "bundle.json": 4 << 20,
  "policy.onnx": 512 << 20,
  "golden.npz": 512 << 20,
  "motion.npz": 256 << 20,
  "scene.xml": 64 << 20,
  "scene.npz": 256 << 20,
  "picture.png": 16 << 20,
}
"""Files of a bundle, and the largest size of each [bytes]. Other names in a folder or a zip are not read."""


class Bundle:
  """Policy bundle in a folder; `open_bundle` makes one.

  Args:
    folder: The folder.

  Raises:
    DeployError: A file is missing, too large, damaged, or of a newer format.
  """

  def __init__(self, folder: Path) -> None:
    self.folder = folder
    text = self.read_bytes("bundle.json")
    with reading("bundle.json", ValueError, OverflowError, RecursionError):
      self.description = describe(json.loads(text))
    for name, digest in self.description.files.items():
      check_known("bundle.json: files: file of a bundle", name, MAX_BYTES)
      if hashlib.sha256(self.read_bytes(name)).hexdigest() != digest:
        raise DeployError(f"{name}: changed since the bundle was made (its SHA-256 differs)")
    if "policy.onnx" not in self.description.files:
      raise DeployError("bundle.json: files lacks 'policy.onnx'")

  def has(self, name: str) -> bool:
    """Return True if the bundle has this file."""
    return name in self.description.files

  def read_bytes(self, name: str) -> bytes:
    """Return the contents of a file.

    Raises:
      DeployError: It is missing or too large.
    """
    with reading(name):
      return read_limited(self.folder / name, MAX_BYTES[name])

  def arrays(self, name: str) -> Arrays:
    """Return the arrays of `golden.npz`, `motion.npz` or `scene.npz`."""
    self.read_bytes(name)
    return read_arrays(self.folder / name, MAX_BYTES[name])


@contextlib.contextmanager
def open_bundle(path: str | os.PathLike[str]) -> Generator[Bundle]:
  """Open a bundle, a folder or a zip, which is unpacked for as long as it is open.

  Raises:
    DeployError: It cannot be read; the message begins with its path.
  """
  path = Path(path)
  with tempfile.TemporaryDirectory(prefix="bundle-") as temporary:
    with reading(f"bundle {path}"):
      folder = path
      if not path.is_dir():
        folder = Path(temporary)
        _unpack(path, folder)
      bundle = Bundle(folder)
    yield bundle


def describe(data: Any) -> Description:
  """Return the contents of `bundle.json`, checked against the published schema.

  Raises:
    DeployError: It is of another format, or does not follow the schema.
  """
  version = data.get("format") if isinstance(data, dict) else None
  if version != FORMAT:
    raise DeployError(f"format {str(version)[:20]} is not {FORMAT}, which this mjlab-deploy reads; update it")
  return decode(Description, data)


def write_description(folder: Path, description: Description) -> None:
  """Write `bundle.json` with the hashes of the files that are in the folder."""
  digests = {
    name: hashlib.sha256((folder / name).read_bytes()).hexdigest()
    for name in MAX_BYTES
    if name != "bundle.json" and (folder / name).is_file()
  }
  data = dataclasses.asdict(dataclasses.replace(description, files=digests))
  # A description that breaks the schema is not written.
  text = json.dumps(data, indent=1, allow_nan=False)
  describe(json.loads(text))
  (folder / "bundle.json").write_text(text + "\n", encoding="utf-8")


def pack(folder: Path, path: Path) -> None:
  """Write the files of a bundle into a zip."""
  with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
    for name in MAX_BYTES:
      if (folder / name).is_file():
        archive.write(folder / name, name)


def _unpack(path: Path, folder: Path) -> None:
  with path.open("rb") as opened, reading("not a zip that can be read", Exception), zipfile.ZipFile(opened) as archive:
    for name in MAX_BYTES.keys() & archive.namelist():
      # The zip may state a wrong size. One byte more than allowed lets the reader refuse the file.
      with archive.open(name) as file:
        (folder / name).write_bytes(file.read(MAX_BYTES[name] + 1))
