"""A scene that is written is the same model when it is read."""

import zipfile
from pathlib import Path

import mujoco
import numpy as np
from mjlab_scene import Scene, SceneCfg
from mjlab_terrain import PlaneCfg
from scene_models import entity

CUBE = "\n".join(
  [f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
  + ["f 1 3 2", "f 2 3 4", "f 5 6 7", "f 6 8 7", "f 1 2 5", "f 2 6 5", "f 3 7 4", "f 4 7 8", "f 1 5 3", "f 3 5 7"]
  + ["f 2 4 6", "f 4 8 6"]
)


def scene(folder: Path) -> Scene:
  (folder / "cube.obj").write_text(CUBE, encoding="utf-8")
  text = f"""
  <mujoco><asset><mesh name="cube" file="{folder / "cube.obj"}"/></asset>
    <worldbody><body name="box"><freejoint/><geom type="mesh" mesh="cube"/></body></worldbody>
  </mujoco>"""
  return Scene(SceneCfg(terrain=PlaneCfg(), entities={"box": entity(text)}))


def test_a_written_scene_is_the_same_model_and_the_scene_stays(tmp_path: Path) -> None:
  made = scene(tmp_path)
  before = made.compile()
  written = made.write(tmp_path / "out")
  again = mujoco.MjModel.from_xml_path(str(written))
  for model in (again, made.compile()):
    assert (model.nbody, model.ngeom, model.nmesh) == (before.nbody, before.ngeom, before.nmesh)
    np.testing.assert_allclose(model.body_inertia, before.body_inertia, rtol=1e-4)
    np.testing.assert_allclose(model.mesh_vert, before.mesh_vert, atol=1e-5)


def test_an_archive_holds_the_scene_and_its_files(tmp_path: Path) -> None:
  path = scene(tmp_path).to_zip(tmp_path / "scene.zip")
  with zipfile.ZipFile(path) as archive:
    archive.extractall(tmp_path / "unpacked")
    assert "scene.xml" in archive.namelist()
  assert mujoco.MjModel.from_xml_path(str(tmp_path / "unpacked" / "scene.xml")).nmesh == 1
