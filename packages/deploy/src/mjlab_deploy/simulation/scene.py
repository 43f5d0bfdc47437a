"""The MuJoCo model of a bundle: `scene.xml`, and in `scene.npz` the numbers that six digits of XML do not hold."""

import re
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from mjlab_deploy.arrays import Arrays, write_arrays
from mjlab_deploy.bundle import Bundle
from mjlab_deploy.errors import DeployError, reading


def write_scene(spec: mujoco.MjSpec, folder: Path, fields: Mapping[str, np.ndarray] | None = None) -> bool:
  """Write the model of a spec, without meshes that are only drawn; return False if it needs other files.

  Args:
    spec: Spec of the model; not changed.
    folder: Folder of the bundle.
    fields: Fields of the model that differ from the spec's.

  Raises:
    DeployError: XML cannot hold the model.
  """
  spec = spec.copy()
  whole = spec.compile()
  for geom in list(spec.geoms):
    if geom.type == mujoco.mjtGeom.mjGEOM_MESH and not (geom.contype or geom.conaffinity):
      body = geom.parent
      if body.id and not body.explicitinertial:
        # MuJoCo refuses a moving body that has lost all of its mass.
        compiled = whole.body(body.id)
        body.explicitinertial, body.mass, body.inertia = True, compiled.mass[0], compiled.inertia
        body.ipos, body.iquat = compiled.ipos, compiled.iquat
      spec.delete(geom)
  drawn = {geom.meshname for geom in spec.geoms}
  for mesh in list(spec.meshes):
    if mesh.name not in drawn:
      spec.delete(mesh)
  if any(part.file for part in (*spec.meshes, *spec.hfields, *spec.textures, *spec.skins)):
    return False
  model = spec.compile()
  collides = (whole.geom_contype | whole.geom_conaffinity).astype(bool)
  kept = collides | (whole.geom_type != mujoco.mjtGeom.mjGEOM_MESH)
  for name in _fields(model):
    kind, compiled = name.partition("_")[0], np.asarray(getattr(whole, name))
    value = compiled if fields is None or name not in fields else fields[name].reshape(compiled.shape)
    # A body without its drawn meshes keeps their mass.
    if kind not in ("bvh", "mesh"):
      getattr(model, name)[...] = value[kept] if kind == "geom" else value
  text = spec.to_xml()
  (folder / "scene.xml").write_text(text, encoding="utf-8")
  write_arrays(folder / "scene.npz", _differences(model, mujoco.MjModel.from_xml_string(text)))
  return True


def load_scene(bundle: Bundle) -> mujoco.MjModel:
  """Return the model of a bundle.

  Raises:
    DeployError: It is missing, MuJoCo refuses it, or its numbers do not fit it.
  """
  if not bundle.has("scene.xml"):
    raise DeployError("the bundle has no scene.xml")
  text = bundle.read_bytes("scene.xml").decode("utf-8", errors="replace")
  # Attributes such as `fileright` name files too, and spaces may follow a name.
  if re.search(r"<include|<plugin|\bfile\w*\s*=", text):
    raise DeployError("scene.xml: refers to other files or plugins, which is not read")
  with reading("scene.xml", ValueError, mujoco.FatalError):
    model = mujoco.MjModel.from_xml_string(text)
  if bundle.has("scene.npz"):
    fields = _fields(model)
    for name, value in bundle.arrays("scene.npz").items():
      target = getattr(model, name) if name in fields else np.empty(0)
      if target.shape != value.shape or value.dtype.kind != "f" or not np.isfinite(value).all():
        raise DeployError(f"scene.npz: {name[:60]!r} does not fit scene.xml")
      target[...] = value
  return model


def _differences(wanted: mujoco.MjModel, read: mujoco.MjModel) -> Arrays:
  found: Arrays = {}
  for name in _fields(wanted):
    mine, theirs = getattr(wanted, name), getattr(read, name)
    if mine.shape != theirs.shape:
      raise DeployError(f"the model cannot be written as XML: its {name} changes from {mine.shape} to {theirs.shape}")
    if not np.array_equal(mine, theirs, equal_nan=True):
      found[name] = np.array(mine)
  return found


def _fields(model: mujoco.MjModel) -> set[str]:
  """Return the names of the model's arrays of floating-point numbers."""
  names = (name for name in dir(model) if not name.startswith("_"))
  return {name for name in names if isinstance(v := getattr(model, name), np.ndarray) and v.dtype.kind == "f"}
