"""Meshes change pictures only, and are fetched on request only."""

import json
import os
import tarfile
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import mujoco
import mujoco_menagerie
import numpy as np
import pytest
from mjlab_core.errors import FileError
from mjlab_robots import MeshMode, download_meshes, find_meshes, g1_spec, go1_spec, yam_spec

SpecFn = Callable[[MeshMode], mujoco.MjSpec]
ROBOTS: dict[str, SpecFn] = {"go1": go1_spec, "g1": g1_spec, "yam": yam_spec}
MENAGERIE = {"go1": "unitree_go1", "g1": "unitree_g1", "yam": "i2rt_yam"}
FACTS = {
  name: json.loads((Path(__file__).parent / "data" / f"{name}.json").read_text(encoding="utf-8")) for name in ROBOTS
}
each_robot = pytest.mark.parametrize("name", ROBOTS)
unpacks = pytest.mark.skipif(
  not hasattr(tarfile, "data_filter"), reason="Python before 3.11.4 cannot unpack archives safely"
)
needs_meshes = pytest.mark.skipif(
  "MENAGERIE_ROOT" not in os.environ, reason="set MENAGERIE_ROOT to a folder with Menagerie's robots to test meshes"
)


@pytest.fixture
def without_meshes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  """Empty cache, and no releases to fetch."""
  monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
  monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "cache"))
  monkeypatch.setenv("MENAGERIE_BASE_URL", (tmp_path / "releases").as_uri())


def triangle_soup() -> bytes:
  """Return a tetrahedron in binary STL."""
  corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4")
  faces = [corners[list(face)] for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))]
  return bytes(80) + np.uint32(len(faces)).tobytes() + b"".join(bytes(12) + f.tobytes() + bytes(2) for f in faces)


@pytest.fixture
def published(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, without_meshes: None) -> None:
  """Releases that hold a Go1 whose meshes are tetrahedra."""
  entry, assets = mujoco_menagerie.get("unitree_go1"), tmp_path / "unitree_go1" / "assets"
  assets.mkdir(parents=True)
  for file in {geom["file"] for geom in FACTS["go1"]["geoms_visual"]}:
    (assets / file).write_bytes(triangle_soup())
  archive = tmp_path / "releases" / entry.asset
  archive.parent.mkdir()
  with tarfile.open(archive, "w:xz") as tar:
    tar.add(assets.parent, "unitree_go1")
  content = archive.read_bytes()
  entry = replace(entry, sha256=sha256(content).hexdigest(), download_size=len(content))
  monkeypatch.setattr(mujoco_menagerie, "get", {"unitree_go1": entry}.__getitem__)


@pytest.mark.usefixtures("without_meshes")
@each_robot
def test_without_meshes_the_robot_is_drawn_from_primitives(name: str) -> None:
  assert ROBOTS[name]("auto").compile().nmesh == 0


@pytest.mark.usefixtures("without_meshes")
@each_robot
def test_the_error_about_missing_meshes_names_ways_to_get_them(name: str) -> None:
  with pytest.raises(FileError, match=rf"download_meshes\('{MENAGERIE[name]}'\).*MENAGERIE_ROOT"):
    ROBOTS[name]("require")


@pytest.mark.usefixtures("published")
def test_an_old_python_is_named_before_a_download(monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.delattr(tarfile, "data_filter", raising=False)
  with pytest.raises(FileError, match=r"Python before 3\.11\.4 cannot unpack archives safely.*MENAGERIE_ROOT"):
    go1_spec(meshes="download")


@unpacks
@pytest.mark.usefixtures("published")
def test_a_download_is_drawn_and_kept(capsys: pytest.CaptureFixture[str]) -> None:
  with pytest.raises(FileError):
    go1_spec(meshes="require")
  assert go1_spec(meshes="download").compile().nmesh == FACTS["go1"]["counts"]["nmesh"]
  assert "fetching the meshes of unitree_go1" in capsys.readouterr().err
  assert go1_spec().compile().nmesh == FACTS["go1"]["counts"]["nmesh"]
  assert (download_meshes("unitree_go1") / "trunk.stl").is_file()
  assert not capsys.readouterr().err


@pytest.mark.usefixtures("published")
@pytest.mark.parametrize("mode", ["auto", "never", "require"])
def test_only_the_mode_download_downloads(mode: MeshMode, tmp_path: Path) -> None:
  try:
    model = go1_spec(mode).compile()
  except FileError:
    assert mode == "require"
  else:
    assert model.nmesh == 0
  assert not (tmp_path / "cache").exists()


@unpacks
@pytest.mark.usefixtures("without_meshes")
def test_the_error_about_a_download_names_its_address_and_alternatives(tmp_path: Path) -> None:
  with pytest.raises(FileError, match=r"releases/unitree_g1-.*MENAGERIE_ROOT.*meshes='auto'"):
    g1_spec(meshes="download")
  assert not list((tmp_path / "cache").rglob("*.STL"))


@unpacks
@pytest.mark.usefixtures("without_meshes")
def test_a_broken_download_is_refused(tmp_path: Path) -> None:
  (tmp_path / "releases").mkdir()
  (tmp_path / "releases" / mujoco_menagerie.get("unitree_go1").asset).write_bytes(b"not an archive")
  with pytest.raises(FileError, match="does not match the digest"):
    download_meshes("unitree_go1")


@pytest.mark.usefixtures("published")
def test_menagerie_root_replaces_downloads(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  (tmp_path / "mine").mkdir()
  monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path / "mine"))
  with pytest.raises(FileError, match="MENAGERIE_ROOT"):
    go1_spec(meshes="download")
  with pytest.raises(FileError, match="MENAGERIE_ROOT"):
    download_meshes("unitree_go1")
  assert not (tmp_path / "cache").exists()


def test_a_folder_without_all_files_is_not_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  assets = tmp_path / "unitree_go1" / "assets"
  assets.mkdir(parents=True)
  (assets / "trunk.stl").touch()
  monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
  assert find_meshes("unitree_go1", ["trunk.stl"]) == assets
  assert go1_spec().compile().nmesh == 0


@pytest.mark.usefixtures("without_meshes")
def test_a_half_written_cache_is_not_used() -> None:
  model = mujoco_menagerie.Cache().model_path(mujoco_menagerie.get("unitree_go1"))
  (model / "assets").mkdir(parents=True)
  (model / "assets" / "trunk.stl").touch()
  assert find_meshes("unitree_go1", ["trunk.stl"]) is None
  (model / ".complete").touch()
  assert find_meshes("unitree_go1", ["trunk.stl"]) == model / "assets"


def test_a_misspelt_mode_is_refused() -> None:
  with pytest.raises(ValueError, match="mode of meshes 'download me' does not exist"):
    go1_spec(meshes="download me")  # pyright: ignore[reportArgumentType]  # ty: ignore[invalid-argument-type]


@needs_meshes
@each_robot
def test_meshes_have_the_places_of_the_facts(name: str) -> None:
  model, facts = ROBOTS[name]("require").compile(), FACTS[name]
  assert model.nmesh == facts["counts"]["nmesh"]
  assert model.ngeom == facts["counts"]["ngeom"]
  drawn = [int(index) for index in np.flatnonzero(model.geom_group == 2)]
  got = {(model.body(model.geom_bodyid[i]).name, model.mesh(model.geom_dataid[i]).name): i for i in drawn}
  for geom in facts["geoms_visual"]:
    index = got.pop((geom["body"], Path(geom["file"]).stem))
    assert model.mat(model.geom_matid[index]).name == geom["material"]
    # The compiler moves a mesh into its own inertial frame; undo that to see where its file sits in the body.
    mesh, inverse = model.geom_dataid[index], (np.zeros(3), np.zeros(4))
    mujoco.mju_negPose(*inverse, model.mesh_pos[mesh], model.mesh_quat[mesh])
    pos, quat = np.zeros(3), np.zeros(4)
    mujoco.mju_mulPose(pos, quat, model.geom_pos[index], model.geom_quat[index], *inverse)
    np.testing.assert_allclose(pos, geom["attach_pos"], atol=1e-9)
    np.testing.assert_allclose(abs(quat @ np.array(geom["attach_quat"])), 1.0, atol=1e-12)
  assert not got


@needs_meshes
@each_robot
def test_meshes_do_not_change_physics(name: str) -> None:
  worn, plain = ROBOTS[name]("require").compile(), ROBOTS[name]("never").compile()
  for field in ("body_mass", "body_inertia", "body_ipos", "dof_invweight0"):
    np.testing.assert_array_equal(getattr(worn, field), getattr(plain, field))
  first, second = mujoco.MjData(worn), mujoco.MjData(plain)
  for _ in range(20):
    mujoco.mj_step(worn, first)
    mujoco.mj_step(plain, second)
  np.testing.assert_array_equal(first.qpos, second.qpos)


@needs_meshes
@each_robot
def test_a_spec_with_meshes_attaches_to_another(name: str) -> None:
  scene = mujoco.MjSpec()
  scene.attach(ROBOTS[name]("require"), prefix="robot/", frame=scene.worldbody.add_frame())
  assert scene.compile().nmesh == FACTS[name]["counts"]["nmesh"]
