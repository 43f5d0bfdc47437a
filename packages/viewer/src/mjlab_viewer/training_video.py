"""Films of worlds that somebody else steps, one now and then."""

from __future__ import annotations

import logging
from pathlib import Path

from mjlab_viewer.errors import ViewerError
from mjlab_viewer.offscreen import PictureCfg
from mjlab_viewer.playback import one_line
from mjlab_viewer.snapshot import SnapshotTaker
from mjlab_viewer.video import BackgroundVideo
from mjlab_viewer.worlds import ViewedEnv

_log = logging.getLogger("mjlab")

MOST_TILES = 4


class TrainingVideo:
  """Films the first worlds as tiles: `length` steps from every `interval`-th on.

  `after_step` copies a few worlds to the host; rendering and encoding happen in the background, and frames are left out
  rather than waited for. Where no pictures can be made, or a drawing fails, one line says so and nothing more is tried.

  Args:
    env: The environment.
    folder: Where films go, as `step_<first step>.mp4`.
    interval: Steps from the beginning of one film to that of the next.
    length: Steps of a film.
    cfg: What pictures look like.

  Raises:
    ViewerError: lengths that cannot be.
  """

  def __init__(
    self, env: ViewedEnv, folder: Path, *, interval: int = 2000, length: int = 200, cfg: PictureCfg | None = None
  ) -> None:
    if not 1 <= length <= interval:
      raise ViewerError(f"films of {length} steps cannot begin every {interval} steps")
    self._env, self._folder = env, folder
    self._interval, self._length, self._cfg = interval, length, cfg
    self._taker = SnapshotTaker(env, contacts=cfg is not None and cfg.contacts)
    self._worlds = range(min(env.num_envs, MOST_TILES))
    self._step = 0
    self._film: BackgroundVideo | None = None
    self.is_off = False
    """Whether filming was given up."""

  def after_step(self) -> None:
    """Take the next frame, if one is wanted."""
    phase = self._step % self._interval
    self._step += 1
    if self.is_off or phase >= self._length:
      return
    if phase == 0:
      path = self._folder / f"step_{self._step - 1}.mp4"
      self._film = BackgroundVideo(path, 1.0 / self._env.step_dt, self._env.sim.mj_model, self._cfg)
    if self._film is None:
      return
    try:
      snapshot = self._taker.take(self._worlds, drawers=self._env.drawn_at_first(), apart=True)
    except Exception as error:
      # What tasks draw is theirs; a film is never worth a training.
      self._give_up(one_line("drawing", error))
      return
    self._film.add(snapshot)
    if phase == self._length - 1:
      self._film.finish()
    if self._film.error is not None:
      self._give_up(str(self._film.error))

  def close(self) -> None:
    """Finish the film that is being made."""
    if self._film is not None:
      self._film.close()
      if self._film.error is not None and not self.is_off:
        self._give_up(str(self._film.error))
      self._film = None

  def _give_up(self, why: str) -> None:
    self.is_off = True
    _log.warning("training goes on without films: %s", " ".join(why.split()))
