"""Viewer in MuJoCo's window."""

from __future__ import annotations

import importlib
import re
import threading
import warnings
from collections.abc import Callable
from typing import Any

import mujoco
import torch
from mjlab_core import RenderingError

from mjlab_viewer.camera import CameraCfg
from mjlab_viewer.drawing.contacts import contact_shapes
from mjlab_viewer.drawing.mjv import add_to_scene, count_geoms, thinned
from mjlab_viewer.native.plots import NativePlots
from mjlab_viewer.playback import Playback
from mjlab_viewer.snapshot import HostWorld, Snapshot, SnapshotTaker

FRAME = 1 / 60
"""Time between pictures [s]."""

KEYS = {
  " ": "pause and continue",
  "ENTER": "reset",
  "RIGHT": "one step, while paused",
  "-": "slower",
  "=": "faster",
  ",": "previous world",
  ".": "next world",
  "R": "drawings on and off",
  "P": "plots of rewards, then of all else page by page, then none",
}
"""Keys in addition to those of MuJoCo's window, and their actions."""

_PLOT_PERIOD = 0.1
_CONTACT_FLAGS = {
  "points": mujoco.mjtVisFlag.mjVIS_CONTACTPOINT,
  "forces": mujoco.mjtVisFlag.mjVIS_CONTACTFORCE,
  "split": mujoco.mjtVisFlag.mjVIS_CONTACTSPLIT,
}
_ENTER, _RIGHT = 257, 262  # As GLFW numbers them; the others are their letters.


class NativeViewer:
  """Window of MuJoCo's passive viewer that shows one world, with a copy of the model.

  The controls of MuJoCo's window work: contact points and forces (keys C and F), cameras, and dragging a body with Ctrl
  and the right mouse button, whose force reaches the simulation. `KEYS` lists further keys.

  Args:
    playback: Steps the worlds.
    camera: First camera.

  Raises:
    RenderingError: This machine cannot open a window.
    UnknownNameError: The model has no body of the camera's name.
  """

  def __init__(self, playback: Playback, *, camera: CameraCfg | None = None) -> None:
    self.playback = playback
    self.env = playback.env
    self.selected = 0
    """World that is shown."""
    self.draws = True
    """True shows the drawings of commands and sensors."""
    self.num_undrawn = 0
    """Number of shapes without room in the last picture; the window takes 100 000, and drops the others evenly."""
    self._world = HostWorld(self.env.sim.mj_model)
    self._camera = (CameraCfg() if camera is None else camera).resolve(self._world.model)
    self._taker = SnapshotTaker(self.env, contacts=True)
    model = self._world.model
    # MuJoCo draws into the same scene: at most everything, with all frames and labels.
    self._own_geoms = 1000 + 4 * (model.nbody + model.njnt + model.ngeom + model.nsite + model.nu + model.nwrap)
    self._plots = NativePlots({group: tuple(names) for group, (names, _) in self.env.signals().items()})
    self._is_plotting = False
    self._is_finite = True
    self._due = {"frame": 0.0, "plot": 0.0}
    self._target: Any = None
    self._dragged: tuple[int, int] | None = None
    """World and body that is dragged."""
    self._actions: dict[int, Callable[[], None]] = {
      ord(" "): playback.toggle,
      _ENTER: playback.reset,
      _RIGHT: playback.step_once,
      ord("-"): lambda: playback.faster(-1),
      ord("="): lambda: playback.faster(1),
      ord(","): lambda: self._select(self.selected - 1),
      ord("."): lambda: self._select(self.selected + 1),
      ord("R"): lambda: setattr(self, "draws", not self.draws),
      ord("P"): self._plots.turn,
    }
    self.window = self._open()
    """MuJoCo's handle of the window."""

  def run(self, until: Callable[[], bool] = lambda: False) -> None:
    """Step and show until the window is closed or `until` returns True."""
    self.playback.run(self.update, lambda: until() or not self.window.is_running())

  def update(self) -> None:
    """Show a picture if one is due."""
    now = self.playback.clock()
    if now < self._due["frame"]:
      return
    try:
      self._show()
    except Exception as error:
      self.playback.fail("viewer", error)
    self.window.set_texts([(None, None, *self._status())])
    self.window.sync()
    self._due["frame"] = max(now + FRAME, self.playback.clock() + FRAME / 4)

  def close(self) -> None:
    """Close the window and wait for its thread. Calling it again does nothing."""
    self.window.close()
    # Otherwise the thread that draws would use GLFW while the process ends and GLFW shuts down, and hang it.
    for thread in self._window_threads:
      thread.join(timeout=10.0)

  def __enter__(self) -> NativeViewer:
    return self

  def __exit__(self, *_: object) -> None:
    self.close()

  def _open(self) -> Any:
    import glfw

    passive = importlib.import_module("mujoco.viewer")
    # MuJoCo ends the process if there is no screen, so this is checked first.
    with warnings.catch_warnings(record=True) as caught:
      warnings.simplefilter("always")
      has_screen = glfw.init()
    if not has_screen:
      # As in "(65550) b'X11: The DISPLAY environment variable is missing'".
      reason = re.sub(r"^\(\d+\) b'(.*)'$", r"\1", str(caught[-1].message)) if caught else "GLFW does not start"
      raise RenderingError(f"no window can be opened here ({reason}); --viewer browser needs none")
    before = set(threading.enumerate())
    handle = passive.launch_passive(
      self._world.model, self._world.data, key_callback=self._press, show_left_ui=False, show_right_ui=False
    )
    self._window_threads = [thread for thread in threading.enumerate() if thread not in before]
    with handle.lock():
      self._camera.aim(handle.cam, self._camera.target(self._world.data.xpos))
    return handle

  def _press(self, key: int) -> None:
    if key in self._actions:
      self.playback.request(self._actions[key])

  def _plot(self, snapshot: Snapshot) -> None:
    self._plots.add(snapshot)
    now, viewport = self.playback.clock(), self.window.viewport
    if now < self._due["plot"] or viewport is None:
      return
    self._due["plot"] = now + _PLOT_PERIOD
    figures = self._plots.figures(viewport, self.env.step_dt)
    if figures or self._is_plotting:
      self.window.set_figures(figures)
    self._is_plotting = bool(figures)

  def _select(self, world: int) -> None:
    self.selected = world % self.env.num_envs

  def _show(self) -> None:
    names = self.env.default_drawers() if self.draws else ()
    snapshot = self._taker.take((self.selected,), drawers=names, step=self.playback.total_steps)
    self._is_finite = snapshot.is_finite()
    if self._is_finite:
      with self.window.lock():
        self._world.load(snapshot)
        self._follow()
        self._draw(snapshot)
    self._drag()
    self._plot(snapshot)

  def _follow(self) -> None:
    # The camera moves with the robot and keeps the direction that the user chose.
    target = self._camera.target(self._world.data.xpos)
    if self._target is None:
      self._camera.aim(self.window.cam, target)
    else:
      self.window.cam.lookat[:] += target - self._target
    self._target = target

  def _draw(self, snapshot: Snapshot) -> None:
    """Pass drawings of commands and sensors to the window, and the contacts that are switched on."""
    model, data, flags = self._world.model, self._world.data, self.window.opt.flags
    wanted = {name: bool(flags[flag]) for name, flag in _CONTACT_FLAGS.items()}
    drawn = [shapes for drawing in snapshot.drawings for shapes in drawing.shapes]
    drawn += contact_shapes(self._world.contacts(snapshot), model, **wanted)
    # Otherwise the window would draw contacts that the host computed.
    data.ncon = 0
    scene = self.window.user_scn
    shown = thinned(drawn, scene.maxgeom - self._own_geoms)
    scene.ngeom = 0
    add_to_scene(scene, model, shown)
    self.num_undrawn = count_geoms(drawn) - count_geoms(shown)

  def _drag(self) -> None:
    """Apply the force of the mouse in the simulation."""
    perturb = self.window.perturb
    force: torch.Tensor = self.env.sim.data.xfrc_applied
    pulled = (self.selected, int(perturb.select)) if perturb.active and perturb.select > 0 else None
    if self._dragged is not None and pulled != self._dragged:
      force[self._dragged] = 0.0
    self._dragged = pulled
    if pulled is not None:
      self._world.data.xfrc_applied[:] = 0.0
      mujoco.mjv_applyPerturbForce(self._world.model, self._world.data, perturb)
      wrench = torch.from_numpy(self._world.data.xfrc_applied[pulled[1]].copy())
      force[pulled] = wrench.to(force)

  def _status(self) -> tuple[str, str]:
    playback = self.playback
    rows = {
      "world": f"{self.selected} of {self.env.num_envs}",
      "step": str(playback.step_count),
      "speed": f"{playback.speed:g}",
      "state": playback.state,
    }
    if not self._is_finite:
      rows["diverged"] = "not finite: shown as it was before"
    if self.num_undrawn:
      rows["drawn"] = f"without {self.num_undrawn} shapes: the window is full"
    if playback.error is not None:
      rows["error"] = playback.error
    return "\n".join(rows), "\n".join(rows.values())
