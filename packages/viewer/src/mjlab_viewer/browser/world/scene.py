"""Three-dimensional part of the page."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any, cast

import mujoco
import numpy as np
import viser
import viser.transforms

from mjlab_viewer.browser.world.appearances import OtherAppearances, appearance_key
from mjlab_viewer.browser.world.mjviser_scene import MujocoScene, ServerUnder
from mjlab_viewer.browser.world.shapes import BatchedShapes
from mjlab_viewer.camera import Camera, first_moving_body
from mjlab_viewer.drawing.contacts import contact_shapes, embolden
from mjlab_viewer.drawing.draw_list import Shapes
from mjlab_viewer.snapshot import HostWorld, Snapshot, copy_world

_AMBIENT = 1.0
"""Intensity of the light from all sides; with viser's two lamps, the page is as bright as films are."""

_LAMP = 1.5
"""Intensity of each lamp without shadows: materials of models are metallic, and ambient light does not reach them."""

_LAMPS = ((30.0, 0.0, 20.0), (-30.0, 0.0, 20.0), (0.0, 30.0, 20.0), (0.0, -30.0, 20.0))
"""Places of these lamps [m]."""

_MARK = (0.96, 0.55, 0.0, 1.0)
"""Color of the arrow above the selected robot."""


@dataclass(kw_only=True)
class Selection:
  """Selected world, and number of worlds shown."""

  num_envs: int
  """Number of worlds."""
  most: int
  """Greatest number of worlds shown at once."""
  world: int = 0
  """World of the plots, drawings and contacts."""
  count: int = 0
  """Number of worlds shown."""

  def __post_init__(self) -> None:
    self.most = min(self.most, self.num_envs)
    self.count = self.most

  @property
  def worlds(self) -> tuple[int, ...]:
    """The selected world and those after it; world 0 follows the last."""
    return tuple((self.world + i) % self.num_envs for i in range(self.count))


class BrowserScene:
  """Scene of a snapshot on the page. mjviser writes to its model and therefore gets a copy.

  Args:
    server: Server of the page.
    model: The simulation's model; copied.
    camera: First camera, and the body that it follows.
    num_worlds: Number of worlds shown at first.
  """

  def __init__(self, server: viser.ViserServer, model: mujoco.MjModel, camera: Camera, num_worlds: int) -> None:
    self._own = HostWorld(model)
    self._camera = camera
    under: Any = ServerUnder(server, "")
    self.scene = MujocoScene(cast(viser.ViserServer, under), self._own.model, num_worlds)
    server.scene.configure_environment_map(hdri=None)
    server.scene.add_light_ambient("/light", intensity=_AMBIENT)
    for number, place in enumerate(_LAMPS):
      server.scene.add_light_point(f"/lamp{number}", intensity=_LAMP, decay=0.0, position=place)
    embolden(self._own.model, of=model)
    # Otherwise the thread that receives a change of an overlay draws it at once, from data that is being written.
    self.scene.set_refresh_handler(lambda: None)
    self.scene.track(camera.body)
    self._shapes = BatchedShapes(server, self._own.model)
    self._marks = BatchedShapes(server, self._own.model, "/mark")
    self.others = OtherAppearances(server, model)
    """Worlds that do not look like the selected one."""
    self._key = b""
    mujoco.mj_kinematics(self._own.model, self._own.data)
    self._rest = self._own.data.xpos.copy(), self._own.data.xquat.copy()
    self._finite: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    self.is_finite = True
    """False while the selected world has diverged and is shown as it was before."""
    self.shown: Snapshot | None = None
    """Snapshot that is shown."""
    server.initial_camera.fov = float(np.deg2rad(model.vis.global_.fovy))
    server.initial_camera.position = tuple(self._eye())
    server.initial_camera.look_at = tuple(self._target())

  def show(self, snapshot: Snapshot) -> None:
    """Show these worlds; overlays (contacts, forces, frames) are those of the first one."""
    data, scene = snapshot.data, self.scene
    # Overlays follow from the very state and model of the selected world.
    copy_world(snapshot, 0, self._own.model, scene.mj_data)
    rows: dict[bytes, list[int]] = defaultdict(list)
    for row in range(len(snapshot.worlds)):
      rows[appearance_key(snapshot, row)].append(row)
    key = next(iter(rows))
    alike = rows.pop(key)
    if key != self._key:
      self._key = key
      scene.rebuild_visual_handles()
    self.is_finite = snapshot.is_finite()
    poses = self._poses(snapshot)
    scene.update_from_arrays(
      **{name: values[alike] for name, values in poses.items()},
      env_idx=0,
      # Of the selected world, for overlays.
      qpos=data.get("qpos", np.zeros((1, 0))) if self.is_finite else None,
      qvel=data.get("qvel", np.zeros((1, 0))),
      ctrl=data.get("ctrl"),
    )
    offset = np.asarray(scene.fixed_bodies_frame.position)
    moved = {name: values + offset if name.endswith("pos") else values for name, values in poses.items()}
    self.others.show(snapshot, rows, moved, scene)
    drawn = [shapes for drawing in snapshot.drawings for shapes in drawing.shapes]
    self._shapes.show(drawn + self._contacts(snapshot), offset)
    self._marks.show(self._mark(poses["body_xpos"]), offset)
    self.shown = snapshot

  def follow(self, on: bool) -> None:
    """Keep the robot in the middle, or leave the camera where it is."""
    self.scene.camera_tracking_enabled = on and self._camera.body is not None

  def look(self, client: viser.ClientHandle) -> None:
    """Move the camera of a client back to its start."""
    client.camera.position = self._eye()
    client.camera.look_at = self._target()

  def _mark(self, xpos: np.ndarray) -> list[Shapes]:
    """Return an arrow that points down at the robot of the first world, if others are shown beside it."""
    body = self._camera.body or first_moving_body(self._own.model)
    if len(xpos) < 2 or not body:
      return []
    size = 0.06 * self._camera.distance
    start = xpos[0, body] + np.array([0.0, 0.0, self._camera.above + 2.2 * size])
    direction, width = np.array([[0.0, 0.0, -size]]), np.array([[0.1 * size]])
    return [Shapes("arrow", start[None], direction, width, np.array([_MARK]))]

  def _contacts(self, snapshot: Snapshot) -> list[Shapes]:
    """Return the contacts of the selected world, in mjviser's colors and sizes."""
    points, forces = self.scene.show_contact_points, self.scene.show_contact_forces
    if not self.is_finite or not (points or forces):
      return []
    if not snapshot.contacts:
      self._own.load(snapshot)
    contacts, split = self._own.contacts(snapshot), self.scene.splits_contact_forces
    return contact_shapes(contacts, self._own.model, points=points, forces=forces, split=split)

  def _poses(self, snapshot: Snapshot) -> dict[str, np.ndarray]:
    """Return poses of all bodies as mjviser needs them, one row for each world.

    A world that diverged has its last finite poses.
    """
    xpos, xquat = snapshot.data["xpos"].copy(), snapshot.data["xquat"].copy()
    for row, world in enumerate(snapshot.worlds):
      if snapshot.is_finite(row):
        self._finite[world] = xpos[row], xquat[row]
      else:
        xpos[row], xquat[row] = self._finite.get(world, self._rest)
    matrices = viser.transforms.SO3(xquat.reshape(-1, 4)).as_matrix().reshape(*xquat.shape[:2], 3, 3)
    mocap = {name: snapshot.data[name] for name in ("mocap_pos", "mocap_quat") if name in snapshot.data}
    return {"body_xpos": xpos, "body_xmat": matrices, **mocap}

  def _target(self) -> np.ndarray:
    if self.scene.camera_tracking_enabled:
      # mjviser keeps the body that is followed at the origin.
      return self._camera.target(np.zeros_like(self._rest[0]))
    places = self._rest if self.shown is None else self._finite.get(self.shown.worlds[0], self._rest)
    return self._camera.target(places[0])

  def _eye(self) -> np.ndarray:
    return self._target() + self._camera.offset
