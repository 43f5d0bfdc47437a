"""An entity before simulation: its spec with a name for every element, its root, and its initial state."""

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import mujoco
from mjlab_actuators import ActuatorSet
from mjlab_core import MjlabError, match_names

from mjlab_scene.entities.indexing import KINDS, find_elements
from mjlab_scene.entities.initial_state import InitialStateCfg, read_initial_state
from mjlab_scene.models.collision import CollisionCfg, apply_collisions
from mjlab_scene.models.edits import SpecEdit, apply_edits

FREE_JOINT = "floating_base_joint"
"""Name given to an unnamed free joint."""

MOCAP_BASE = "mocap_base"
"""Body that the scene puts above a fixed base to place it in each world."""

Found = tuple[list[int], list[str]]


def _finder(kind: str) -> "Callable[..., Found]":
  """Return the method of an entity that finds elements of a kind."""

  def find(self: "EntitySpec", patterns: str | Sequence[str], preserve_order: bool = False) -> Found:
    names = getattr(self, f"{kind}_names")
    return match_names(patterns, names, what=kind, owner=self.owner, preserve_order=preserve_order)

  find.__doc__ = f"Return local ids and names of each {kind} that patterns match as a whole; each must match one."
  return find


class EntitySpec:
  """A robot, an object or a fixture as an edited spec: everything named, contact presets and actuators applied.

  All names are local: the element "robot/left/elbow" of the scene is "left/elbow" of the entity "robot".

  Args:
    name: Name in the scene.
    spec: The entity alone; it is edited.
    init_state: State that the entity is reset to.
    edits: Changes of looks, lights and cameras.
    collisions: Contact presets.
    actuators: Actuators of joints, tendons and sites; others of the spec are left to the user.

  Raises:
    MjlabError: Anything wrong in the arguments; the message names it.
  """

  body_names: tuple[str, ...]
  """Names of the bodies in the model's order; "mocap_base" is the first of a fixed base."""
  joint_names: tuple[str, ...]
  """Names of the joints in the model's order, the free joint left out."""
  geom_names: tuple[str, ...]
  """Names of the geoms in the model's order."""
  site_names: tuple[str, ...]
  """Names of the sites in the model's order."""
  tendon_names: tuple[str, ...]
  """Names of the tendons in the model's order."""
  actuator_names: tuple[str, ...]
  """Names of the actuators in the model's order; a configured one is named after its target."""
  camera_names: tuple[str, ...]
  """Names of the cameras in the model's order."""
  light_names: tuple[str, ...]
  """Names of the lights in the model's order."""
  material_names: tuple[str, ...]
  """Names of the materials in the model's order."""

  def __init__(
    self,
    name: str,
    spec: mujoco.MjSpec,
    *,
    init_state: InitialStateCfg,
    edits: Sequence[SpecEdit],
    collisions: Sequence[CollisionCfg],
    actuators: ActuatorSet,
  ) -> None:
    if not name or "/" in name:
      raise MjlabError(f"entity name {name!r} must be a word without '/'")
    self.name = name
    self.prefix = f"{name}/"
    """Prefix of the entity's names in the scene."""
    self.owner = f"entity '{name}'"
    """The entity as messages name it."""
    self.spec = spec
    """The entity alone; attaching moves its contents into the scene."""
    self.actuators = actuators
    """Actuator models of joints, tendons and sites."""
    name_everything(spec)
    root = _find_root(spec, self.owner)
    self.is_floating = root is not None and _floats(root)
    """True if the base has a free joint."""
    self.is_mocap = root is not None and not self.is_floating
    """True if the model itself makes the root a mocap body."""
    self.root_body_name: str = MOCAP_BASE if root is None else root.name
    """Name of the body that `root_*` quantities and writes refer to."""
    apply_edits(spec, edits, self.owner)
    apply_collisions(spec, collisions, self.owner)
    actuators.edit_spec(spec)
    name_everything(spec)
    model, self.initial_state = read_initial_state(spec, init_state, self.root_body_name, root is not None, self.owner)
    """State that the entity is reset to, by local name."""
    names = {kind: tuple(find_elements(model, kind).values()) for kind in KINDS}
    if root is None:
      names["body"] = (MOCAP_BASE, *names["body"])
    self._set_names(names)

  def attach(self, scene: mujoco.MjSpec) -> None:
    """Move the entity into the spec of a scene, under its prefix; its keyframes are not taken along."""
    for key in list(self.spec.keys):
      self.spec.delete(key)
    pose = self.initial_state.root_pose
    if not (self.is_floating or self.is_mocap):
      base = scene.worldbody.add_body(name=self.prefix + MOCAP_BASE, mocap=True, pos=pose[:3], quat=pose[3:])
      self._attach(scene, base.add_frame())
      return
    self._attach(scene, scene.worldbody.add_frame())
    if self.is_mocap:
      root = scene.body(self.prefix + self.root_body_name)
      root.pos, root.quat = pose[:3], pose[3:]
      root.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT

  def _attach(self, scene: mujoco.MjSpec, frame: mujoco.MjsFrame) -> None:
    with warnings.catch_warnings():
      # Files of the entity are found by path, even if the scene holds others in memory.
      warnings.filterwarnings("ignore", message="Attaching a child without asset dict")
      scene.attach(self.spec, prefix=self.prefix, frame=frame)

  # Names

  @property
  def is_fixed_base(self) -> bool:
    """True if the base does not float; it is then a mocap body of the model or of the scene."""
    return not self.is_floating

  @property
  def num_bodies(self) -> int:
    """Number of bodies, the scene's mocap base included."""
    return len(self.body_names)

  @property
  def num_joints(self) -> int:
    """Number of joints, the free one left out."""
    return len(self.joint_names)

  @property
  def num_geoms(self) -> int:
    """Number of geoms."""
    return len(self.geom_names)

  @property
  def num_sites(self) -> int:
    """Number of sites."""
    return len(self.site_names)

  @property
  def num_actuators(self) -> int:
    """Number of actuators in the model."""
    return len(self.actuator_names)

  @property
  def is_articulated(self) -> bool:
    """True if it has joints other than the free one."""
    return bool(self.joint_names)

  @property
  def is_actuated(self) -> bool:
    """True if actuators are configured to drive its joints, tendons or sites."""
    return bool(self.actuators.cfgs)

  find_bodies = _finder("body")
  find_joints = _finder("joint")
  find_geoms = _finder("geom")
  find_sites = _finder("site")
  find_tendons = _finder("tendon")
  find_actuators = _finder("actuator")
  find_cameras = _finder("camera")
  find_lights = _finder("light")
  find_materials = _finder("material")

  def _set_names(self, names: Mapping[str, tuple[str, ...]]) -> None:
    for kind in KINDS:
      setattr(self, f"{kind}_names", names[kind])


def _is_free(joint: mujoco.MjsJoint) -> bool:
  return joint.type == mujoco.mjtJoint.mjJNT_FREE


def _floats(body: mujoco.MjsBody) -> bool:
  return any(map(_is_free, body.joints))


def _find_root(spec: mujoco.MjSpec, owner: str) -> mujoco.MjsBody | None:
  """Return the body with the free joint, else a mocap body on top level, else None: a fixed base."""
  top = [body for body in spec.bodies[1:] if body.parent.name == "world"]
  floating = [body for body in spec.bodies if _floats(body)]
  if len(floating) > 1:
    names = ", ".join(f"'{body.name}'" for body in floating)
    raise MjlabError(
      f"{owner}: an entity has at most one free joint, and bodies {names} have one each; make them separate entities"
    )
  return next((body for body in (*floating, *top) if _floats(body) or body.mocap), None)


def name_everything(spec: mujoco.MjSpec) -> None:
  """Name each unnamed body, joint, geom, site, camera, light, tendon, actuator and sensor of `spec`, in place.

  A part of a body is called "<body>_<kind>", an actuator after its target, a sensor "<type>_<object>"; a number is
  appended where that name is taken.
  """
  _name(spec.bodies[1:], "body", lambda body: f"{body.parent.name}_body", taken=["world"])
  _name(spec.joints, "joint", lambda joint: FREE_JOINT if _is_free(joint) else f"{joint.parent.name}_joint")
  for kind, elements in (
    ("geom", spec.geoms),
    ("site", spec.sites),
    ("camera", spec.cameras),
    ("light", spec.lights),
  ):
    _name(elements, kind, lambda element, kind=kind: f"{element.parent.name}_{kind}")
  _name(spec.tendons, "tendon", lambda tendon: "tendon")
  _name(spec.actuators, "actuator", lambda actuator: actuator.target)
  _name(spec.sensors, "sensor", _sensor_name)


def _sensor_name(sensor: mujoco.MjsSensor) -> str:
  kind = sensor.type.name.removeprefix("mjSENS_").lower()
  return f"{kind}_{sensor.objname}" if sensor.objname else kind


def _name(elements: Sequence[Any], kind: str, propose: Callable[[Any], str], taken: Iterable[str] = ()) -> None:
  used = {element.name for element in elements} | set(taken)
  for element in elements:
    if not element.name:
      proposal = propose(element) or kind
      name, number = proposal, 2
      while name in used:
        name, number = f"{proposal}_{number}", number + 1
      element.name = name
      used.add(name)
