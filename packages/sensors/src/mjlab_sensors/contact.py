"""Contact sensor: contacts of parts of an entity, their forces, and their durations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import prod
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import mujoco
import torch
from mjlab_core import Count, DebugDraw, Items, MjlabError, PositiveCount, fill_

from mjlab_sensors.native._elements import ElementMatch, add_sensor
from mjlab_sensors.sensor import Sensor, SensorCfg, sensordata_columns

if TYPE_CHECKING:
  from mjlab_sim import Simulation

ContactMode = Literal["geom", "body", "subtree"]
ContactField = Literal["found", "force", "torque", "dist", "pos", "normal", "tangent"]
ContactReduce = Literal["none", "mindist", "maxforce", "netforce"]

# In the order in which MuJoCo lays them out within a slot, with their widths.
_WIDTHS = {"found": 1, "force": 3, "torque": 3, "dist": 1, "pos": 3, "normal": 3, "tangent": 3}
_OBJECTS = {
  "geom": mujoco.mjtObj.mjOBJ_GEOM,
  "body": mujoco.mjtObj.mjOBJ_BODY,
  # MuJoCo's integer code for a subtree; the object is its root body.
  "subtree": mujoco.mjtObj.mjOBJ_XBODY,
}


@dataclass(kw_only=True, frozen=True)
class ContactMatch(ElementMatch):
  """Parts of the scene that take part in contacts, by patterns."""

  mode: ContactMode
  """Kind of element that the patterns name: single geoms, bodies with all their geoms, or bodies with all their
  descendants."""


@dataclass(kw_only=True)
class ContactSensorCfg(SensorCfg):
  """Contacts of each primary with each secondary."""

  primary: ContactMatch
  """Elements with reported contacts, each separately."""
  secondary: ContactMatch | None = None
  """Elements that they touch, each separately; None for all elements together. A subtree may be its own secondary."""
  fields: Annotated[tuple[ContactField, ...], Items(ge=0, unique=True)] = ("found", "force")
  """Fields of the reading. `track_air_time` adds "found"."""
  reduce: ContactReduce = "maxforce"
  """Contacts that fill the slots of a pair: the first of MuJoCo's list ("none", an arbitrary order), the deepest
  ("mindist"), the strongest ("maxforce"), or the sum of all as one contact in the world frame ("netforce")."""
  num_slots: PositiveCount = 1
  """Contacts reported for each pair of a primary and a secondary; 1 with "netforce"."""
  global_frame: bool = False
  """Report force and torque in the world frame, on the secondary, instead of in the frame of each contact."""
  track_air_time: bool = False
  """Measure the times in the air and in contact."""
  history_length: Count | Literal["decimation"] = 0
  """Number of past substeps in the force history; "decimation" for the substeps of one environment step."""

  def problems(self) -> Iterator[str]:
    if not self.fields and not self.track_air_time:
      yield f"fields is empty; choose from {', '.join(_WIDTHS)}"
    if self.reduce == "netforce" and self.num_slots != 1:
      yield f"netforce is one sum of all contacts: num_slots must be 1, got {self.num_slots}"
    if self.history_length and "force" not in self.fields:
      yield f"history_length keeps the force; add 'force' to fields {self.fields}"


@dataclass(kw_only=True)
class ContactData:
  """Contacts of the substep just done; all zero in worlds just reset. Views of the sensor's memory, not to be written.

  A contact is one slot of one pair of a primary and a secondary. Contacts are numbered by primary as in
  `ContactSensor.primary_names`, then by secondary as in `secondary_names`, then by slot:
  `force.unflatten(1, sensor.contact_shape)` is (num_envs, num_primaries, num_secondaries, num_slots, 3), and
  num_contacts is the product of these three. Slots are filled from the first on; empty ones are zero. Contacts within a
  geom's margin or gap count, with zero force. Fields that are not in the config are None.
  """

  found: torch.Tensor | None = None
  """Number of contacts of the pair, in each of its filled slots; 0 in an empty one, (num_envs, num_contacts)."""
  force: torch.Tensor | None = None
  """Force, (num_envs, num_contacts, 3) [N]. "netforce" or `global_frame`: of the primary on the secondary, world frame.
  Otherwise in the frame of the contact: first along the normal, where pressing is positive, then along the tangents."""
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
  """Time in the air so far, 0 in contact with any secondary, (num_envs, num_primaries) [s]."""
  last_air_time: torch.Tensor | None = None
  """Length of the air phase before the last landing, 0 without a landing since the reset, (num_envs, num_primaries)
  [s]."""
  current_contact_time: torch.Tensor | None = None
  """Time in contact so far, 0 in the air, (num_envs, num_primaries) [s]."""
  last_contact_time: torch.Tensor | None = None
  """Length of the contact phase before the last take-off, 0 without one since the reset, (num_envs, num_primaries)
  [s]."""
  force_history: torch.Tensor | None = None
  """Force of the last substeps, newest first, zero before the reset,
  (num_envs, num_contacts, history_length, 3) [N]."""


class ContactSensor(Sensor[ContactData], cfg=ContactSensorCfg):
  """Contacts of several primaries with all other elements, or with each of several secondaries.

  Each pair is one native MuJoCo contact sensor with all fields, and these lie side by side in sensordata, so that the
  whole reading is one view of it. Times and history are kept in `update`, once a substep.

  A phase of contact or air lasts from the substep at which it is first seen; the substep of a landing is counted in
  both the air time that ends and the contact time that begins. The phase that a world is reset into begins at the
  reset: a foot that starts on the ground has not landed and has no air time.
  """

  cfg: ContactSensorCfg

  def __init__(self, cfg: ContactSensorCfg) -> None:
    super().__init__(cfg)
    self.primary_names: tuple[str, ...] = ()
    self.secondary_names: tuple[str, ...] = ()
    """Full names of the secondaries; empty if all elements count."""
    self.history_length = 0
    """Number of past substeps in the force history."""
    self._fields = {*cfg.fields, *(["found"] if cfg.track_air_time else [])}
    # The sum of all contacts is in the world frame already.
    self._is_turned = cfg.global_frame and cfg.reduce != "netforce"
    # MuJoCo evaluates a contact sensor without forces before the step's forces, of the next state. All are to
    # describe the same substep, so force is always among the columns.
    needed = self._fields | {"force"} | ({"normal", "tangent"} if self._is_turned else set())
    self._columns = [field for field in _WIDTHS if field in needed]

  @property
  def contact_shape(self) -> tuple[int, int, int]:
    """Numbering of contacts: (num_primaries, num_secondaries, num_slots); one secondary if all elements count."""
    return len(self.primary_names), max(1, len(self.secondary_names)), self.cfg.num_slots

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    cfg = self.cfg
    history_length = self.decimation if cfg.history_length == "decimation" else cfg.history_length
    if history_length is None:
      raise MjlabError(f"{self.label}: history_length='decimation' needs an environment; give a number without one")
    self.history_length = history_length
    self.primary_names = cfg.primary.names_in(spec, entities, cfg.primary.mode, f"{self.label}: primary")
    if cfg.secondary is not None:
      self.secondary_names = cfg.secondary.names_in(spec, entities, cfg.secondary.mode, f"{self.label}: secondary")
    content = sum(1 << list(_WIDTHS).index(field) for field in self._columns)
    for name, primary, secondary in self._natives():
      sensor = add_sensor(spec, self.label, name, type=mujoco.mjtSensor.mjSENS_CONTACT)
      sensor.objtype, sensor.objname = _OBJECTS[cfg.primary.mode], primary
      if cfg.secondary is not None:
        sensor.reftype, sensor.refname = _OBJECTS[cfg.secondary.mode], secondary
      sensor.intprm[:3] = [content, get_args(ContactReduce).index(cfg.reduce), cfg.num_slots]

  def _natives(self) -> list[tuple[str, str, str]]:
    """Return the native sensors in the order of the contacts: their name, the primary and the secondary, "" for all."""
    pairs = product(self.primary_names, self.secondary_names or ("",))
    return [(":".join(filter(None, (self.name, *pair))), *pair) for pair in pairs]

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    cfg, num_envs, num_primaries = self.cfg, sim.num_envs, len(self.primary_names)
    num_contacts = prod(self.contact_shape)
    blocks = [sensordata_columns(sim, name) for name, *_ in self._natives()]
    slots = sim.data.sensordata[:, blocks[0].start : blocks[-1].stop].unflatten(1, (num_contacts, -1))
    parts = slots.split([_WIDTHS[field] for field in self._columns], dim=-1)
    self._slots = {field: part.squeeze(-1) for field, part in zip(self._columns, parts, strict=True)}
    self._views = views = ContactData(**{field: self._slots[field] for field in self._fields})

    # One block of memory, so that a reset is one write: air and contact times, now and last, then the forces.
    times = 4 * num_primaries if cfg.track_air_time else 0
    size = times + 3 * num_contacts * self.history_length
    self._memory = self.state((size,), dtype=sim.dtype)
    self._phases = torch.tensor([[[True], [False]]], device=sim.device)
    if cfg.track_air_time:
      # Slots are filled from the first on, so the first one decides.
      self._touch = self._slots["found"].unflatten(1, self.contact_shape)[..., 0]
      self._current, self._last = self._memory[:, :times].view(num_envs, 2, 2, num_primaries).unbind(1)
      views.current_air_time, views.current_contact_time = self._current.unbind(1)
      views.last_air_time, views.last_contact_time = self._last.unbind(1)
    if self.history_length:
      self._history = self._memory[:, times:].view(num_envs, num_contacts, self.history_length, 3)
      self._older = self._history[:, :, :-1]
      views.force_history = self._history

  def update(self, dt: float) -> None:
    if not self._memory.shape[1]:
      return
    # Reading the version makes the sensordata current.
    _ = self.sim.version
    if self.cfg.track_air_time:
      # Dimension 1 is the phase: 0 air, 1 contact.
      touch = self._touch.amax(-1) if len(self.secondary_names) > 1 else self._touch[..., 0]
      inside = (touch[:, None] > 0) != self._phases
      longer = self._current + dt
      # A time is zero outside its phase. Both are zero right after a reset, when no phase can end.
      ended = (self._current > 0) > inside
      torch.where(ended, longer, self._last, out=self._last)
      torch.mul(longer, inside, out=self._current)
    if self.history_length:
      self._history.copy_(torch.cat((self._turned("force")[:, :, None], self._older), dim=2))

  def reset(self, mask: torch.Tensor) -> None:
    if self._memory.shape[1]:
      fill_(self._memory, mask, 0.0)

  def debug_draw(self, draw: DebugDraw) -> None:
    """Draw each contact as a sphere, at `pos` or at its primary, and the force on the primary as an arrow.

    Arrows need "netforce", or the fields normal and tangent.
    """
    sim, worlds = self.sim, list(draw.worlds)
    _ = sim.version
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
      force = _in_world(force, slots["normal"], slots["tangent"])
    # The reading acts on the secondary. The arrow is as long as in MuJoCo's own viewer.
    tip = place - force * (sim.mj_model.vis.map.force / sim.mj_model.stat.meanmass)
    draw.arrows(place[touches], tip[touches], (0.9, 0.6, 0.1, 1.0), 0.2 * self._draw_size)

  def compute_first_contact(self, dt: float, tol: float = 1e-6) -> torch.Tensor:
    """Return the primaries that landed within the last `dt` [s] and are in contact, (num_envs, num_primaries) bool.

    A primary that has been in contact since the reset has not landed.

    Raises:
      MjlabError: the sensor does not track air time.
    """
    return self._just_begun(1, dt + tol)

  def compute_first_air(self, dt: float, tol: float = 1e-6) -> torch.Tensor:
    """Return the primaries that took off within the last `dt` [s] and are in the air, (num_envs, num_primaries) bool.

    A primary that has been in the air since the reset has not taken off.

    Raises:
      MjlabError: the sensor does not track air time.
    """
    return self._just_begun(0, dt + tol)

  def _just_begun(self, phase: int, within: float) -> torch.Tensor:
    if not self.cfg.track_air_time:
      raise MjlabError(f"{self.label}: landings and take-offs need track_air_time=True")
    time = self._current[:, phase]
    # A phase that began with a switch comes after one of the other kind; the first since the reset does not.
    return (time * self._last[:, 1 - phase] > 0) & (time < within)

  def _turned(self, field: str) -> torch.Tensor:
    """Return force or torque, in the world frame if the config asks for it, (num_envs, num_contacts, 3)."""
    vector = self._slots[field]
    return _in_world(vector, self._slots["normal"], self._slots["tangent"]) if self._is_turned else vector

  def _read(self) -> ContactData:
    if not self._is_turned:
      return self._views
    turned = {field: self._turned(field) for field in ("force", "torque") if field in self._fields}
    return replace(self._views, **turned)


def _in_world(vector: torch.Tensor, normal: torch.Tensor, tangent: torch.Tensor) -> torch.Tensor:
  """Return vectors of contact frames in the world frame, (..., 3); zero where there is no contact."""
  axes = torch.stack((normal, tangent, torch.linalg.cross(normal, tangent)), dim=-1)
  return (axes * vector[..., None, :]).sum(-1)
