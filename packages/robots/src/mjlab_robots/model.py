"""Robots as MJCF: drawn with their own primitives or with meshes, alone or as entities of a scene."""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path

import mujoco
from mjlab_actuators import ActuatorCfg
from mjlab_core.names import check_name
from mjlab_scene import CollisionCfg, EntityArticulationCfg, EntityCfg, InitialStateCfg

from mjlab_robots.meshes import MeshMode, find_meshes

VISUAL_GROUP = 2
"""Group of geoms that are only drawn, primitives and meshes."""
SOFT_JOINT_POS_LIMIT_FACTOR = 0.9
"""Share of each joint's range, about its middle, that its soft limits span."""


@dataclass(frozen=True, kw_only=True)
class MeshGeom:
  """Place of a mesh file on a robot."""

  body: str
  file: str
  """Name in the robot's folder of mesh files; the mesh has this name without the ending."""
  material: str
  pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
  """In the body's frame [m]."""
  quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Robot:
  """Model, meshes, motors, pose and contact presets of a robot."""

  mjcf: str
  """File below `mjlab_robots`: "go1/go1.xml"; geoms that are only drawn have its default class "visual"."""
  menagerie: str
  """Name in MuJoCo Menagerie: "unitree_go1"."""
  meshes: tuple[MeshGeom, ...]
  """Meshes that replace the geoms of `VISUAL_GROUP`."""
  height: float
  """Height of the root body's origin in the default pose [m]."""
  joint_pos: Mapping[str, float]
  """Default pose by joint pattern [rad]."""
  actuators: tuple[ActuatorCfg, ...]
  """Actuators in the order of `ctrl`."""
  presets: Mapping[str, tuple[CollisionCfg, ...]]
  """Contact presets by name: differences from the contact parameters in the MJCF."""

  def spec(self, meshes: MeshMode = "auto") -> mujoco.MjSpec:
    """Return a new spec without actuators. Physics does not depend on `meshes`; see `find_meshes`.

    Raises:
      FileError: Meshes are required, or must be downloaded, and cannot be found.
    """
    folder = find_meshes(self.menagerie, sorted({geom.file for geom in self.meshes}), meshes)
    mjcf = resources.files("mjlab_robots").joinpath(self.mjcf)
    spec = mujoco.MjSpec.from_string(mjcf.read_text(encoding="utf-8"))
    if folder is not None:
      _draw_meshes(spec, self.meshes, folder)
    return spec

  def entity(self, spec_fn: Callable[..., mujoco.MjSpec], meshes: MeshMode, collision: str) -> EntityCfg:
    """Return a new config that shares nothing with this robot.

    Args:
      spec_fn: Module-level function that returns `self.spec(meshes)`; files of runs name it.
      meshes: Passed to `spec_fn`.
      collision: Name of a contact preset.

    Raises:
      UnknownNameError: The preset does not exist.
    """
    check_name("collision preset", collision, self.presets)
    return EntityCfg(
      spec_fn=spec_fn if meshes == "auto" else partial(spec_fn, meshes=meshes),
      init_state=InitialStateCfg(pos=(0.0, 0.0, self.height), joint_pos=dict(self.joint_pos)),
      articulation=EntityArticulationCfg(
        actuators=copy.deepcopy(self.actuators), soft_joint_pos_limit_factor=SOFT_JOINT_POS_LIMIT_FACTOR
      ),
      collisions=copy.deepcopy(self.presets[collision]),
    )


def _draw_meshes(spec: mujoco.MjSpec, geoms: tuple[MeshGeom, ...], folder: Path) -> None:
  for geom in [geom for geom in spec.geoms if geom.group == VISUAL_GROUP]:
    spec.delete(geom)
  for file in sorted({geom.file for geom in geoms}):
    # Absolute, so that the spec can be attached to one with another mesh folder.
    spec.add_mesh(name=Path(file).stem, file=str((folder / file).resolve()))
  visual = spec.find_default("visual")
  for geom in geoms:
    spec.body(geom.body).add_geom(
      visual,
      type=mujoco.mjtGeom.mjGEOM_MESH,
      meshname=Path(geom.file).stem,
      material=geom.material,
      pos=geom.pos,
      quat=geom.quat,
    )
