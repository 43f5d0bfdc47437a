"""Meshes change what is seen, never what is simulated, and are never fetched unasked."""

import json
import os
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjlab_robots import MeshesNotFoundError, find_meshes, go1_spec

FACTS = json.loads((Path(__file__).parent / "data" / "go1.json").read_text(encoding="utf-8"))
needs_meshes = pytest.mark.skipif(
  "MENAGERIE_ROOT" not in os.environ, reason="set MENAGERIE_ROOT to a folder with Menagerie's robots to test meshes"
)


@pytest.fixture
def without_meshes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
  monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path))


@pytest.mark.usefixtures("without_meshes")
def test_without_meshes_the_robot_is_drawn_from_primitives() -> None:
  assert go1_spec().compile().nmesh == 0
  assert find_meshes("unitree_go1", ["trunk.stl"]) is None


@pytest.mark.usefixtures("without_meshes")
def test_required_meshes_that_are_missing_say_how_to_get_them() -> None:
  with pytest.raises(MeshesNotFoundError, match=r"prefetch\(\['unitree_go1'\]\).*MENAGERIE_ROOT"):
    go1_spec(meshes="require")


def test_a_folder_that_lacks_a_file_is_not_taken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  assets = tmp_path / "unitree_go1" / "assets"
  assets.mkdir(parents=True)
  (assets / "trunk.stl").touch()
  monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
  assert find_meshes("unitree_go1", ["trunk.stl"]) == assets
  assert go1_spec().compile().nmesh == 0


def test_a_published_cache_is_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  import mujoco_menagerie

  monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
  monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path))
  model = mujoco_menagerie.Cache().model_path(mujoco_menagerie.get("unitree_go1"))
  (model / "assets").mkdir(parents=True)
  (model / "assets" / "trunk.stl").touch()
  assert find_meshes("unitree_go1", ["trunk.stl"]) is None
  (model / ".complete").touch()
  assert find_meshes("unitree_go1", ["trunk.stl"]) == model / "assets"


def test_a_misspelt_mode_is_refused() -> None:
  with pytest.raises(ValueError, match="'auto', 'never' or 'require'"):
    go1_spec(meshes="always")  # pyright: ignore[reportArgumentType]  # ty: ignore[invalid-argument-type]


@needs_meshes
def test_meshes_sit_where_the_facts_say() -> None:
  model = go1_spec(meshes="require").compile()
  assert model.nmesh == FACTS["counts"]["nmesh"]
  assert model.ngeom == FACTS["counts"]["ngeom"]
  drawn = np.flatnonzero(model.geom_group == 2)
  got = {model.body(model.geom_bodyid[i]).name: i for i in drawn}
  for geom in FACTS["geoms_visual"]:
    index = got[geom["body"]]
    assert model.mesh(model.geom_dataid[index]).name == geom["mesh"]
    assert model.mat(model.geom_matid[index]).name == geom["material"]
    # The compiler moves a mesh into its own inertial frame; undo that to see where its file sits in the body.
    mesh, inverse = model.geom_dataid[index], (np.zeros(3), np.zeros(4))
    mujoco.mju_negPose(*inverse, model.mesh_pos[mesh], model.mesh_quat[mesh])
    pos, quat = np.zeros(3), np.zeros(4)
    mujoco.mju_mulPose(pos, quat, model.geom_pos[index], model.geom_quat[index], *inverse)
    np.testing.assert_allclose(pos, geom["attach_pos"], atol=1e-9)
    np.testing.assert_allclose(abs(quat @ np.array(geom["attach_quat"])), 1.0, atol=1e-12)


@needs_meshes
def test_meshes_do_not_change_physics() -> None:
  worn, plain = go1_spec(meshes="require").compile(), go1_spec(meshes="never").compile()
  for field in ("body_mass", "body_inertia", "body_ipos", "dof_invweight0"):
    np.testing.assert_array_equal(getattr(worn, field), getattr(plain, field))
  first, second = mujoco.MjData(worn), mujoco.MjData(plain)
  for _ in range(20):
    mujoco.mj_step(worn, first)
    mujoco.mj_step(plain, second)
  np.testing.assert_array_equal(first.qpos, second.qpos)


@needs_meshes
def test_a_spec_with_meshes_attaches_to_another() -> None:
  scene = mujoco.MjSpec()
  scene.attach(go1_spec(meshes="require"), prefix="robot/", frame=scene.worldbody.add_frame())
  assert scene.compile().nmesh == FACTS["counts"]["nmesh"]
