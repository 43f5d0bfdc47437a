"""Ground that rays need not search: the geoms that never move, as triangles.

MuJoCo casts a ray against one geom after another, and a terrain has hundreds. Those that are made of flat faces are
turned into triangles once, when a caster is made, and an engine then looks them up in a tree.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from mjlab_sim.errors import SimulationError

_Geom = mujoco.mjtGeom
_FLAT_FACES = (_Geom.mjGEOM_BOX, _Geom.mjGEOM_MESH, _Geom.mjGEOM_HFIELD)

# Corners of a cube from -1 to 1, x fastest, and its faces seen counter-clockwise from outside.
_CORNERS = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64)
_FACES = np.array(
  [
    *[(0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4)],
    *[(2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5)],
  ]
)

Geoms = NDArray[np.int32]
Mesh = tuple[NDArray[np.float64], NDArray[np.int32]]


@dataclass(frozen=True, kw_only=True)
class RayTargets:
  """What the rays of a caster can hit, sorted by how it is found."""

  geomgroup: tuple[bool, ...] | None
  """Which of the six geom groups rays see, None for all."""
  bodyexclude: NDArray[np.int32]
  """The body that each ray passes through, -1 for none, (num_rays,)."""
  owner: NDArray[np.int32]
  """What each geom is excluded with, (ngeom,): its body, or the root of its kinematic tree."""
  exclude: NDArray[np.int32]
  """The owner whose geoms each ray passes through, -1 for none, (num_rays,)."""
  fixed: Geoms
  """Geoms with flat faces that never move and that all rays see."""
  others: Geoms
  """All other geoms that some ray sees."""


def find_targets(
  model: mujoco.MjModel,
  num_rays: int,
  geomgroup: Sequence[bool] | None,
  bodyexclude: int | Sequence[int],
  exclude_trees: bool,
) -> RayTargets:
  """Sort the geoms that `mj_ray` would look at under the same filters: it skips those of zero alpha too.

  Raises:
    SimulationError: a filter that does not fit the model or the rays.
  """
  if num_rays < 1:
    raise SimulationError(f"num_rays must be at least 1, got {num_rays}")
  if geomgroup is not None and len(geomgroup) != mujoco.mjNGROUP:
    raise SimulationError(f"geomgroup needs {mujoco.mjNGROUP} entries, got {len(geomgroup)}")
  bodies = tuple(bodyexclude) if isinstance(bodyexclude, Sequence) else (bodyexclude,)
  if len(bodies) not in (1, num_rays):
    raise SimulationError(f"bodyexclude must be one body, or one for each of {num_rays} rays, got {len(bodies)}")
  for body in bodies:
    if not -1 <= body < model.nbody:
      raise SimulationError(f"bodyexclude must be a body from 0 to {model.nbody - 1}, or -1, got {body}")
  body_of_ray = np.array(np.broadcast_to(np.asarray(bodies, dtype=np.int32), num_rays))
  owner_of_body = model.body_rootid if exclude_trees else np.arange(model.nbody, dtype=np.int32)
  owner = owner_of_body[model.geom_bodyid]
  exclude = np.where(body_of_ray < 0, -1, owner_of_body[body_of_ray]).astype(np.int32)
  matid = model.geom_matid
  seen = np.where(matid < 0, model.geom_rgba[:, 3], 1.0) != 0.0
  seen[matid >= 0] = model.mat_rgba[matid[matid >= 0], 3] != 0.0
  if geomgroup is not None:
    seen &= np.asarray(geomgroup, dtype=bool)[model.geom_group.clip(0, mujoco.mjNGROUP - 1)]
  excluded = np.isin(owner, exclude)
  if (exclude == exclude[0]).all():
    seen &= ~excluded
  flat = fixed_geoms(model) & np.isin(model.geom_type, _FLAT_FACES) & ~excluded
  return RayTargets(
    geomgroup=None if geomgroup is None else tuple(bool(group) for group in geomgroup),
    bodyexclude=body_of_ray,
    owner=owner,
    exclude=exclude,
    fixed=np.flatnonzero(seen & flat).astype(np.int32),
    others=np.flatnonzero(seen & ~flat).astype(np.int32),
  )


def fixed_bodies(model: mujoco.MjModel) -> NDArray[np.bool_]:
  """Which bodies never move: welded to the world, and not by way of a mocap body, (nbody,)."""
  return (model.body_weldid == 0) & (model.body_mocapid[model.body_rootid] < 0)


def fixed_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
  """Which geoms never move, (ngeom,)."""
  return fixed_bodies(model)[model.geom_bodyid]


def triangulate(model: mujoco.MjModel, geoms: Geoms) -> tuple[Mesh, Geoms]:
  """Surfaces of fixed geoms, just as `mj_ray` sees them.

  Returns:
    Vertices in the world (num_vertices, 3) [m] with triangles (num_triangles, 3), counter-clockwise from outside,
    and the geom of each triangle (num_triangles,).
  """
  data = mujoco.MjData(model)
  mujoco.mj_kinematics(model, data)
  vertices, triangles, owners, start = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int32)], [], 0
  for geom in geoms:
    points, faces = _surface(model, int(geom))
    vertices.append(points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
    triangles.append(faces + start)
    owners.append(np.full(len(faces), geom))
    start += len(points)
  owner = np.concatenate([np.zeros(0), *owners]).astype(np.int32)
  return (np.concatenate(vertices), np.concatenate(triangles).astype(np.int32)), owner


def _surface(model: mujoco.MjModel, geom: int) -> Mesh:
  kind, data = model.geom_type[geom], model.geom_dataid[geom]
  if kind == _Geom.mjGEOM_BOX:
    return _CORNERS * model.geom_size[geom], _FACES
  return mesh_surface(model, data) if kind == _Geom.mjGEOM_MESH else hfield_surface(model, data)


def mesh_surface(model: mujoco.MjModel, mesh: int) -> Mesh:
  """Surface of a mesh in the frame of its geoms."""
  first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
  face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
  return model.mesh_vert[first : first + count].astype(np.float64), model.mesh_face[face : face + faces]


def hfield_surface(model: mujoco.MjModel, hfield: int) -> Mesh:
  """Surface of a height field in the frame of its geoms, just as `mj_ray` sees it."""
  rows, columns, first = model.hfield_nrow[hfield], model.hfield_ncol[hfield], model.hfield_adr[hfield]
  heights = model.hfield_data[first : first + rows * columns].reshape(rows, columns)
  return _height_field(heights.astype(np.float64), model.hfield_size[hfield])


def _height_field(heights: NDArray[np.float64], size: NDArray[np.float64]) -> Mesh:
  """A height field stands on a box, whose top is a surface too: it is what a ray from inside of the field sees."""
  rows, columns = heights.shape
  box = _CORNERS * (size[0], size[1], size[3] / 2) - (0.0, 0.0, size[3] / 2)
  if rows < 2 or columns < 2:
    return box, _FACES
  x, y = np.meshgrid(np.linspace(-size[0], size[0], columns), np.linspace(-size[1], size[1], rows))
  top = np.stack((x, y, heights * size[2]), axis=-1)
  number = np.arange(rows * columns).reshape(rows, columns)
  low, right, far, left = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
  surface = np.stack((low, right, far, low, far, left), axis=-1).reshape(-1, 3)
  # Counter-clockwise seen from above; the walls hang from it down to the box.
  rim = np.concatenate((number[0], number[1:, -1], number[-1, -2::-1], number[-2:0:-1, 0]))
  points = top.reshape(-1, 3)
  foot = points[rim] * (1.0, 1.0, 0.0)
  below = len(points) + np.arange(len(rim))
  after, below_after = np.roll(rim, -1), np.roll(below, -1)
  walls = np.stack((below, below_after, after, below, after, rim), axis=-1).reshape(-1, 3)
  faces = (surface, walls, _FACES + len(points) + len(foot))
  return np.concatenate((points, foot, box)), np.concatenate(faces).astype(np.int32)


class FixedGeometry:
  """Watches whether the geoms that never move are where the compiled model has them, in every world.

  Args:
    model: The compiled model.
    field: Gives a model field as it is now, (1, ...) or (num_envs, ...).
  """

  _GEOM_FIELDS = ("geom_pos", "geom_quat", "geom_size", "geom_dataid")
  _BODY_FIELDS = ("body_pos", "body_quat")

  def __init__(self, model: mujoco.MjModel, field: Callable[[str], torch.Tensor]) -> None:
    self._field = field
    self._compiled: dict[str, tuple[torch.Tensor, torch.Tensor]] = {}
    for names, rows in ((self._GEOM_FIELDS, fixed_geoms(model)), (self._BODY_FIELDS, fixed_bodies(model))):
      for name in names:
        now = field(name)
        index = torch.as_tensor(np.flatnonzero(rows), device=now.device)
        values = torch.as_tensor(getattr(model, name)[rows], dtype=now.dtype, device=now.device)
        self._compiled[name] = index, values
    self._version: int | None = None
    self._is_intact = True

  def forget(self) -> None:
    """Look again at the next chance: the memory of a field was replaced."""
    self._version = None

  def is_intact(self, *, may_look: bool) -> bool:
    """Whether nothing has moved. Fields written since the last look are read, if that is allowed, or not trusted."""
    version = sum(self._field(name)._version for name in self._compiled)
    if version != self._version:
      if not may_look:
        return False
      self._version = version
      self._is_intact = all(
        bool((self._field(name).index_select(1, index) == values).all())
        for name, (index, values) in self._compiled.items()
      )
    return self._is_intact
