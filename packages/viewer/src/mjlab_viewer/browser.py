"""Worlds in a browser, on this machine or another one."""

from __future__ import annotations

import contextlib
import io
import logging
import time
from collections import deque
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import viser

from mjlab_viewer.address import check_address
from mjlab_viewer.browser_controls import REMEMBERED, PlaybackControls, WorldControls
from mjlab_viewer.browser_scene import BrowserScene
from mjlab_viewer.camera import CameraCfg
from mjlab_viewer.checkpoint_list import CheckpointList
from mjlab_viewer.errors import ViewerError
from mjlab_viewer.offscreen import PictureCfg
from mjlab_viewer.playback import Playback, one_line
from mjlab_viewer.signal_plot import SignalPlot
from mjlab_viewer.snapshot import Snapshot, SnapshotTaker
from mjlab_viewer.video import BackgroundVideo
from mjlab_viewer.worlds import ViewedEnv

_log = logging.getLogger("mjlab")

FRAME = 1 / 30
"""Time between pictures [s]."""

_PLOT_EVERY = 0.1
_STATUS_EVERY = 0.25


class BrowserViewer:
  """Serves a page that shows worlds of an environment that somebody steps.

  `update` is called again and again by the thread that owns the environment; it takes a picture when one is due and
  somebody looks, and else returns at once. The page runs in threads of its own, which only leave wishes behind.

  Args:
    env: The environment.
    playback: What steps it, to be controlled from the page; None where somebody else does.
    checkpoints: Policies to choose from.
    host: Address to listen on; only this machine can connect to the default one.
    port: Port to listen on, the next free one if it is taken.
    camera: Where one looks from at first.
    max_worlds: Most worlds shown at once.
    video_folder: Where films of the record button go.
    label: What the page is called.

  Raises:
    ViewerError: a number, body or address that cannot be.
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
  ) -> None:
    if max_worlds < 1:
      raise ViewerError(f"max_worlds must be at least 1, got {max_worlds}")
    self.env = env
    self.playback = playback
    self.selected = 0
    """World that plots, drawings and contacts are of."""
    self.num_drawn = min(max_worlds, env.num_envs)
    """How many worlds are shown."""
    self.error: str | None = None
    """What went wrong while showing, one line."""
    self.history: deque[Snapshot] = deque(maxlen=round(REMEMBERED / FRAME))
    """What was shown in the last seconds."""
    self._camera_cfg = CameraCfg() if camera is None else camera
    resolved = self._camera_cfg.resolve(env.sim.mj_model)
    self._taker = SnapshotTaker(env, contacts=True)
    self._video_folder = video_folder
    self._video: BackgroundVideo | None = None
    self._num_updates = 0
    self._is_off = False
    self._due = {"frame": 0.0, "plot": 0.0, "status": 0.0}
    check_address(host, port)
    # It greets on standard output, which belongs to whoever opens the viewer.
    with contextlib.redirect_stdout(io.StringIO()):
      self.server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    try:
      self.scene = BrowserScene(self.server, env.sim.mj_model, resolved, self.num_drawn)
      self._make_page(max_worlds, checkpoints)
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
    """Show what is due, if anybody looks. Without a playback it is called once after every step."""
    self._num_updates += 1
    if self.playback is None:
      self._record()
    now = time.perf_counter()
    if now < self._due["frame"] or self._is_off:
      return
    self._due["frame"] = now + FRAME
    try:
      # Of a page that has gone again, too; which world it is comes before what is wanted of it.
      self._worlds.values.read()
      if self._controls is not None:
        self._controls.values.read()
        self._controls.buttons.read()
      if not self.server.get_clients():
        return
      self._show(now)
      self.error = None
    except Exception as error:
      self._fail("viewer", error)
    # An error is said even where nothing can be shown.
    if now >= self._due["status"] and self._controls is not None:
      self._due["status"] = now + _STATUS_EVERY
      self._controls.show_status()
    # A picture that took longer than it should have is followed by a pause, not by a backlog.
    self._due["frame"] = max(now + FRAME, time.perf_counter() + FRAME / 4)

  def run(self, until: Callable[[], bool] = lambda: False) -> None:
    """Step and show until `until` says so; the thread that owns the environment stays in here.

    Raises:
      ViewerError: there is nothing to step.
    """
    if self.playback is None:
      raise ViewerError("run needs a playback; call update where the environment is stepped")
    while not until():
      steps = self.playback.tick()
      self.update()
      if not steps:
        time.sleep(0.002)

  @property
  def is_recording(self) -> bool:
    """Whether a film is being made."""
    return self._video is not None

  def start_recording(self) -> Path:
    """Film the selected world from now on; returns where the film will be."""
    if self._video is not None:
      return self._video.file.path
    path = self._video_folder / f"{datetime.now():%Y-%m-%d_%H-%M-%S-%f}.mp4"
    contacts = self.scene.scene.show_contact_points or self.scene.scene.show_contact_forces
    cfg = PictureCfg(camera=self._camera_cfg, contacts=contacts)
    # Waited for: a film without some of its frames is too fast.
    self._video = BackgroundVideo(path, 1.0 / self.env.step_dt, self.env.sim.mj_model, cfg, wait=True)
    return path

  def stop_recording(self) -> Path:
    """Finish the film; returns where it is.

    Raises:
      ViewerError: there is none; the message says why.
    """
    video, self._video = self._video, None
    if video is None:
      raise ViewerError("nothing is being recorded")
    path = video.close()
    if path is None:
      raise ViewerError(f"no film: {video.error or 'no step was taken'}")
    return path

  def close(self) -> None:
    """Stop serving, and finish the film that is being made. Calling it again does nothing."""
    self._is_off = True
    if self._video is not None:
      with contextlib.suppress(ViewerError):
        self.stop_recording()
    self._stop_serving()

  def _stop_serving(self) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
      self.server.stop()

  def __enter__(self) -> BrowserViewer:
    return self

  def __exit__(self, *_: object) -> None:
    self.close()

  def _make_page(self, max_worlds: int, checkpoints: CheckpointList | None) -> None:
    gui = self.server.gui
    gui.configure_theme(control_width="large", show_share_button=False)
    gui.main_panel.dock_right()
    self._controls = None
    tabs = gui.add_tab_group()
    with tabs.add_tab("Controls", icon=viser.Icon.PLAYER_PLAY):
      if self.playback is not None:
        self._controls = PlaybackControls(self, self.playback, checkpoints)
      self._worlds = WorldControls(self, max_worlds)
    signals = {group: tuple(names) for group, (names, _) in self.env.signals().items() if len(names)}
    self._plots: list[SignalPlot] = []
    with tabs.add_tab("Plots", icon=viser.Icon.CHART_LINE):
      for groups in (
        {k: v for k, v in signals.items() if k == "rewards"},
        {k: v for k, v in signals.items() if k != "rewards"},
      ):
        if groups:
          with gui.add_folder("Rewards" if "rewards" in groups else "Signals"):
            self._plots.append(SignalPlot(self.server, groups))
    with tabs.add_tab("Overlays", icon=viser.Icon.EYE):
      self.scene.scene.create_overlay_gui()
    with tabs.add_tab("Groups", icon=viser.Icon.LAYERS_INTERSECT):
      self.scene.scene.create_groups_gui()

  def drawn_worlds(self) -> tuple[int, ...]:
    """The selected world and those after it, beginning anew behind the last."""
    return tuple((self.selected + i) % self.env.num_envs for i in range(min(self.num_drawn, self.env.num_envs)))

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
      self._due["plot"] = now + _PLOT_EVERY
      curves = [kept for kept in shown if kept.worlds[0] == snapshot.worlds[0]]
      for plot in self._plots:
        plot.show(curves, self.env.step_dt)

  def _take(self) -> Snapshot:
    step = self.playback.total_steps if self.playback is not None else self._num_updates
    worlds = self.drawn_worlds()
    snapshot = self._taker.take(worlds, drawers=self._worlds.drawers(), step=step)
    # While paused the same moment is shown again and again, and remembered once.
    if self.history and self.history[-1].step == step:
      self.history.pop()
    self.history.append(snapshot)
    return snapshot

  def _fail(self, what: str, error: Exception) -> None:
    """Pause and say what went wrong; whoever steps by themselves must not be stopped by who looks."""
    self.error = one_line(what, error)
    if self.playback is not None:
      self.playback.fail(what, error)
      return
    _log.warning("the viewer is switched off: %s", self.error)
    self._is_off = True

  def _record(self) -> None:
    video = self._video
    if video is None:
      return
    try:
      if video.error is not None:
        self._video = None
        video.close()
        raise video.error
      video.add(self._taker.take((self.selected,), drawers=self._worlds.drawers()))
    except Exception as error:
      self._fail("film", error)
