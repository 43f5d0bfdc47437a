"""Contacts as shapes."""

from __future__ import annotations

import mujoco
import numpy as np
from mjlab_core import Contacts

from mjlab_viewer.drawing.draw_list import Shapes, turns_from_z


def embolden(model: mujoco.MjModel, of: mujoco.MjModel) -> None:
  """Make contact arrows red and three times as thick as those `of` a model; MuJoCo's are thin and pale."""
  model.vis.scale.forcewidth = 3.0 * of.vis.scale.forcewidth
  model.vis.rgba.contactforce[:] = (0.9, 0.15, 0.1, 1.0)


def contact_shapes(
  contacts: Contacts[np.ndarray], model: mujoco.MjModel, *, points: bool, forces: bool, split: bool = False
) -> list[Shapes]:
  """Return discs and arrows in MuJoCo's sizes and colors, which are settings of the model (`vis`, `stat`).

  An arrow is the force on the geom that can move; if both can, on the second one. With `split`, normal force and
  friction have an arrow each.
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
  """Return a mask of the geoms, -1 for a flex, whose bodies are welded to the world."""
  return (geom >= 0) & (model.body_weldid[model.geom_bodyid[geom]] == 0)
