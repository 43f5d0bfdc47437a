"""Viewer in a browser, on this machine or another one."""

from __future__ import annotations

import contextlib
import io
import logging
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import viser

from mjlab_viewer.browser.address import check_address, ignore_failed_handshakes
from mjlab_viewer.browser.controls import PlaybackControls, WorldControls
from mjlab_viewer.browser.recorder import Recorder
from mjlab_viewer.browser.signal_plot import SignalPlot
from mjlab_viewer.browser.time_line import HISTORY
from mjlab_viewer.browser.training_panel import TrainingPanel
from mjlab_viewer.browser.viser_internals import read_icons_once, repair_wakeup
from mjlab_viewer.browser.world.groups import GroupControls
from mjlab_viewer.browser.world.scene import BrowserScene, Selection
from mjlab_viewer.camera import CameraCfg
from mjlab_viewer.env import ViewedEnv
from mjlab_viewer.playback import CheckpointList, Playback, one_line
from mjlab_viewer.snapshot import Snapshot, SnapshotTaker

_log = logging.getLogger("mjlab")

FRAME = 1 / 30
"""Time between pictures [s]."""

_PLOT_PERIOD = 0.1
_STATUS_PERIOD = 0.25


class BrowserViewer:
  """Page that shows worlds of an environment.

  The thread that owns the environment calls `update` regularly. It shows the worlds when a picture is due and a client
  is connected, and otherwise returns at once. The page runs in separate threads, which only leave requests.

  Args:
    env: The environment.
    playback: Steps the environment, controlled by the page; None where the caller steps it.
    checkpoints: Policies to choose from.
    host: Address to listen on; with the default only this machine can connect.
    port: Port to listen on; if it is taken, the next free one is used.
    camera: First camera.
    max_worlds: Greatest number of worlds shown at once.
    video_folder: Folder of the films of the record button.
    label: Title of the page.
    on_stop: Function that stops a training; the page then has a panel of the training, with a button that calls it.

  Raises:
    MjlabError: The model has no such body, or the server cannot listen on the address.
  """

  def __init__(
    self,
    env: ViewedEnv,
    *,
    playback: Playback | None = None,
    checkpoints: CheckpointList | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    camera: CameraCfg | None = None,
    max_worlds: int = 16,
    video_folder: Path = Path("videos"),
    label: str = "mjlab",
    on_stop: Callable[[], None] | None = None,
  ) -> None:
    self.env = env
    self.playback = playback
    self.selection = Selection(num_envs=env.num_envs, most=max_worlds)
    """Worlds that are shown."""
    self.error: str | None = None
    """Error of the last picture, one line."""
    self.history: deque[Snapshot] = deque(maxlen=round(HISTORY / FRAME))
    """Snapshots shown in the last seconds."""
    camera = CameraCfg() if camera is None else camera
    resolved = camera.resolve(env.sim.mj_model)
    self._taker = SnapshotTaker(env, contacts=True)
    self._num_updates = 0
    self._is_off = False
    self._clock = time.perf_counter if playback is None else playback.clock
    self._due = {"frame": 0.0, "plot": 0.0, "status": 0.0}
    check_address(host, port)
    ignore_failed_handshakes()
    repair_wakeup()
    read_icons_once()
    # viser prints a greeting, but standard output belongs to the caller.
    with contextlib.redirect_stdout(io.StringIO()):
      self.server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    try:
      self.scene = BrowserScene(self.server, env.sim.mj_model, resolved, self.selection.count)
      self.recorder = Recorder(env, self._taker, self.scene, self.selection, camera, video_folder)
      """Films of the selected world."""
      self.training: TrainingPanel | None = None
      """Progress of the training that is watched, if the viewer has `on_stop`."""
      self._make_page(checkpoints, on_stop)
      if playback is not None:
        playback.on_step.append(self._record)
    except BaseException:
      self._stop_serving()
      raise

  @property
  def url(self) -> str:
    """Address of the page."""
    host = self.server.get_host()
    return f"http://{'localhost' if host in ('0.0.0.0', '127.0.0.1') else host}:{self.server.get_port()}"

  def update(self) -> None:
    """Show a picture if one is due and a client is connected. Without a playback, call it once after every step."""
    self._num_updates += 1
    if self.playback is None:
      self._record()
    now = self._clock()
    if now < self._due["frame"] or self._is_off:
      return
    self._due["frame"] = now + FRAME
    try:
      # Inputs of a page that was closed count too; the world is selected before its commands are set.
      for part in (self._worlds, self._groups, self._controls, self.training):
        if part is not None:
          part.inputs.read()
      if not self.server.get_clients():
        return
      self._show(now)
      self.error = None
    except Exception as error:
      self._fail("viewer", error)
    # The status shows an error even where no picture can be shown.
    if now >= self._due["status"] and self._controls is not None:
      self._due["status"] = now + _STATUS_PERIOD
      self._controls.show_status()
    # After a slow picture, the next one is due a little later instead of at once.
    self._due["frame"] = max(now + FRAME, self._clock() + FRAME / 4)

  def run(self, until: Callable[[], bool] = lambda: False) -> None:
    """Step and show until `until` returns True, with a playback; call it in the thread that owns the environment."""
    assert self.playback is not None
    self.playback.run(self.update, until)

  def close(self) -> None:
    """Stop serving, and finish a film that is being made. Calling it again does nothing."""
    self._is_off = True
    self.recorder.close()
    self._stop_serving()

  def _stop_serving(self) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
      self.server.stop()

  def __enter__(self) -> BrowserViewer:
    return self

  def __exit__(self, *_: object) -> None:
    self.close()

  def _make_page(self, checkpoints: CheckpointList | None, on_stop: Callable[[], None] | None) -> None:
    gui, scene = self.server.gui, self.scene
    gui.configure_theme(control_width="large", show_share_button=False)
    gui.main_panel.dock_right()
    self._controls = None
    tabs = gui.add_tab_group()
    if on_stop is not None:
      with tabs.add_tab("Training"):
        self.training = TrainingPanel(self.server, on_stop)
    with tabs.add_tab("Controls"):
      if self.playback is not None:
        self._controls = PlaybackControls(self.server, self.playback, self.selection, scene, self.recorder, checkpoints)
      self._worlds = WorldControls(self.server, self.env, self.selection, scene)
      self.recorder.drawers = self._worlds.drawers
    signals = {group: tuple(names) for group, (names, _) in self.env.signals().items() if len(names)}
    self._plots: list[SignalPlot] = []
    with tabs.add_tab("Plots"):
      for group, names in signals.items():
        with gui.add_folder(group.capitalize()):
          self._plots.append(SignalPlot(self.server, group, names))
    with tabs.add_tab("Overlays"):
      scene.scene.create_overlay_gui()
    with tabs.add_tab("Groups"):
      self._groups = GroupControls(self.server, scene.scene)

  def _show(self, now: float) -> None:
    back = self._controls.seconds_back if self._controls is not None else 0.0
    if back > 0.0 and self.history:
      steps = round(back / self.env.step_dt)
      snapshot = min(self.history, key=lambda kept: abs(self.history[-1].step - steps - kept.step))
      shown = [kept for kept in self.history if kept.step <= snapshot.step]
    else:
      snapshot = self._take()
      shown = list(self.history)
    self.scene.show(snapshot)
    if now >= self._due["plot"]:
      self._due["plot"] = now + _PLOT_PERIOD
      curves = [kept for kept in shown if kept.worlds[0] == snapshot.worlds[0]]
      for plot in self._plots:
        plot.show(curves, self.env.step_dt)

  def _take(self) -> Snapshot:
    step = self.playback.total_steps if self.playback is not None else self._num_updates
    snapshot = self._taker.take(self.selection.worlds, drawers=self._worlds.drawers(), step=step)
    # While paused, the same moment is shown again and again, and kept once.
    if self.history and self.history[-1].step == step:
      self.history.pop()
    self.history.append(snapshot)
    return snapshot

  def _fail(self, what: str, error: Exception) -> None:
    """Pause and keep the error; without a playback switch the viewer off, so that the caller's steps go on."""
    self.error = one_line(what, error)
    if self.playback is not None:
      self.playback.fail(what, error)
      return
    _log.warning("the viewer is switched off: %s", self.error)
    self._is_off = True

  def _record(self) -> None:
    try:
      self.recorder.add()
    except Exception as error:
      self._fail("film", error)
