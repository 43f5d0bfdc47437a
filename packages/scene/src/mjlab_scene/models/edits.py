"""Edits of a model as configs: textures, materials, meshes, geoms, lights and cameras."""

import os
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, Literal

import mujoco
from mjlab_core import (
  Config,
  Limits,
  MjlabError,
  NonNegative,
  Positive,
  PositiveCount,
  check_fields,
  check_name,
  match_names,
)

Color = Annotated[tuple[float, float, float], Limits(ge=0, le=1)]
ColorWithAlpha = Annotated[tuple[float, float, float, float], Limits(ge=0, le=1)]
Vector = Annotated[tuple[float, float, float], Limits()]
Quaternion = Annotated[tuple[float, float, float, float], Limits()]
Share = Annotated[float, Limits(ge=0, le=1)]
Counts = Annotated[tuple[int, int], Limits(ge=1)]
Mode = Literal["fixed", "track", "trackcom", "targetbody", "targetbodycom"]


@dataclass(kw_only=True)
class SpecEdit(Config):
  """Base of edits of a model. Fields that are None keep the value of the model, or MuJoCo's default in a new element.

  Names are those of the model that is edited: of the entity alone in `EntityCfg.edits`, with the entity's prefix in
  `SceneCfg.edits`.
  """

  stage: ClassVar[int] = 2
  """Order of edits: textures are 0, materials 1, and the others 2."""

  @abstractmethod
  def apply(self, spec: mujoco.MjSpec, owner: str) -> None:
    """Write the edit into `spec`; `owner` begins error messages."""

  def _write(self, element: Any, *without: str) -> None:
    """Copy all fields that are given into the attributes of `element` of the same name."""
    for field in fields(self):
      value = getattr(self, field.name)
      if value is None or field.name in ("name", "names", *without):
        continue
      present = getattr(element, field.name)
      if isinstance(value, str) and not isinstance(present, str):
        # A member of an enumeration: "checker" is mjBUILTIN_CHECKER.
        members = type(present).__members__.items()
        value = next(member for name, member in members if name.endswith(f"_{value.upper()}"))
      elif field.name == "quat":
        element.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
      setattr(element, field.name, value)


@dataclass(kw_only=True)
class TextureCfg(SpecEdit):
  """Texture, new or changed. A new one has `builtin` or `file`."""

  stage: ClassVar[int] = 0

  name: str
  type: Literal["2d", "cube", "skybox"] | None = None
  builtin: Literal["none", "checker", "gradient", "flat"] | None = None
  rgb1: Color | None = None
  rgb2: Color | None = None
  width: PositiveCount | None = None
  """Width of a built-in texture [pixels]."""
  height: PositiveCount | None = None
  """Height of a built-in texture [pixels]; cubes and skies do not need it."""
  mark: Literal["none", "edge", "cross", "random"] | None = None
  markrgb: Color | None = None
  random: Share | None = None
  """Share of pixels with a mark, for mark "random"."""
  file: str | None = None
  """Picture, from the working directory or absolute."""

  def apply(self, spec: mujoco.MjSpec, owner: str) -> None:
    found = spec.texture(self.name) or spec.add_texture(name=self.name)
    self._write(found, "file")
    if self.file is not None:
      found.file = _path(self.file, spec, f"{owner}: texture '{self.name}'")


@dataclass(kw_only=True)
class MaterialCfg(SpecEdit):
  """Material, new or changed, and the geoms that wear it."""

  stage: ClassVar[int] = 1

  name: str
  rgba: ColorWithAlpha | None = None
  texture: str | None = None
  """Name of its texture."""
  texrepeat: Annotated[tuple[float, float], Limits(gt=0)] | None = None
  texuniform: bool | None = None
  """True: `texrepeat` counts per metre, not per geom."""
  emission: NonNegative | None = None
  specular: Share | None = None
  shininess: Share | None = None
  reflectance: Share | None = None
  geoms: str | tuple[str, ...] | None = None
  """Patterns of geoms that get it; each must match one. The colour of the material replaces their own."""

  def apply(self, spec: mujoco.MjSpec, owner: str) -> None:
    found = spec.material(self.name) or spec.add_material(name=self.name)
    self._write(found, "texture", "geoms")
    if self.texture is not None:
      check_name("texture", self.texture, [texture.name for texture in spec.textures], owner)
      found.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = self.texture
    if self.geoms is not None:
      GeomCfg(names=self.geoms, material=self.name).apply(spec, owner)


@dataclass(kw_only=True)
class MeshCfg(SpecEdit):
  """Change of meshes that the model has."""

  names: str | tuple[str, ...] = ".*"
  """Patterns; each must match a mesh."""
  maxhullvert: Literal[-1] | Annotated[int, Limits(ge=4)] | None = None
  """Maximum number of vertices of the convex hull that collides; -1 for no limit, else at least 4."""
  scale: Annotated[tuple[float, float, float], Limits(nonzero=True)] | None = None
  inertia: Literal["convex", "exact", "legacy", "shell"] | None = None
  """Method of computing the inertia of bodies without one."""

  def apply(self, spec: mujoco.MjSpec, owner: str) -> None:
    for mesh in _matched(spec.meshes, self.names, "mesh", owner):
      self._write(mesh)


@dataclass(kw_only=True)
class GeomCfg(SpecEdit):
  """Change of the looks of geoms; `CollisionCfg` sets contact parameters."""

  names: str | tuple[str, ...]
  """Patterns; each must match a geom."""
  group: Annotated[int, Limits(ge=0, le=5)] | None = None
  rgba: ColorWithAlpha | None = None
  material: str | None = None
  """Name of a material, which brings its colour unless `rgba` is given."""

  def apply(self, spec: mujoco.MjSpec, owner: str) -> None:
    if self.material is not None:
      check_name("material", self.material, [material.name for material in spec.materials], owner)
    for geom in _matched(spec.geoms, self.names, "geom", owner):
      if self.material is not None:
        geom.rgba = _DEFAULT_RGBA
      self._write(geom)


@dataclass(kw_only=True)
class _Mounted(SpecEdit):
  """Light or camera on a body, new or changed."""

  kind: ClassVar[str]
  """Kind of the element, as MjSpec calls it."""

  name: str
  body: str | None = None
  """Body of a new light or camera; None for the world."""
  mode: Mode | None = None
  target: str | None = None
  """Body to look at, in modes that have a target."""
  pos: Vector | None = None
  """In the frame of the body [m]."""

  def apply(self, spec: mujoco.MjSpec, owner: str) -> None:
    bodies = [body.name for body in spec.bodies]
    for name in (self.body, self.target):
      if name is not None:
        check_name("body", name, bodies, f"{owner}, {self.kind} '{self.name}'")
    found = getattr(spec, self.kind)(self.name)
    if found is None:
      carrier = spec.worldbody if self.body is None else spec.body(self.body)
      found = getattr(carrier, f"add_{self.kind}")(name=self.name)
    elif self.body is not None and found.parent.name != self.body:
      raise MjlabError(
        f"{owner}: {self.kind} '{self.name}' is on body '{found.parent.name}' already; give a new one another name"
      )
    self._write(found, "body", "target")
    if self.target is not None:
      found.targetbody = self.target
    if found.mode in _AIMED and not found.targetbody:
      raise MjlabError(f"{owner}: {self.kind} '{self.name}' looks at a body in this mode; give target")


@dataclass(kw_only=True)
class LightCfg(_Mounted):
  """Light, new or changed."""

  kind: ClassVar[str] = "light"

  type: Literal["spot", "directional", "point"] | None = None
  active: bool | None = None
  castshadow: bool | None = None
  dir: Annotated[Vector, Limits()] | None = None
  """Direction of the rays, in the frame of the body."""
  diffuse: Color | None = None
  specular: Color | None = None
  ambient: Color | None = None
  attenuation: Annotated[Vector, Limits(ge=0)] | None = None
  """Constant, linear and quadratic attenuation with the distance."""
  cutoff: Annotated[float, Limits(gt=0, le=180)] | None = None
  """Angle of a spot's cone [degrees]."""
  exponent: NonNegative | None = None


@dataclass(kw_only=True)
class CameraCfg(_Mounted):
  """Camera, new or changed."""

  kind: ClassVar[str] = "camera"

  quat: Quaternion | None = None
  """Orientation in the frame of the body, (w, x, y, z); the camera looks along -z, with y up."""
  fovy: Annotated[Positive, Limits(lt=180)] | None = None
  """Vertical field of view [degrees]."""
  resolution: Counts | None = None
  """Width and height [pixels]."""


_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's default colour, of geoms that have the colour of their material."""
_AIMED = (mujoco.mjtCamLight.mjCAMLIGHT_TARGETBODY, mujoco.mjtCamLight.mjCAMLIGHT_TARGETBODYCOM)


def apply_edits(spec: mujoco.MjSpec, edits: Sequence[SpecEdit], owner: str) -> None:
  """Write edits into a spec: textures, then materials, then the others, each in the order given.

  Raises:
    MjlabError: A field is impossible, or something that an edit names does not exist.
  """
  for edit in edits:
    check_fields(edit, f"{owner}, {type(edit).__name__} {getattr(edit, 'name', None) or getattr(edit, 'names', '')!r}")
  for edit in sorted(edits, key=lambda edit: edit.stage):
    edit.apply(spec, owner)


def _matched(elements: Sequence[Any], patterns: str | tuple[str, ...], kind: str, owner: str) -> list[Any]:
  ids, _ = match_names(patterns, [element.name for element in elements], what=kind, owner=owner)
  return [elements[i] for i in ids]


def _path(file: str, spec: mujoco.MjSpec, what: str) -> str:
  """Return a path that MuJoCo finds wherever the model is attached."""
  if file in spec.assets:
    return file
  if not os.path.isfile(file):
    raise MjlabError(f"{what}: there is no file {file!r}")
  return os.path.abspath(file)
