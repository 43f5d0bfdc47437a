"""MuJoCo's own window."""

from __future__ import annotations

import importlib
import re
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import mujoco
import torch

from mjlab_viewer.camera import CameraCfg
from mjlab_viewer.contacts import contact_shapes
from mjlab_viewer.errors import RenderingError
from mjlab_viewer.host_world import HostWorld
from mjlab_viewer.mjv_drawing import add_to_scene, count_geoms, thinned
from mjlab_viewer.native_plots import NativePlots
from mjlab_viewer.playback import Playback
from mjlab_viewer.snapshot import Snapshot, SnapshotTaker

FRAME = 1 / 60
"""Time between pictures [s]."""

KEYS = {
  " ": "pause and go on",
  "ENTER": "reset",
  "RIGHT": "one step, while paused",
  "-": "slower",
  "=": "faster",
  ",": "previous world",
  ".": "next world",
  "R": "drawings on and off",
  "P": "plots of rewards, then of all else page by page, then none",
}
"""Keys beside those of MuJoCo's window, and what they do."""

_PLOT_EVERY = 0.1
_CONTACT_FLAGS = {
  "points": mujoco.mjtVisFlag.mjVIS_CONTACTPOINT,
  "forces": mujoco.mjtVisFlag.mjVIS_CONTACTFORCE,
  "split": mujoco.mjtVisFlag.mjVIS_CONTACTSPLIT,
}
_ENTER, _RIGHT = 257, 262  # As GLFW numbers them; the others are their letters.


class NativeViewer:
  """Shows one world in MuJoCo's passive viewer, on a model and data of its own.

  What its window offers works: contact points and forces (keys C and F), cameras, and dragging a body with Ctrl and the
  right mouse button, whose force reaches the simulation. `KEYS` lists the others.

  Args:
    playback: What steps the worlds.
    camera: Where one looks from at first.

  Raises:
    RenderingError: no window can be opened here.
    ViewerError: a camera that cannot be.
  """

  def __init__(self, playback: Playback, *, camera: CameraCfg | None = None) -> None:
    self.playback = playback
    self.env = playback.env
    self.selected = 0
    """World that is shown."""
    self.draws = True
    """Whether what commands and sensors draw is shown."""
    self.num_undrawn = 0
    """Shapes that the window had no room for in the last picture: it takes 100 000, and beyond them evenly fewer."""
    self._world = HostWorld(self.env.sim.mj_model)
    self._camera = (CameraCfg() if camera is None else camera).resolve(self._world.model)
    self._taker = SnapshotTaker(self.env, contacts=True)
    model = self._world.model
    # What MuJoCo may draw beside them into the same scene: everything, with all its frames and labels.
    self._own_geoms = 1000 + 4 * (model.nbody + model.njnt + model.ngeom + model.nsite + model.nu + model.nwrap)
    self._plots = NativePlots({group: tuple(names) for group, (names, _) in self.env.signals().items()})
    self._is_plotting = False
    self._is_finite = True
    self._due = {"frame": 0.0, "plot": 0.0}
    self._target: Any = None
    self._dragged: tuple[int, int] | None = None
    """World and body that is being pulled."""
    self._actions: dict[int, Callable[[], None]] = {
      ord(" "): self._toggle,
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
    """Step and show until the window is closed or `until` says so."""
    while self.window.is_running() and not until():
      steps = self.playback.tick()
      self.update()
      if not steps:
        time.sleep(0.002)

  def update(self) -> None:
    """Show what is due."""
    now = time.perf_counter()
    if now < self._due["frame"]:
      return
    try:
      self._show()
    except Exception as error:
      self.playback.fail("viewer", error)
    self.window.set_texts([(None, None, *self._status())])
    self.window.sync()
    self._due["frame"] = max(now + FRAME, time.perf_counter() + FRAME / 4)

  def close(self) -> None:
    """Close the window and wait until it is gone. Calling it again does nothing."""
    self.window.close()
    # Left to itself, the thread that draws would go on into what GLFW takes down when the process ends, and hang it.
    for thread in self._window_threads:
      thread.join(timeout=10.0)

  def __enter__(self) -> NativeViewer:
    return self

  def __exit__(self, *_: object) -> None:
    self.close()

  def _open(self) -> Any:
    import glfw

    passive = importlib.import_module("mujoco.viewer")
    # MuJoCo ends the process where there is no screen, so that is asked first.
    with warnings.catch_warnings(record=True) as told:
      warnings.simplefilter("always")
      has_screen = glfw.init()
    if not has_screen:
      # As in "(65550) b'X11: The DISPLAY environment variable is missing'".
      reason = re.sub(r"^\(\d+\) b'(.*)'$", r"\1", str(told[-1].message)) if told else "GLFW does not start"
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
    now, viewport = time.perf_counter(), self.window.viewport
    if now < self._due["plot"] or viewport is None:
      return
    self._due["plot"] = now + _PLOT_EVERY
    figures = self._plots.figures(viewport, self.env.step_dt)
    if figures or self._is_plotting:
      self.window.set_figures(figures)
    self._is_plotting = bool(figures)

  def _toggle(self) -> None:
    if self.playback.paused:
      self.playback.resume()
    else:
      self.playback.pause()

  def _select(self, world: int) -> None:
    self.selected = world % self.env.num_envs

  def _show(self) -> None:
    names = self.env.drawn_at_first() if self.draws else ()
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
    # Moved along with the robot, so that whoever turned it keeps their view.
    target = self._camera.target(self._world.data.xpos)
    if self._target is None:
      self._camera.aim(self.window.cam, target)
    else:
      self.window.cam.lookat[:] += target - self._target
    self._target = target

  def _draw(self, snapshot: Snapshot) -> None:
    """Give the window what commands and sensors drew, and the contacts it is to show."""
    model, data, flags = self._world.model, self._world.data, self.window.opt.flags
    wanted = {name: bool(flags[flag]) for name, flag in _CONTACT_FLAGS.items()}
    drawn = [shapes for drawing in snapshot.drawings for shapes in drawing.shapes]
    drawn += contact_shapes(self._world.contacts(snapshot), model, **wanted)
    # The window would draw those that the host computed.
    data.ncon = 0
    scene = self.window.user_scn
    shown = thinned(drawn, scene.maxgeom - self._own_geoms)
    scene.ngeom = 0
    add_to_scene(scene, model, shown)
    self.num_undrawn = count_geoms(drawn) - count_geoms(shown)

  def _drag(self) -> None:
    """Pull in the simulation as the mouse pulls in the window."""
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
    state = "paused" if playback.paused else f"{playback.real_time_factor:.2g} x real time"
    rows = {
      "world": f"{self.selected} of {self.env.num_envs}",
      "step": str(playback.step_count),
      "speed": f"{playback.speed:g}{' (too slow a machine)' if playback.is_capped else ''}",
      "state": state,
    }
    if not self._is_finite:
      rows["diverged"] = "not finite: shown as it was before"
    if self.num_undrawn:
      rows["drawn"] = f"without {self.num_undrawn} shapes: the window is full"
    if playback.error is not None:
      rows["error"] = playback.error
    return "\n".join(rows), "\n".join(rows.values())
