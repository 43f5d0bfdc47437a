"""What the parts of an entity are called, and how they are found by pattern."""

from collections.abc import Mapping, Sequence

from mjlab_core.names import match_names


class EntityNames:
  """The part of `Entity` that answers by name; it does so from the start, before anything is compiled."""

  name: str
  _names: Mapping[str, tuple[str, ...]]

  @property
  def body_names(self) -> tuple[str, ...]:
    """Local names of the bodies, in the model's order; "mocap_base" is the first of a fixed base."""
    return self._names["body"]

  @property
  def joint_names(self) -> tuple[str, ...]:
    """Local names of the joints but the free one, in the model's order."""
    return self._names["joint"]

  @property
  def geom_names(self) -> tuple[str, ...]:
    """Local names of the geoms, in the model's order."""
    return self._names["geom"]

  @property
  def site_names(self) -> tuple[str, ...]:
    """Local names of the sites, in the model's order."""
    return self._names["site"]

  @property
  def tendon_names(self) -> tuple[str, ...]:
    """Local names of the tendons, in the model's order."""
    return self._names["tendon"]

  @property
  def actuator_names(self) -> tuple[str, ...]:
    """Local names of the actuators, in the model's order; configured ones are named after their joint."""
    return self._names["actuator"]

  @property
  def camera_names(self) -> tuple[str, ...]:
    """Local names of the cameras, in the model's order."""
    return self._names["camera"]

  @property
  def light_names(self) -> tuple[str, ...]:
    """Local names of the lights, in the model's order."""
    return self._names["light"]

  @property
  def material_names(self) -> tuple[str, ...]:
    """Local names of the materials, in the model's order."""
    return self._names["material"]

  @property
  def num_bodies(self) -> int:
    """Number of bodies, the scene's mocap base included."""
    return len(self._names["body"])

  @property
  def num_joints(self) -> int:
    """Number of joints, the free one left out."""
    return len(self._names["joint"])

  @property
  def num_geoms(self) -> int:
    """Number of geoms."""
    return len(self._names["geom"])

  @property
  def num_sites(self) -> int:
    """Number of sites."""
    return len(self._names["site"])

  @property
  def num_actuators(self) -> int:
    """Number of actuators in the model."""
    return len(self._names["actuator"])

  def find_bodies(self, patterns: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
    """Local ids and names of the bodies that patterns match as a whole; a pattern without a match is an error."""
    return self._find("body", patterns, preserve_order)

  def find_joints(self, patterns: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
    """Local ids and names of joints; see `find_bodies`."""
    return self._find("joint", patterns, preserve_order)

  def find_geoms(self, patterns: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
    """Local ids and names of geoms; see `find_bodies`."""
    return self._find("geom", patterns, preserve_order)

  def find_sites(self, patterns: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
    """Local ids and names of sites; see `find_bodies`."""
    return self._find("site", patterns, preserve_order)

  def find_tendons(self, patterns: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
    """Local ids and names of tendons; see `find_bodies`."""
    return self._find("tendon", patterns, preserve_order)

  def find_actuators(self, patterns: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
    """Local ids and names of actuators; see `find_bodies`."""
    return self._find("actuator", patterns, preserve_order)

  def find_cameras(self, patterns: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
    """Local ids and names of cameras; see `find_bodies`."""
    return self._find("camera", patterns, preserve_order)

  def find_lights(self, patterns: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
    """Local ids and names of lights; see `find_bodies`."""
    return self._find("light", patterns, preserve_order)

  def find_materials(self, patterns: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
    """Local ids and names of materials; see `find_bodies`."""
    return self._find("material", patterns, preserve_order)

  def _find(self, kind: str, patterns: str | Sequence[str], preserve_order: bool) -> tuple[list[int], list[str]]:
    return match_names(
      patterns, self._names[kind], what=kind, owner=f"entity '{self.name}'", preserve_order=preserve_order
    )
