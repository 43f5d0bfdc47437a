"""Check boxes of MuJoCo's groups, named by what is in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import mujoco
import numpy as np
import viser

from mjlab_viewer.browser.inputs import Inputs
from mjlab_viewer.browser.world.mjviser_scene import MujocoScene

_MOST_OWNERS = 3


class GroupControls:
  """Check box for each group of geoms, sites, joints, tendons and actuators that is not empty.

  Args:
    server: Server of the page.
    scene: Scene of the selected world.
  """

  def __init__(self, server: viser.ViserServer, scene: MujocoScene) -> None:
    self.inputs = Inputs(server)
    self._gui, model = server.gui, scene.mj_model
    geoms, sites = list(scene.geom_groups_visible), list(scene.site_groups_visible)

    def show(groups: list[bool], group: int, on: bool) -> None:
      groups[group] = on
      scene.show_groups(geoms, sites)

    self._add("Geoms", model.geom_group, geom_labels(model), geoms, partial(show, geoms))
    self._add("Sites", model.site_group, site_labels(model), sites, partial(show, sites))
    for folder, groups in (
      ("Joints", model.jnt_group),
      ("Tendons", model.tendon_group),
      ("Actuators", model.actuator_group),
    ):
      shown = scene.overlay_groups(folder)
      if shown is not None:
        names = {int(group): f"group {group}" for group in np.unique(groups)}
        self._add(folder, groups, names, [bool(on) for on in shown], shown.__setitem__)

  def _add(
    self,
    folder: str,
    groups: np.ndarray,
    labels: dict[int, str],
    shown: Sequence[bool],
    show: Callable[[int, bool], Any],
  ) -> None:
    if not labels:
      return
    with self._gui.add_folder(folder):
      for group, label in labels.items():
        count = int((groups == group).sum())
        box = self._gui.add_checkbox(label, shown[group], hint=f"MuJoCo's group {group}, {count} {folder.lower()}")
        self.inputs.on_change(partial(getattr, box, "value"), lambda group=group, box=box: show(group, box.value))


def geom_labels(model: mujoco.MjModel) -> dict[int, str]:
  """Return for each group of geoms the names of the entities in it, and "collision" or "visual" if all of them are."""
  labels = _owners(model, model.geom_group, model.geom, model.geom_bodyid)
  collides = (model.geom_contype | model.geom_conaffinity).astype(bool)
  for group in labels:
    in_group = collides[model.geom_group == group]
    if in_group.all() or not in_group.any():
      labels[group] += ": collision" if in_group.all() else ": visual"
  return labels


def site_labels(model: mujoco.MjModel) -> dict[int, str]:
  """Return for each group of sites the names of the entities in it."""
  return _owners(model, model.site_group, model.site, model.site_bodyid)


def _owners(
  model: mujoco.MjModel, groups: np.ndarray, element: Callable[[int], Any], bodies: np.ndarray
) -> dict[int, str]:
  """Return for each group the entities of its elements: prefixes of names, or else the bodies at their roots."""
  labels = {}
  for group in np.unique(groups):
    owners: list[str] = []
    for number in np.flatnonzero(groups == group):
      name = element(int(number)).name
      root = model.body(int(model.body_rootid[bodies[number]])).name
      # An element of the world itself has only its name.
      owner = name if "/" in name or (name and root == "world") else root
      owners.append(owner.partition("/")[0])
    owners = list(dict.fromkeys(owners))
    labels[int(group)] = ", ".join(owners[:_MOST_OWNERS]) + (" ..." if len(owners) > _MOST_OWNERS else "")
  return labels
