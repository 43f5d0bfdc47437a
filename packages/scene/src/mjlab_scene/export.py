"""A scene as MJCF with its files, in a folder or an archive."""

from __future__ import annotations

import re
import tempfile
import zipfile
from pathlib import Path

import mujoco
from mjlab_core import AtomicWrite, safe_name


def write_spec(spec: mujoco.MjSpec, folder: Path) -> Path:
  """Write a spec and its files into `folder`, which replaces an existing one; return the path of the MJCF."""
  assets = dict(spec.assets)
  with AtomicWrite(folder) as made:
    made.mkdir()
    for number, part in enumerate((*spec.meshes, *spec.hfields, *spec.textures, *spec.skins)):
      if part.file and (part.file not in assets or _inside(part.file) != part.file):
        # Files of several folders may have the same name, and a name in a model file may lead out of the folder.
        name = f"{number}_{safe_name(Path(part.file).name)}"
        assets[name] = assets[part.file] if part.file in assets else Path(part.file).read_bytes()
        part.file = name
    assets = {name: content for name, content in assets.items() if _inside(name) == name}
    spec.assets = assets
    spec.compile()
    (made / "scene.xml").write_text(spec.to_xml(), encoding="utf-8")
    for name, content in assets.items():
      target = made / name
      target.parent.mkdir(parents=True, exist_ok=True)
      target.write_bytes(content if isinstance(content, bytes) else content.encode())
    # Refuse to write a model that cannot be opened again.
    mujoco.MjModel.from_xml_path(str(made / "scene.xml"))
  return folder / "scene.xml"


def _inside(name: str) -> str:
  """Return the path of an asset below the exported folder: safe file names, none of them ".."."""
  parts = [part for part in re.split(r"[/\\]+", name) if part.strip(".")]
  return "/".join(safe_name(part) for part in parts)


def zip_spec(spec: mujoco.MjSpec, path: Path) -> Path:
  """Write a spec and its files into a zip archive, which replaces an existing one; return its path."""
  with tempfile.TemporaryDirectory() as folder:
    scene = write_spec(spec, Path(folder) / "scene").parent
    with AtomicWrite(path) as made, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
      for file in sorted(scene.rglob("*")):
        if file.is_file():
          archive.write(file, file.relative_to(scene))
  return path
