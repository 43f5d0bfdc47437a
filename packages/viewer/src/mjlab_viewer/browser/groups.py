"""Check boxes of MuJoCo's groups, named by what is in them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import mujoco
import numpy as np
import viser

from mjlab_viewer.browser.inputs import Inputs
from mjlab_viewer.browser.mjviser_scene import MujocoScene

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
  """Return for each group of geoms the names of the entities in it, and whether these geoms collide."""
  labels = {}
  for group, names, bodies in _members(model.geom_group, model.geom, model.geom_bodyid):
    collide = (model.geom_contype | model.geom_conaffinity)[model.geom_group == group].astype(bool)
    kind = "collision" if collide.all() else "" if collide.any() else "visual"
    labels[group] = _label(_owners(model, names, bodies), kind)
  return labels


def site_labels(model: mujoco.MjModel) -> dict[int, str]:
  """Return for each group of sites the names of the entities in it."""
  groups = _members(model.site_group, model.site, model.site_bodyid)
  return {group: _label(_owners(model, names, bodies)) for group, names, bodies in groups}


def _members(
  groups: np.ndarray, element: Callable[[int], Any], bodies: np.ndarray
) -> Iterator[tuple[int, list[str], np.ndarray]]:
  """Yield each group with the names and bodies of its elements."""
  for group in np.unique(groups):
    found = np.flatnonzero(groups == group)
    yield int(group), [element(int(i)).name for i in found], bodies[found]


def _owners(model: mujoco.MjModel, names: Sequence[str], bodies: np.ndarray) -> list[str]:
  """Return the entities of elements, without repetition: prefixes of names, or else the bodies at their roots."""
  owners = []
  for name, body in zip(names, bodies, strict=True):
    root = model.body(int(model.body_rootid[body])).name
    prefix = (name if "/" in name else root).partition("/")[0]
    owners.append(name or prefix if root == "world" and "/" not in name else prefix)
  return list(dict.fromkeys(owners))


def _label(owners: Sequence[str], kind: str = "") -> str:
  shown = ", ".join(owners[:_MOST_OWNERS]) + (" ..." if len(owners) > _MOST_OWNERS else "")
  return f"{shown}: {kind}" if kind else shown
