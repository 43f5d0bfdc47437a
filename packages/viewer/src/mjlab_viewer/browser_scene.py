"""The three-dimensional part of the page."""

from __future__ import annotations

import mujoco
import numpy as np
import viser
import viser.transforms
from mjviser import ViserMujocoScene

from mjlab_viewer.browser_drawing import BrowserDrawing
from mjlab_viewer.camera import Camera
from mjlab_viewer.host_world import HostWorld, copy_world
from mjlab_viewer.snapshot import Snapshot


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
    self.scene = ViserMujocoScene(server, self._own.model, num_worlds)
    # mjviser follows the first body that moves; it has no public way to be told another one.
    self.scene._tracked_body_id = camera.body
    self.scene.camera_tracking_enabled = camera.body is not None
    self._drawing = BrowserDrawing(server, self._own.model)
    self.shown: Snapshot | None = None
    """What is shown."""
    server.initial_camera.fov = float(np.deg2rad(model.vis.global_.fovy))
    server.initial_camera.position = tuple(self._eye())
    server.initial_camera.look_at = tuple(self._target())

  def show(self, snapshot: Snapshot) -> None:
    """Show these worlds; overlays (contacts, forces, frames) are those of the first one."""
    data, scene = snapshot.data, self.scene
    # Contacts and forces follow from the very state and model of the selected world.
    copy_world(snapshot, 0, self._own.model, scene.mj_data)
    count = len(snapshot.worlds)
    matrices = viser.transforms.SO3(data["xquat"].reshape(-1, 4)).as_matrix().reshape(count, -1, 3, 3)
    scene.update_from_arrays(
      data["xpos"],
      matrices,
      data.get("mocap_pos"),
      data.get("mocap_quat"),
      env_idx=0,
      qpos=data["qpos"] if "qpos" in data else np.zeros((count, 0)),
      qvel=data["qvel"] if "qvel" in data else np.zeros((count, 0)),
      ctrl=data.get("ctrl"),
    )
    for drawing in snapshot.drawings:
      self._drawing.show(drawing, scene.fixed_bodies_frame.position)
    self.shown = snapshot

  def follow(self, on: bool) -> None:
    """Keep the robot in the middle, or leave the eye where it is."""
    self.scene.camera_tracking_enabled = on and self._camera.body is not None

  def look(self, client: viser.ClientHandle) -> None:
    """Put a client's eye back to where it began."""
    client.camera.position = self._eye()
    client.camera.look_at = self._target()

  def _target(self) -> np.ndarray:
    if self.scene.camera_tracking_enabled:
      return np.zeros(3)
    return self._camera.target(self._own.data.xpos if self.shown is None else self.shown.data["xpos"][0])

  def _eye(self) -> np.ndarray:
    return self._target() + self._camera.offset
