"""Contacts of parts of an entity: who touches what, how hard, and for how long."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise, product
from math import prod
from typing import TYPE_CHECKING, Any, Literal, get_args

import mujoco
import torch
from mjlab_core import DebugDraw, fill_, unknown, why_no_count

from mjlab_sensors._elements import match_elements, names_of
from mjlab_sensors.sensor import Sensor, SensorCfg, sensordata_columns

if TYPE_CHECKING:
  from mjlab_sim import Simulation

ContactMode = Literal["geom", "body", "subtree"]
ContactField = Literal["found", "force", "torque", "dist", "pos", "normal", "tangent"]
ContactReduce = Literal["none", "mindist", "maxforce", "netforce"]

# In the order in which MuJoCo lays them out within a slot, with their widths.
_WIDTHS: dict[str, int] = {"found": 1, "force": 3, "torque": 3, "dist": 1, "pos": 3, "normal": 3, "tangent": 3}
_OBJECTS = {
  "geom": mujoco.mjtObj.mjOBJ_GEOM,
  "body": mujoco.mjtObj.mjOBJ_BODY,
  # MuJoCo's integer code for a subtree; the object is its root body.
  "subtree": mujoco.mjtObj.mjOBJ_XBODY,
}


@dataclass(kw_only=True, frozen=True)
class ContactMatch:
  """Parts of the scene that take part in contacts."""

  mode: ContactMode
  """What the patterns name: single geoms, bodies with all their geoms, or bodies with all their descendants."""
  pattern: str | tuple[str, ...]
  """Whole regular expressions over the names of the entity's own elements, or over full names without an entity."""
  entity: str | None = None
  """Entity that the elements belong to."""
  exclude: str | tuple[str, ...] = ()
  """Patterns, under the same rule, of elements to leave out again."""
  preserve_order: bool = False
  """Order the elements as the patterns are, instead of as they come in the model."""

  def __post_init__(self) -> None:
    if self.mode not in _OBJECTS:
      raise ValueError(unknown("mode", self.mode, _OBJECTS, f"ContactMatch {self.pattern!r}"))

  def resolve(self, spec: mujoco.MjSpec, entities: Mapping[str, Any], owner: str) -> list[str]:
    """Full names of the elements; NameMatchError if there are none."""
    return match_elements(
      spec,
      entities,
      self.mode,
      self.pattern,
      entity=self.entity,
      exclude=self.exclude,
      preserve_order=self.preserve_order,
      owner=owner,
    )


@dataclass(kw_only=True)
class ContactSensorCfg(SensorCfg):
  """Contacts of each primary with each secondary."""

  primary: ContactMatch
  """The elements whose contacts are reported, each on its own."""
  secondary: ContactMatch | None = None
  """The elements that they are in contact with, each on its own; None for anything, all together. A subtree may be its
  own secondary."""
  fields: tuple[ContactField, ...] = ("found", "force")
  """What is reported. `track_air_time` adds "found"."""
  reduce: ContactReduce = "maxforce"
  """Which contacts of a pair fill its slots: the first of MuJoCo's list ("none", an arbitrary order), the deepest
  ("mindist"), the strongest ("maxforce"), or the sum of all as one contact in the world frame ("netforce")."""
  num_slots: int = 1
  """Contacts reported for each pair of a primary and a secondary; 1 with "netforce"."""
  track_air_time: bool = False
  """Keep the times in the air and in contact."""
  history_length: int | Literal["decimation"] = 0
  """Substeps of which the force is kept; "decimation" for those of one environment step, however many these are."""

  def validate(self) -> None:
    for field in self.fields:
      if field not in _WIDTHS:
        raise ValueError(unknown("field", field, _WIDTHS, self.label))
    if not self.fields and not self.track_air_time:
      raise ValueError(f"{self.label}: no field is asked for; there are {', '.join(_WIDTHS)}")
    if len(set(self.fields)) != len(self.fields):
      raise ValueError(f"{self.label}: a field is asked for twice in {self.fields}")
    if self.reduce not in get_args(ContactReduce):
      raise ValueError(unknown("reduce", self.reduce, get_args(ContactReduce), self.label))
    if wrong := why_no_count(self.num_slots, 1):
      raise ValueError(f"{self.label}: num_slots {wrong}")
    if self.reduce == "netforce" and self.num_slots != 1:
      raise ValueError(f"{self.label}: netforce is one sum of all contacts: num_slots must be 1, not {self.num_slots}")
    if self.history_length != "decimation" and why_no_count(self.history_length):
      raise ValueError(
        f"{self.label}: history_length must be a number of substeps or 'decimation', not {self.history_length!r}"
      )
    if self.history_length and "force" not in self.fields:
      raise ValueError(f"{self.label}: history_length keeps the force: add 'force' to fields {self.fields}")

  def _make(self, name: str) -> ContactSensor:
    return ContactSensor(name, self)


@dataclass(kw_only=True)
class ContactData:
  """Contacts of the substep just done; all zero in worlds just reset. Views of the sensor's memory, not to be written.

  A contact is one slot of one pair of a primary and a secondary. They are numbered primary by primary as in
  `ContactSensor.primary_names`, of each secondary by secondary as in `secondary_names`, of each slot by slot:
  `force.unflatten(1, sensor.contact_shape)` is (num_envs, num_primaries, num_secondaries, num_slots, 3), and
  num_contacts the product of these three. Slots are filled from the first on and empty ones are zero. Contacts within a
  geom's margin or gap count, with zero force. What was not asked for is None.
  """

  found: torch.Tensor | None = None
  """How many contacts the pair has, in each of its filled slots; 0 in an empty one, (num_envs, num_contacts)."""
  force: torch.Tensor | None = None
  """Force, (num_envs, num_contacts, 3) [N]. "netforce": what the primary exerts on the secondary, world frame. Else in
  the frame of the contact: first along the normal, where pressing is positive, then along the two tangents."""
  torque: torch.Tensor | None = None
  """Torque at the contact point, in the frame of `force`, (num_envs, num_contacts, 3) [Nm]."""
  dist: torch.Tensor | None = None
  """Distance between the surfaces, negative in penetration, (num_envs, num_contacts) [m]."""
  pos: torch.Tensor | None = None
  """Contact point, world frame, (num_envs, num_contacts, 3) [m]."""
  normal: torch.Tensor | None = None
  """Unit normal from primary to secondary, world frame, (num_envs, num_contacts, 3)."""
  tangent: torch.Tensor | None = None
  """First unit tangent, world frame; the second is normal x tangent, (num_envs, num_contacts, 3)."""
  current_air_time: torch.Tensor | None = None
  """How long the primary has been in the air, 0 in contact with any secondary, (num_envs, num_primaries) [s]."""
  last_air_time: torch.Tensor | None = None
  """Length of the air phase that the last landing ended, 0 before one since the reset, (num_envs, num_primaries)
  [s]."""
  current_contact_time: torch.Tensor | None = None
  """How long the primary has been in contact, 0 in the air, (num_envs, num_primaries) [s]."""
  last_contact_time: torch.Tensor | None = None
  """Length of the contact phase that the last take-off ended, 0 before one since the reset, (num_envs, num_primaries)
  [s]."""
  force_history: torch.Tensor | None = None
  """Force of the last substeps, newest first, zero for those before the reset,
  (num_envs, num_contacts, history_length, 3) [N]."""


class ContactSensor(Sensor[ContactData]):
  """Contacts of several primaries with anything, or with each of several secondaries.

  Each pair is one native MuJoCo contact sensor with all fields, and these lie side by side in sensordata, so that the
  whole reading is one view of it. Times and history are kept in `update`, once a substep.

  A phase of contact or air lasts from the substep at which it is first seen; the substep of a landing is counted in
  both the air time that ends and the contact time that begins. The phase that a world is reset into begins at the
  reset: a foot that starts on the ground has not landed, and no air time is credited to it.
  """

  _constants = frozenset({"_touch", "_force", "_current", "_last", "_history", "_older", "_phases"})
  cfg: ContactSensorCfg

  def __init__(self, name: str, cfg: ContactSensorCfg) -> None:
    super().__init__(name, cfg)
    self.primary_names: tuple[str, ...] = ()
    self.secondary_names: tuple[str, ...] = ()
    """Full names of the secondaries; none where anything counts."""
    self.history_length = 0
    """Substeps of which the force is kept."""
    self._fields = [field for field in _WIDTHS if field in cfg.fields or (field == "found" and cfg.track_air_time)]
    # MuJoCo evaluates a contact sensor without forces before the step's forces, of the next state. All are to
    # describe the same substep, so force is always among the columns.
    self._columns = [field for field in _WIDTHS if field in self._fields or field == "force"]
    self._views = ContactData()

  @property
  def num_primaries(self) -> int:
    """Number of elements whose contacts are reported."""
    return len(self.primary_names)

  @property
  def contact_shape(self) -> tuple[int, int, int]:
    """How contacts are numbered: (num_primaries, num_secondaries, num_slots); one secondary where anything counts."""
    return self.num_primaries, max(1, len(self.secondary_names)), self.cfg.num_slots

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    cfg = self.cfg
    if cfg.history_length != "decimation":
      self.history_length = cfg.history_length
    elif self.decimation is None:
      raise ValueError(
        f"{self.label}: history_length='decimation' follows an environment, and there is none; give a number"
      )
    else:
      self.history_length = self.decimation
    self.primary_names = tuple(cfg.primary.resolve(spec, entities, f"{self.label}: primary"))
    if cfg.secondary is not None:
      self.secondary_names = tuple(cfg.secondary.resolve(spec, entities, f"{self.label}: secondary"))
    taken = set(names_of(spec, "sensor"))
    content = sum(1 << list(_WIDTHS).index(field) for field in self._columns)
    for name, primary, secondary in self._natives():
      if name in taken:
        raise ValueError(f"{self.label}: the scene already has a sensor element {name!r}")
      sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_CONTACT)
      sensor.objtype, sensor.objname = _OBJECTS[cfg.primary.mode], primary
      if cfg.secondary is not None and secondary is not None:
        sensor.reftype, sensor.refname = _OBJECTS[cfg.secondary.mode], secondary
      sensor.intprm[:3] = [content, get_args(ContactReduce).index(cfg.reduce), cfg.num_slots]

  def _natives(self) -> list[tuple[str, str, str | None]]:
    """Native sensors in the order of the contacts: their name, the primary and the secondary."""
    if not self.secondary_names:
      return [(f"{self.name}:{primary}", primary, None) for primary in self.primary_names]
    pairs = product(self.primary_names, self.secondary_names)
    return [(f"{self.name}:{primary}:{secondary}", primary, secondary) for primary, secondary in pairs]

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    cfg, num_envs, num_primaries = self.cfg, sim.num_envs, self.num_primaries
    num_contacts = prod(self.contact_shape)
    blocks = [sensordata_columns(sim, name, self.label) for name, *_ in self._natives()]
    if any(left.stop != right.start for left, right in pairwise(blocks)):
      raise ValueError(f"{self.label}: its native sensors no longer lie side by side; was the spec reordered?")
    slots = sim.data.sensordata[:, blocks[0].start : blocks[-1].stop].unflatten(1, (num_contacts, -1))
    columns, start = {}, 0
    for field in self._columns:
      columns[field] = slots[..., start] if _WIDTHS[field] == 1 else slots[..., start : start + 3]
      start += _WIDTHS[field]
    views = ContactData(**{field: columns[field] for field in self._fields})
    self._slots = columns

    # One block of memory, so that a reset is one write: air and contact times, now and last, then the forces.
    times = 4 * num_primaries if cfg.track_air_time else 0
    size = times + 3 * num_contacts * self.history_length
    self._memory = torch.zeros(num_envs, size, dtype=sim.dtype, device=sim.device)
    self._phases = torch.tensor([[[True], [False]]], device=sim.device)
    if cfg.track_air_time:
      # Slots are filled from the first on, so the first one tells.
      self._touch = columns["found"].unflatten(1, self.contact_shape)[..., 0]
      self._current, self._last = self._memory[:, :times].view(num_envs, 2, 2, num_primaries).unbind(1)
      views.current_air_time, views.current_contact_time = self._current.unbind(1)
      views.last_air_time, views.last_contact_time = self._last.unbind(1)
    if self.history_length:
      self._force = columns["force"][:, :, None]
      self._history = self._memory[:, times:].view(num_envs, num_contacts, self.history_length, 3)
      self._older = self._history[:, :, :-1]
      views.force_history = self._history
    self._views = views

  def update(self, dt: float) -> None:
    if not self._memory.shape[1]:
      return
    # Reading the epoch makes the sensordata current, whatever the engine still owes.
    _ = self.sim.epoch
    if self.cfg.track_air_time:
      # Dimension 1 is the phase: 0 air, 1 contact.
      touch = self._touch.amax(-1) if len(self.secondary_names) > 1 else self._touch[..., 0]
      inside = (touch[:, None] > 0) != self._phases
      longer = self._current + dt
      # A time is zero while its phase is not on, and both are right after a reset, when no phase can end.
      ended = (self._current > 0) > inside
      torch.where(ended, longer, self._last, out=self._last)
      torch.mul(longer, inside, out=self._current)
    if self.history_length:
      self._history.copy_(torch.cat((self._force, self._older), dim=2))

  def reset(self, mask: torch.Tensor) -> None:
    if self._memory.shape[1]:
      fill_(self._memory, mask, 0.0)

  def debug_draw(self, draw: DebugDraw) -> None:
    """Show each contact as a sphere, where `pos` tells or at its primary, and the force on the primary as an arrow.

    The direction of a force is known of "netforce", and where normal and tangent are asked for.
    """
    sim, worlds = self.sim, list(draw.worlds)
    _ = sim.epoch
    slots = {field: column[worlds] for field, column in self._slots.items()}
    force = slots["force"]
    if "pos" in slots:
      place = slots["pos"]
    else:
      kind = "geom" if self.cfg.primary.mode == "geom" else "body"
      index = [getattr(sim.mj_model, kind)(name).id for name in self.primary_names]
      place = (sim.data.geom_xpos if kind == "geom" else sim.data.xpos)[worlds][:, index]
      place = place.repeat_interleave(force.shape[1] // len(index), dim=1)
    touches = slots["found"] > 0 if "found" in slots else (force != 0.0).any(-1)
    draw.spheres(place[touches], 0.5 * self._draw_size, (0.9, 0.2, 0.1, 1.0))
    if self.cfg.reduce != "netforce":
      if not {"normal", "tangent"} <= slots.keys():
        return
      normal, tangent = slots["normal"], slots["tangent"]
      axes = torch.stack((normal, tangent, torch.linalg.cross(normal, tangent)), dim=-1)
      force = (axes * force[..., None, :]).sum(-1)
    # What is read acts on the secondary. It is as long as MuJoCo's own viewer draws it.
    tip = place - force * (sim.mj_model.vis.map.force / sim.mj_model.stat.meanmass)
    draw.arrows(place[touches], tip[touches], (0.9, 0.6, 0.1, 1.0), 0.2 * self._draw_size)

  def compute_first_contact(self, dt: float, tol: float = 1e-6) -> torch.Tensor:
    """Which primaries have landed within the last `dt` [s] and are in contact, (num_envs, num_primaries) bool.

    A primary that has been in contact since the reset has not landed.

    Raises:
      ValueError: the sensor does not track air time.
    """
    return self._just_begun(1, dt + tol)

  def compute_first_air(self, dt: float, tol: float = 1e-6) -> torch.Tensor:
    """Which primaries have taken off within the last `dt` [s] and are in the air, (num_envs, num_primaries) bool.

    A primary that has been in the air since the reset has not taken off.

    Raises:
      ValueError: the sensor does not track air time.
    """
    return self._just_begun(0, dt + tol)

  def _just_begun(self, phase: int, within: float) -> torch.Tensor:
    if not self.cfg.track_air_time:
      raise ValueError(f"{self.label}: landings and take-offs need track_air_time=True")
    time = self._current[:, phase]
    # A phase that began with a switch comes after one of the other kind; the first since the reset does not.
    return (time * self._last[:, 1 - phase] > 0) & (time < within)

  def _read(self) -> ContactData:
    return self._views
