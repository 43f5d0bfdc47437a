"""Edits of textures, materials, meshes, geoms, lights and cameras, as compiled."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
import pytest
from mjlab_core.errors import MjlabError
from mjlab_scene import (
  CameraCfg,
  EntityCfg,
  GeomCfg,
  LightCfg,
  MaterialCfg,
  MeshCfg,
  Scene,
  SceneCfg,
  SpecEdit,
  TextureCfg,
)
from scene_models import entity

ROBOT = """
<mujoco>
  <asset>
    <texture name="paint" type="2d" builtin="flat" rgb1="1 0 0" width="4" height="4"/>
    <material name="steel" rgba="0.1 0.2 0.3 1" reflectance="0.2"/>
    <mesh name="ball" builtin="sphere" params="3"/>
  </asset>
  <worldbody>
    <light name="sun" pos="0 0 3"/>
    <body name="base"><freejoint/>
      <geom name="shell" type="mesh" mesh="ball" rgba="1 0 0 1" group="2"/>
      <geom name="foot" size="0.1" material="steel"/>
      <camera name="eye" pos="0.1 0 0" fovy="30"/>
    </body>
  </worldbody>
</mujoco>
"""


def scene(*edits: SpecEdit, of_scene: tuple[SpecEdit, ...] = ()) -> Scene:
  return Scene(SceneCfg(entities={"robot": entity(ROBOT, edits=edits)}, edits=of_scene))


def compiled(*edits: SpecEdit, of_scene: tuple[SpecEdit, ...] = ()) -> mujoco.MjModel:
  return scene(*edits, of_scene=of_scene).compile()


def test_a_new_texture_reaches_the_geoms_of_its_material_in_any_order() -> None:
  model = compiled(
    GeomCfg(names="foot", material="tiles", group=3),
    MaterialCfg(name="tiles", texture="checks", texrepeat=(2.0, 3.0), geoms="shell", rgba=(0.9, 0.8, 0.7, 1.0)),
    TextureCfg(name="checks", type="2d", builtin="checker", rgb1=(1, 1, 1), rgb2=(0, 0, 0), width=8, height=8),
  )
  material = model.material("robot/tiles")
  np.testing.assert_array_equal(model.geom_matid, [material.id, material.id])
  np.testing.assert_allclose(material.texrepeat, [2.0, 3.0])
  texture = model.texture("robot/checks")
  assert material.texid[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] == texture.id
  pixels = model.tex_data[texture.adr[0] : texture.adr[0] + 8 * 8 * 3].reshape(8, 8, 3)
  assert set(np.unique(pixels)) == {0, 255}
  np.testing.assert_allclose(material.rgba, [0.9, 0.8, 0.7, 1.0], rtol=1e-6)
  # A geom of MuJoCo's default colour is drawn in that of its material.
  np.testing.assert_array_equal(model.geom_rgba, 2 * [[0.5, 0.5, 0.5, 1.0]])
  assert model.geom("robot/foot").group == 3


def test_an_edit_of_something_that_exists_changes_only_the_given_fields() -> None:
  before = compiled()
  model = compiled(
    MaterialCfg(name="steel", reflectance=0.7),
    CameraCfg(name="eye", fovy=70.0),
    LightCfg(name="sun", castshadow=False, diffuse=(0.1, 0.2, 0.3), type="directional"),
    GeomCfg(names="shell", rgba=(0.0, 1.0, 0.0, 0.5)),
    TextureCfg(name="paint", rgb1=(0.0, 0.0, 1.0)),
  )
  assert model.material("robot/steel").reflectance == pytest.approx(0.7)
  np.testing.assert_array_equal(model.material("robot/steel").rgba, before.material("robot/steel").rgba)
  assert model.camera("robot/eye").fovy == 70.0
  np.testing.assert_array_equal(model.cam_pos, before.cam_pos)
  light = model.light("robot/sun")
  assert not light.castshadow
  assert light.type == int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
  np.testing.assert_allclose(light.diffuse, [0.1, 0.2, 0.3], rtol=1e-6)
  np.testing.assert_array_equal(light.pos, before.light("robot/sun").pos)
  np.testing.assert_allclose(model.geom("robot/shell").rgba, [0, 1, 0, 0.5])
  assert model.geom("robot/shell").group == 2
  start = model.texture("robot/paint").adr[0]
  assert model.tex_data[start : start + 3].tolist() == [0, 0, 255]


def test_lights_and_cameras_are_added_to_bodies_and_to_the_scene() -> None:
  model = compiled(
    CameraCfg(name="back", body="base", pos=(-1.0, 0.0, 0.5), quat=(0.0, 1.0, 0.0, 0.0), resolution=(64, 48)),
    LightCfg(name="lamp", body="base", pos=(0.0, 0.0, 1.0), dir=(1.0, 0.0, 0.0), cutoff=20.0),
    of_scene=(CameraCfg(name="watch", mode="targetbody", target="robot/base", pos=(3.0, 0.0, 1.0)),),
  )
  back = model.camera("robot/back")
  assert model.body(back.bodyid[0]).name == "robot/base"
  np.testing.assert_allclose(back.quat, [0.0, 1.0, 0.0, 0.0])
  assert model.cam_resolution[back.id].tolist() == [64, 48]
  lamp = model.light("robot/lamp")
  np.testing.assert_allclose(lamp.dir, [1.0, 0.0, 0.0])
  watch = model.camera("watch")
  assert watch.targetbodyid == model.body("robot/base").id


def test_the_hull_of_a_mesh_and_its_size_can_be_changed() -> None:
  before, model = compiled(), compiled(MeshCfg(maxhullvert=12, scale=(2.0, 2.0, 2.0)))
  hull = model.mesh("robot/ball").graphadr[0]
  assert model.mesh_graph[hull] <= 12 < before.mesh_graph[before.mesh("robot/ball").graphadr[0]]
  np.testing.assert_allclose(np.ptp(model.mesh_vert, axis=0), 2.0 * np.ptp(before.mesh_vert, axis=0), rtol=0.01)


def test_a_picture_is_found_from_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  pytest.importorskip("PIL.Image").new("RGB", (2, 2), (10, 20, 30)).save(tmp_path / "wood.png")
  monkeypatch.chdir(tmp_path)
  built = scene(TextureCfg(name="wood", type="2d", file="wood.png"), MaterialCfg(name="m", texture="wood"))
  monkeypatch.chdir("/")
  model = built.compile()
  start = model.texture("robot/wood").adr[0]
  assert model.tex_data[start : start + 3].tolist() == [10, 20, 30]


def test_a_sky_of_the_scene_is_changed() -> None:
  before, model = compiled(), compiled(of_scene=(TextureCfg(name="sky", rgb1=(1, 1, 1), rgb2=(1, 1, 1)),))
  assert model.tex_data[model.texture("sky").adr[0] :][:300].min() == 255
  assert before.tex_data[before.texture("sky").adr[0] :][:300].min() < 255


@pytest.mark.parametrize(
  ("edit", "message"),
  [
    (TextureCfg(name="new", file="lost.png"), "texture 'new': there is no file 'lost.png'"),
    (MaterialCfg(name="m", texture="pain"), "texture 'pain' does not exist. Nearest: paint"),
    (MaterialCfg(name="m", geoms="head"), "pattern 'head' matches no geom"),
    (MaterialCfg(name="m", reflectance=2.0), "entity 'robot', MaterialCfg 'm': reflectance must be in"),
    (GeomCfg(names="foot", group=7), "group must be in"),
    (GeomCfg(names="foot", material="stel"), "material 'stel' does not exist. Nearest: steel"),
    (MeshCfg(names="cube"), "pattern 'cube' matches no mesh"),
    (MeshCfg(maxhullvert=3), "maxhullvert must be -1 or be at least 4, got 3"),
    (CameraCfg(name="c", body="bas"), "entity 'robot', camera 'c': body 'bas' does not exist. Nearest: base"),
    (CameraCfg(name="c", mode="targetbody"), "camera 'c' looks at a body in this mode; give target"),
    (CameraCfg(name="eye", body="world"), "camera 'eye' is on body 'base' already"),
    (LightCfg(name="l", mode="track", type="sopt"), "type 'sopt' does not exist. Nearest: spot"),  # pyright: ignore[reportArgumentType]  # ty: ignore[invalid-argument-type]
  ],
)
def test_impossible_edits_are_refused_by_name(edit: SpecEdit, message: str) -> None:
  with pytest.raises(MjlabError, match=message):
    compiled(edit)


@pytest.mark.parametrize("name", ["lights", "cameras", "textures", "materials", "meshes", "geoms"])
def test_the_fields_of_mjlab_1_say_where_their_configs_go(name: str) -> None:
  make, unknown = cast("Callable[..., Any]", EntityCfg), {"spec_fn": mujoco.MjSpec, name: ()}
  with pytest.raises(MjlabError, match=f"field '{name}' does not exist: put its configs into edits"):
    make(**unknown)
