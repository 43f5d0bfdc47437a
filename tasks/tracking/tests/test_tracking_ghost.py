"""The reference in viewers: the robot's shapes where the reference has them, and a target that can be held."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_tracking.kinematics import Kinematics
from mjlab_tracking.mdp.ghost import Ghost
from tracking_env import clips, command, make, still, without_failures, zeros
from tracking_robot import XML


class Canvas:
  """Notes what is drawn, row by row."""

  def __init__(self, worlds: tuple[int, ...] = (0,)) -> None:
    self.worlds = worlds
    self.drawn: list[tuple[str, tuple[Any, ...]]] = []

  def __getattr__(self, name: str) -> Any:
    return lambda *arguments: self.drawn.append((name, arguments))


def test_each_shape_is_where_mujoco_has_it() -> None:
  spec = mujoco.MjSpec.from_string(XML)
  tetrahedron = [[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0.05, 0.05, 0.4]]
  spec.add_mesh(name="hat", uservert=np.ravel(tetrahedron))
  spec.body("arm").add_geom(
    type=mujoco.mjtGeom.mjGEOM_MESH, meshname="hat", pos=(0.1, 0.2, 0.3), euler=(20, 30, 40), mass=0
  )
  spec.body("arm").add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=(0.05, 0.1, 0), mass=0)
  model = spec.compile()
  data = mujoco.MjData(model)
  rng = np.random.default_rng(0)
  data.qpos[:] = rng.normal(size=model.nq)
  data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
  mujoco.mj_kinematics(model, data)
  canvas: Any = Canvas()
  qpos = torch.from_numpy(data.qpos)[None]
  Ghost(Kinematics(model)).draw(canvas, qpos[:, :3], qpos[:, 3:7], qpos[:, 7:])
  own = [g for g in range(model.ngeom) if model.geom(g).name != "ground"]
  assert len(canvas.drawn) == len(own)
  for geom, (name, arguments) in zip(own, canvas.drawn, strict=True):
    matrix = data.geom_xmat[geom].reshape(3, 3)
    if name == "lines":
      start, end, _, radius = arguments
      np.testing.assert_allclose((start + end)[0] / 2, data.geom_xpos[geom], atol=1e-9)
      np.testing.assert_allclose((end - start)[0] / 2, matrix[:, 2] * model.geom_size[geom][1], atol=1e-9)
      assert radius == model.geom_size[geom][0]
    elif name == "meshes":
      mesh, origin, quat, _ = arguments
      assert mesh == "hat"
      turn = np.empty(9)
      mujoco.mju_quat2Mat(turn, quat[0].numpy())
      # The first vertex of the file is its origin; MuJoCo has moved it.
      index = model.geom_dataid[geom]
      vertices = model.mesh_vert[model.mesh_vertadr[index] :][:4]
      seen = sorted(map(tuple, np.round(vertices @ matrix.T + data.geom_xpos[geom], 5)))
      drawn = sorted(map(tuple, np.round(np.array(tetrahedron) @ turn.reshape(3, 3).T + origin[0].numpy(), 5)))
      np.testing.assert_allclose(drawn, seen, atol=2e-5)
    else:
      np.testing.assert_allclose(arguments[0][0], data.geom_xpos[geom], atol=1e-9)
  assert {name for name, _ in canvas.drawn} == {"spheres", "lines", "ellipsoids", "meshes"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
  return clips(tmp_path_factory.mktemp("clips"))


def test_the_ghost_is_the_reference_of_the_worlds_that_are_shown(
  folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
  # Of primitives, whose places are told, also where there are meshes.
  monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
  cfg = without_failures(still(folder))
  env, term = make(cfg)
  canvas: Any = Canvas((2, 0))
  term.debug_draw(canvas)
  model = env.sim.mj_model
  data = mujoco.MjData(model)
  root = term.library.body_names.index("pelvis")
  for row, world in enumerate((2, 0)):
    data.qpos[:3] = term.body_pos_w[world, root]
    data.qpos[3:7] = term.body_quat_w[world, root]
    data.qpos[7:] = term.joint_pos[world]
    mujoco.mj_kinematics(model, data)
    centers = [data.geom_xpos[g] for g in range(model.ngeom) if model.geom_group[g] == 2]
    drawn = [
      (arguments[0] + arguments[1])[row] / 2 if name == "lines" else arguments[0][row]
      for name, arguments in canvas.drawn
    ]
    np.testing.assert_allclose(np.array([point.numpy() for point in drawn]), centers, atol=1e-5)
  assert "command motion" in env.drawers()


def test_a_target_that_is_held_stays_until_it_is_let_go(folder: Path) -> None:
  cfg = without_failures(still(folder))
  command(cfg).sampling = "start"
  env, term = make(cfg)
  (axis,) = term.axes
  assert axis == ("time [s]", 0.0, pytest.approx(0.8))
  assert "motion" in env.steering()
  term.steer(1, [0.4])
  # Seen at once, also where nobody steps.
  assert term.frame.tolist() == [1, 20, 1, 1]
  assert not torch.equal(term.anchor_pos_w[1], term.anchor_pos_w[3])
  for _ in range(3):
    env.step(zeros(env))
  assert term.frame.tolist() == [4, 20, 4, 4]
  torch.testing.assert_close(term.joint_pos[1], term.library.table[term.library.offsets[term.clip[1]] + 20, :29])
  term.steer(1, None)
  env.step(zeros(env))
  assert term.frame.tolist() == [5, 21, 5, 5]
