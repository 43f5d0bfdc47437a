"""Ghost of a robot: its shapes are where MuJoCo has them."""

from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_motions.ghost import Ghost
from mjlab_motions.kinematics import Kinematics
from motions_robot import XML


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
