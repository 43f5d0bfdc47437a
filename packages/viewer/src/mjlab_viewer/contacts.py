"""Where bodies touch and how hard, as shapes."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjlab_viewer.draw_list import Shapes, turns_from_z


@dataclass(kw_only=True)
class HostContacts:
  """Contacts of one world."""

  geom: np.ndarray
  """The two geoms, -1 for a flex, (n, 2)."""
  pos: np.ndarray
  """World frame, (n, 3) [m]."""
  normal: np.ndarray
  """Unit normal from the first geom to the second, world frame, (n, 3)."""
  force: np.ndarray
  """What the first geom exerts on the second, world frame, (n, 3) [N]."""


def computed_contacts(model: mujoco.MjModel, data: mujoco.MjData) -> HostContacts:
  """Contacts that MuJoCo C computed, but for those that are only near."""
  contact, wrench = data.contact, np.zeros(6)
  pushing = np.flatnonzero(contact.efc_address >= 0)
  frames = contact.frame[pushing].reshape(-1, 3, 3)
  force = np.zeros((len(pushing), 3))
  for row, (number, frame) in enumerate(zip(pushing, frames, strict=True)):
    mujoco.mj_contactForce(model, data, number, wrench)
    force[row] = wrench[:3] @ frame
  return HostContacts(geom=contact.geom[pushing], pos=contact.pos[pushing], normal=frames[:, 0], force=force)


def embolden(model: mujoco.MjModel, of: mujoco.MjModel) -> None:
  """Make arrows red and thrice as thick as those `of` a model: MuJoCo's own are thin as a needle, pale as the floor."""
  model.vis.scale.forcewidth = 3.0 * of.vis.scale.forcewidth
  model.vis.rgba.contactforce[:] = (0.9, 0.15, 0.1, 1.0)


def contact_shapes(
  contacts: HostContacts, model: mujoco.MjModel, *, points: bool, forces: bool, split: bool = False
) -> list[Shapes]:
  """Discs and arrows in MuJoCo's sizes and colours, which are settings of the model (`vis`, `stat`).

  An arrow is the force on what can move; where both can, on the second geom. Split there are two, of its part along
  the normal and of friction.
  """
  count, size, scale, colors = len(contacts.pos), model.stat.meansize, model.vis.scale, model.vis.rgba
  shapes = []
  if points:
    half = size * np.array([scale.contactwidth, scale.contactwidth, scale.contactheight])
    shapes.append(
      Shapes(
        "ellipsoid",
        contacts.pos,
        turns_from_z(contacts.normal),
        np.tile(half, (count, 1)),
        np.tile(colors.contactpoint, (count, 1)),
      )
    )
  if forces:
    on_first = _is_fixed(model, contacts.geom[:, 1]) & ~_is_fixed(model, contacts.geom[:, 0])
    length = model.vis.map.force / model.stat.meanmass * np.where(on_first, -1.0, 1.0)
    radius = np.full((count, 1), size * scale.forcewidth)
    parts = [(contacts.force, colors.contactforce)]
    if split:
      along = (contacts.force * contacts.normal).sum(axis=1, keepdims=True) * contacts.normal
      parts = [(along, colors.contactforce), (contacts.force - along, colors.contactfriction)]
    for force, color in parts:
      shapes.append(Shapes("arrow", contacts.pos, length[:, None] * force, radius, np.tile(color, (count, 1))))
  return [part for part in shapes if len(part)]


def _is_fixed(model: mujoco.MjModel, geom: np.ndarray) -> np.ndarray:
  """Which geoms, -1 for a flex, are of bodies that are welded to the world."""
  return (geom >= 0) & (model.body_weldid[model.geom_bodyid[geom]] == 0)
