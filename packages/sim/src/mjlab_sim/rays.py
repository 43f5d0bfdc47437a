"""Rays: their targets, their memory, and ground as triangles.

MuJoCo casts a ray against one geom after another, and a terrain has hundreds. Those that never move and have flat faces
are turned into triangles once, when a caster is made, and an engine then looks them up in a tree.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import mujoco
import numpy as np
import torch
from mjlab_core import Limits, PositiveCount, check_value
from numpy.typing import NDArray

_Geom = mujoco.mjtGeom

# Corners of a cube from -1 to 1, x fastest, its sides seen counter-clockwise from outside, and two triangles of each.
_CORNERS = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64)
_SIDES = np.array([(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)])
_FACES = _SIDES[:, (0, 1, 2, 0, 2, 3)].reshape(-1, 3)

Geoms = NDArray[np.int32]
Mesh = tuple[NDArray[np.float64], NDArray[np.int32]]
GeomGroups = tuple[bool, bool, bool, bool, bool, bool] | None


@dataclass(kw_only=True)
class RayHits:
  """Hits of the rays of one cast; the tensors are the caster's own and hold until its next cast."""

  distance: torch.Tensor
  """Distance along each ray, in lengths of its direction; -1 where nothing was hit, (num_envs, num_rays) [m]."""
  geomid: torch.Tensor | None
  """Geom that was hit, -1 where nothing was, (num_envs, num_rays); None if the caster was made without."""
  normal: torch.Tensor
  """Surface normal at the hit, world frame; zero where nothing was hit, (num_envs, num_rays, 3)."""


class Rays:
  """Rays of one caster and their hits, in fixed memory."""

  def __init__(self, shape: tuple[int, int], dtype: torch.dtype, device: torch.device, *, geomid: bool) -> None:
    self.origins, self.directions, normal = (torch.zeros((*shape, 3), dtype=dtype, device=device) for _ in range(3))
    self.hits = RayHits(
      distance=torch.full(shape, -1.0, dtype=dtype, device=device),
      geomid=torch.full(shape, -1, dtype=torch.int32, device=device) if geomid else None,
      normal=normal,
    )

  def drop_far_hits(self, max_distance: float) -> None:
    """Make misses of the hits beyond a distance [m]."""
    hits, is_far = self.hits, self.hits.distance > max_distance
    hits.distance.masked_fill_(is_far, -1.0)
    hits.normal.masked_fill_(is_far[..., None], 0.0)
    if hits.geomid is not None:
      hits.geomid.masked_fill_(is_far, -1)


@dataclass(frozen=True, kw_only=True)
class RayTargets:
  """Geoms that the rays of a caster can hit, sorted by how they are found."""

  geomgroup: GeomGroups
  """True for each of the six geom groups that rays see, None for all."""
  bodyexclude: NDArray[np.int32]
  """The body that each ray passes through, -1 for none, (num_rays,)."""
  owner: NDArray[np.int32]
  """Owner that each geom is excluded with, (ngeom,): its body, or the root of its kinematic tree."""
  exclude: NDArray[np.int32]
  """The owner whose geoms each ray passes through, -1 for none, (num_rays,)."""
  ground: Geoms
  """Geoms that never move and that all rays see."""
  others: Geoms
  """All other geoms that some ray sees."""
  max_distance: float
  """Range of the rays [m]."""


def as_groups(geomgroup: Sequence[bool] | None) -> GeomGroups:
  """Return the geom groups that are seen as bools, one for each group; None for all."""
  groups: Any = None if geomgroup is None else tuple(map(bool, geomgroup))
  check_value("geomgroup", groups, GeomGroups)
  return groups


def find_targets(
  model: mujoco.MjModel,
  num_rays: int,
  geomgroup: Sequence[bool] | None,
  bodyexclude: int | Sequence[int],
  exclude_trees: bool,
  max_distance: float,
) -> RayTargets:
  """Sort the geoms that `mj_ray` would look at under the same filters: it skips those of zero alpha too.

  Raises:
    MjlabError: a filter that does not fit the model or the rays.
  """
  check_value("num_rays", num_rays, PositiveCount)
  check_value("max_distance", max_distance, Annotated[float, Limits(gt=0, finite=False)])
  groups = as_groups(geomgroup)
  bodies = tuple(bodyexclude) if isinstance(bodyexclude, Sequence) else (bodyexclude,)
  check_value("bodyexclude", bodies, Annotated[tuple[int, ...], Limits(ge=-1, le=model.nbody - 1)])
  body_of_ray = np.array(np.broadcast_to(np.asarray(bodies, dtype=np.int32), num_rays))
  owner_of_body = model.body_rootid if exclude_trees else np.arange(model.nbody, dtype=np.int32)
  owner = owner_of_body[model.geom_bodyid]
  exclude = np.where(body_of_ray < 0, -1, owner_of_body[body_of_ray]).astype(np.int32)
  of_material = np.append(model.mat_rgba[:, 3], 0.0)[model.geom_matid]
  seen = np.where(model.geom_matid < 0, model.geom_rgba[:, 3], of_material) != 0.0
  if groups is not None:
    seen &= np.asarray(groups)[model.geom_group.clip(0, mujoco.mjNGROUP - 1)]
  excluded = np.isin(owner, exclude)
  if (exclude == exclude[0]).all():
    seen &= ~excluded
  ground = fixed_geoms(model) & ~excluded
  return RayTargets(
    geomgroup=groups,
    bodyexclude=body_of_ray,
    owner=owner,
    exclude=exclude,
    ground=np.flatnonzero(seen & ground).astype(np.int32),
    others=np.flatnonzero(seen & ~ground).astype(np.int32),
    max_distance=max_distance,
  )


def fixed_bodies(model: mujoco.MjModel) -> NDArray[np.bool_]:
  """Return True for bodies that never move: welded to the world, and not by way of a mocap body, (nbody,)."""
  return (model.body_weldid == 0) & (model.body_mocapid[model.body_rootid] < 0)


def fixed_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
  """Return True for geoms that never move, (ngeom,)."""
  return fixed_bodies(model)[model.geom_bodyid]


def triangulate(model: mujoco.MjModel, geoms: Geoms) -> tuple[Mesh, Geoms]:
  """Return the surfaces of fixed geoms, at least one, as `mj_ray` sees them.

  Returns:
    Vertices in the world (num_vertices, 3) [m] with triangles (num_triangles, 3), counter-clockwise from outside,
    and the geom of each triangle (num_triangles,).
  """
  data = mujoco.MjData(model)
  mujoco.mj_kinematics(model, data)
  vertices, triangles, start = [], [], 0
  for geom in geoms:
    points, faces = _surface(model, int(geom))
    vertices.append(points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
    triangles.append(faces + start)
    start += len(points)
  owner = np.repeat(geoms, [len(faces) for faces in triangles])
  return (np.concatenate(vertices), np.concatenate(triangles).astype(np.int32)), owner


def _surface(model: mujoco.MjModel, geom: int) -> Mesh:
  kind = model.geom_type[geom]
  if kind == _Geom.mjGEOM_BOX:
    return _CORNERS * model.geom_size[geom], _FACES
  return asset_surface(model, kind, model.geom_dataid[geom])


def asset_surface(model: mujoco.MjModel, kind: int, number: int) -> Mesh:
  """Return the surface of a mesh or a height field in the frame of its geoms."""
  if kind == _Geom.mjGEOM_HFIELD:
    return _hfield_surface(model, number)
  first, count = model.mesh_vertadr[number], model.mesh_vertnum[number]
  face, faces = model.mesh_faceadr[number], model.mesh_facenum[number]
  return model.mesh_vert[first : first + count].astype(np.float64), model.mesh_face[face : face + faces]


def heights_of(model: mujoco.MjModel, hfield: int) -> NDArray[np.float32]:
  """Return the heights of a height field, (rows, columns), from 0 to 1."""
  rows, columns, first = model.hfield_nrow[hfield], model.hfield_ncol[hfield], model.hfield_adr[hfield]
  return model.hfield_data[first : first + rows * columns].reshape(rows, columns)


def _hfield_surface(model: mujoco.MjModel, hfield: int) -> Mesh:
  """Return the surface of a height field in the frame of its geoms, as `mj_ray` sees it.

  It includes the box that the field stands on, whose top is seen from inside of the field.
  """
  heights, size = heights_of(model, hfield).astype(np.float64), model.hfield_size[hfield]
  rows, columns = heights.shape
  box = _CORNERS * (size[0], size[1], size[3] / 2) - (0.0, 0.0, size[3] / 2)
  if rows < 2 or columns < 2:
    return box, _FACES
  x, y = np.meshgrid(np.linspace(-size[0], size[0], columns), np.linspace(-size[1], size[1], rows))
  # A rim of points at height 0 below those of the border: the cells between are walls down to the box.
  z = np.pad(heights * size[2], 1)
  points = np.stack((np.pad(x, 1, mode="edge"), np.pad(y, 1, mode="edge"), z), axis=-1).reshape(-1, 3)
  number = np.arange(len(points)).reshape(z.shape)
  low, right, far, left = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
  # Counter-clockwise seen from above.
  surface = np.stack((low, right, far, low, far, left), axis=-1).reshape(-1, 3)
  faces = np.concatenate((surface, _FACES + len(points)))
  return np.concatenate((points, box)), faces.astype(np.int32)
