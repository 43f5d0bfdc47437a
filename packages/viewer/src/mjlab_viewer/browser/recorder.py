"""Films of the selected world, made while the page is open."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

from mjlab_core import MjlabError

from mjlab_viewer.browser.world.scene import BrowserScene, Selection
from mjlab_viewer.camera import CameraCfg
from mjlab_viewer.env import ViewedEnv
from mjlab_viewer.pictures.offscreen import PictureCfg
from mjlab_viewer.pictures.video import BackgroundVideo
from mjlab_viewer.snapshot import SnapshotTaker


class Recorder:
  """Film of the selected world, one frame for each step.

  Args:
    env: The environment.
    taker: Snapshot taker of the environment.
    scene: Scene that shows contacts or not; the film does the same.
    selection: Selection, with the world to film.
    camera: Camera of the film.
    folder: Folder of the films.
  """

  def __init__(
    self,
    env: ViewedEnv,
    taker: SnapshotTaker,
    scene: BrowserScene,
    selection: Selection,
    camera: CameraCfg,
    folder: Path,
  ) -> None:
    self._env, self._taker, self._scene, self._selection = env, taker, scene, selection
    self._camera, self._folder = camera, folder
    self._video: BackgroundVideo | None = None
    self.drawers: Callable[[], Sequence[str]] = tuple
    """Names of the drawers that are on."""

  @property
  def is_on(self) -> bool:
    """True while a film is made."""
    return self._video is not None

  def start(self) -> Path:
    """Start a film, and return its path."""
    path = self._folder / f"{datetime.now():%Y-%m-%d_%H-%M-%S-%f}.mp4"
    contacts = self._scene.scene.show_contact_points or self._scene.scene.show_contact_forces
    cfg = PictureCfg(camera=self._camera, contacts=contacts)
    self._video = BackgroundVideo(path, 1.0 / self._env.step_dt, self._env.sim.mj_model, cfg)
    return path

  def stop(self) -> Path:
    """Finish the film, and return its path.

    Raises:
      MjlabError: There is no film; the message says why.
    """
    video, self._video = self._video, None
    assert video is not None
    path = video.close()
    if path is None:
      raise MjlabError(f"no film: {video.error or 'no step was taken'}")
    return path

  def add(self) -> None:
    """Add a frame of the present state, if a film is made.

    Raises:
      Exception: Drawing or rendering failed; the film has ended without a file.
    """
    video = self._video
    if video is None:
      return
    if video.error is not None:
      self._video = None
      video.close()
      raise video.error
    video.add(self._taker.take((self._selection.world,), drawers=self.drawers()))

  def close(self) -> None:
    """Finish a film that is being made."""
    if self._video is not None:
      with contextlib.suppress(MjlabError):
        self.stop()
