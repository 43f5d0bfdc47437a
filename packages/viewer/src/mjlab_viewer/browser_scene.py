"""The three-dimensional part of the page."""

from __future__ import annotations

import mujoco
import numpy as np
import viser
import viser.transforms
from mjviser import ViserMujocoScene

from mjlab_viewer.browser_drawing import BrowserDrawing
from mjlab_viewer.browser_looks import Wardrobe, look
from mjlab_viewer.camera import Camera
from mjlab_viewer.contacts import contact_shapes, embolden
from mjlab_viewer.draw_list import Shapes
from mjlab_viewer.host_world import HostWorld, copy_world
from mjlab_viewer.snapshot import Snapshot


class _Scene(ViserMujocoScene):
  """mjviser's scene without the contacts that it computes itself; those of the simulation are drawn instead."""

  def _update_decor_from_mjvscene(self, mj_data: mujoco.MjData, scene_offset: np.ndarray) -> None:
    mj_data.ncon = 0
    super()._update_decor_from_mjvscene(mj_data, scene_offset)


class BrowserScene:
  """Shows snapshots with mjviser, which gets a model of its own: it writes to it.

  Args:
    server: Where.
    model: The simulation's model; copied.
    camera: What the eye follows, and from where it begins.
    num_worlds: Worlds shown at first.
  """

  def __init__(self, server: viser.ViserServer, model: mujoco.MjModel, camera: Camera, num_worlds: int) -> None:
    self._own = HostWorld(model)
    self._camera = camera
    self.scene = _Scene(server, self._own.model, num_worlds)
    embolden(self._own.model, of=model)
    # Else every change of an overlay would be drawn at once by the thread that got it, from data that is being written.
    self.scene.set_refresh_handler(lambda: None)
    # mjviser follows the first body that moves; it has no public way to be told another one.
    self.scene._tracked_body_id = camera.body
    self.scene.camera_tracking_enabled = camera.body is not None
    self._drawing = BrowserDrawing(server, self._own.model)
    self.wardrobe = Wardrobe(server, model)
    self._look = b""
    mujoco.mj_kinematics(self._own.model, self._own.data)
    self._rest = self._own.data.xpos.copy(), self._own.data.xquat.copy()
    self._finite: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    self.is_finite = True
    """Whether the selected world is shown as it is, not as it was before it diverged."""
    self.shown: Snapshot | None = None
    """What is shown."""
    server.initial_camera.fov = float(np.deg2rad(model.vis.global_.fovy))
    server.initial_camera.position = tuple(self._eye())
    server.initial_camera.look_at = tuple(self._target())

  def show(self, snapshot: Snapshot) -> None:
    """Show these worlds; overlays (contacts, forces, frames) are those of the first one."""
    data, scene = snapshot.data, self.scene
    # Overlays follow from the very state and model of the selected world.
    copy_world(snapshot, 0, self._own.model, scene.mj_data)
    looks = [look(snapshot, row) for row in range(len(snapshot.worlds))]
    if looks[0] != self._look:
      self._look = looks[0]
      scene.rebuild_visual_handles()
    alike = [row for row, its_look in enumerate(looks) if its_look == looks[0]]
    self.is_finite = snapshot.is_finite()
    poses = _poses(data, *self._places(snapshot))
    scene.update_from_arrays(
      **{name: values[alike] for name, values in poses.items()},
      env_idx=0,
      # Of the selected world, for overlays.
      qpos=data.get("qpos", np.zeros((1, 0))) if self.is_finite else None,
      qvel=data.get("qvel", np.zeros((1, 0))),
      ctrl=data.get("ctrl"),
    )
    offset = np.asarray(scene.fixed_bodies_frame.position)
    different: dict[bytes, list[int]] = {}
    for row, its_look in enumerate(looks):
      if its_look != looks[0]:
        different.setdefault(its_look, []).append(row)
    moved = {name: values + offset if name.endswith("pos") else values for name, values in poses.items()}
    self.wardrobe.show(snapshot, different, moved, scene)
    drawn = [shapes for drawing in snapshot.drawings for shapes in drawing.shapes]
    self._drawing.show(drawn + self._contacts(snapshot), offset)
    self.shown = snapshot

  def follow(self, on: bool) -> None:
    """Keep the robot in the middle, or leave the eye where it is."""
    self.scene.camera_tracking_enabled = on and self._camera.body is not None

  def look(self, client: viser.ClientHandle) -> None:
    """Put a client's eye back to where it began."""
    client.camera.position = self._eye()
    client.camera.look_at = self._target()

  def _contacts(self, snapshot: Snapshot) -> list[Shapes]:
    """Of the selected world, in mjviser's colours and sizes."""
    points, forces = self.scene.show_contact_points, self.scene.show_contact_forces
    if not self.is_finite or not (points or forces):
      return []
    if not snapshot.contacts:
      self._own.load(snapshot)
    split = bool(self.scene._mjv_option.flags[mujoco.mjtVisFlag.mjVIS_CONTACTSPLIT])
    return contact_shapes(self._own.contacts(snapshot), self._own.model, points=points, forces=forces, split=split)

  def _places(self, snapshot: Snapshot) -> tuple[np.ndarray, np.ndarray]:
    """Positions and orientations of all bodies; of a world that diverged, the last that were any."""
    xpos, xquat = snapshot.data["xpos"].copy(), snapshot.data["xquat"].copy()
    for row, world in enumerate(snapshot.worlds):
      if snapshot.is_finite(row):
        self._finite[world] = xpos[row], xquat[row]
      else:
        xpos[row], xquat[row] = self._finite.get(world, self._rest)
    return xpos, xquat

  def _target(self) -> np.ndarray:
    if self.scene.camera_tracking_enabled:
      # mjviser keeps the body that is followed at the origin.
      return self._camera.target(np.zeros_like(self._rest[0]))
    places = self._rest if self.shown is None else self._finite.get(self.shown.worlds[0], self._rest)
    return self._camera.target(places[0])

  def _eye(self) -> np.ndarray:
    return self._target() + self._camera.offset


def _poses(data: dict[str, np.ndarray], xpos: np.ndarray, xquat: np.ndarray) -> dict[str, np.ndarray]:
  """Poses of all bodies as mjviser wants them, one row for each world."""
  matrices = viser.transforms.SO3(xquat.reshape(-1, 4)).as_matrix().reshape(*xquat.shape[:2], 3, 3)
  poses = {"body_xpos": xpos, "body_xmat": matrices}
  poses |= {name: data[name] for name in ("mocap_pos", "mocap_quat") if name in data}
  return poses
