"""Films of a training, at intervals."""

from __future__ import annotations

import logging
from pathlib import Path

from mjlab_core import MjlabError

from mjlab_viewer.env import ViewedEnv
from mjlab_viewer.pictures.offscreen import PictureCfg
from mjlab_viewer.pictures.video import BackgroundVideo
from mjlab_viewer.playback import one_line
from mjlab_viewer.snapshot import SnapshotTaker

_log = logging.getLogger("mjlab")

MOST_TILES = 4


class TrainingVideo:
  """Films of the first worlds as tiles: `length` steps, every `interval` steps.

  `after_step` copies a few worlds to the host. One thread renders and encodes all films in the background. If it cannot
  keep up, it repeats frames instead of delaying the training. Only the first frame of a film waits, so that no film is
  lost. If rendering or a drawing fails, one warning is logged and filming stops.

  Args:
    env: The environment.
    folder: Folder of the films, which are called `step_<first step>.mp4`.
    interval: Steps from the start of one film to the start of the next.
    length: Steps of a film.
    cfg: Size and content of pictures.

  Raises:
    MjlabError: `length` is not between 1 and `interval`.
  """

  def __init__(
    self, env: ViewedEnv, folder: Path, *, interval: int = 2000, length: int = 200, cfg: PictureCfg | None = None
  ) -> None:
    if not 1 <= length <= interval:
      raise MjlabError(f"the length of a film must be from 1 to their interval ({interval}), got {length}")
    self._env, self._folder = env, folder
    self._interval, self._length = interval, length
    self._taker = SnapshotTaker(env, contacts=cfg is not None and cfg.contacts)
    self._worlds = range(min(env.num_envs, MOST_TILES))
    self._step = 0
    self._film = BackgroundVideo(self._path(0), 1.0 / env.step_dt, env.sim.mj_model, cfg)
    self.is_off = False
    """True after filming has stopped because of an error."""

  def after_step(self) -> None:
    """Take the next frame, if one is due."""
    phase = self._step % self._interval
    self._step += 1
    if self.is_off or phase >= self._length:
      return
    try:
      snapshot = self._taker.take(self._worlds, drawers=self._env.default_drawers(), apart=True)
    except Exception as error:
      # A drawing of a task must not end a training.
      self._give_up(one_line("drawing", error))
      return
    self._film.add(snapshot, wait=phase == 0)
    if phase == self._length - 1:
      self._film.begin(self._path(self._step + self._interval - self._length))
    if self._film.error is not None:
      self._give_up(str(self._film.error))

  def close(self) -> None:
    """Wait until all films are written."""
    self._film.close()
    if self._film.error is not None and not self.is_off:
      self._give_up(str(self._film.error))

  def _path(self, step: int) -> Path:
    return self._folder / f"step_{step}.mp4"

  def _give_up(self, why: str) -> None:
    self.is_off = True
    _log.warning("training goes on without films: %s", " ".join(why.split()))
