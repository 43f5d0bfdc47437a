"""Films: encoding of frames, and rendering in the background."""

from __future__ import annotations

import contextlib
import os
import queue
import threading
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mjlab_core.io.files import AtomicWrite

from mjlab_viewer.pictures.offscreen import OffscreenRenderer, PictureCfg
from mjlab_viewer.snapshot import Snapshot

if TYPE_CHECKING:
  from av.container import OutputContainer
  from av.video.stream import VideoStream


class VideoFile:
  """Film as mp4 (H.264), which appears under its name when it is closed.

  Args:
    path: Path of the film, which ends in .mp4.
    fps: Frames per second.
  """

  def __init__(self, path: str | os.PathLike[str], fps: float) -> None:
    self.path = Path(path)
    self._fps = Fraction(fps).limit_denominator(1000)
    self._open: tuple[OutputContainer, VideoStream, AtomicWrite] | None = None
    self.num_frames = 0

  def add(self, frame: np.ndarray) -> None:
    """Append a frame, (height, width, 3) uint8, of the size of the first one. An odd row or column is cut."""
    import av

    # H.264 halves the resolution of colors, so sides are even.
    frame = frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]
    if self._open is None:
      write = AtomicWrite(self.path)
      # PyAV opens the file later, and its error has no name.
      write.temporary.touch()
      container = av.open(str(write.temporary), "w", format="mp4")
      stream = container.add_stream("libx264", rate=self._fps, options={"crf": "23", "preset": "fast"})
      stream.height, stream.width = frame.shape[:2]
      stream.pix_fmt = "yuv420p"
      self._open = container, stream, write
    container, stream, _ = self._open
    container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")))
    self.num_frames += 1

  def close(self) -> None:
    """Finish the file. Without a frame, there is no file."""
    if self._open is not None:
      container, stream, write = self._open
      container.mux(stream.encode())
      container.close()
      self._open = None
      write.commit()

  def discard(self) -> None:
    """Stop without a file. Errors are ignored: it is called after one."""
    opened, self._open = self._open, None
    if opened is not None:
      container, _, write = opened
      with contextlib.suppress(OSError):
        container.close()
      with contextlib.suppress(OSError):
        write.discard()


_ROOM = 32
"""Snapshots that wait to be rendered."""


class BackgroundVideo:
  """Renders and encodes snapshots in a separate thread, so that the simulation does not wait.

  One thread and one renderer serve any number of films, one after another. If rendering fails, `error` holds the
  exception and nothing is raised.

  Args:
    path: Path of the mp4.
    fps: Frames per second.
    model: The simulation's model; copied.
    cfg: Size and content of pictures.
  """

  def __init__(
    self, path: str | os.PathLike[str], fps: float, model: mujoco.MjModel, cfg: PictureCfg | None = None
  ) -> None:
    self.file = VideoFile(path, fps)
    self.error: Exception | None = None
    self._missed = 0
    self._fps = fps
    # A snapshot, the next film, or the end; with the number of frames that were dropped before it.
    self._queue: queue.Queue[tuple[Snapshot | VideoFile | None, int]] = queue.Queue(maxsize=_ROOM)
    self._thread = threading.Thread(target=self._run, args=(model, cfg), name="video", daemon=True)
    self._thread.start()

  def add(self, snapshot: Snapshot, *, wait: bool = True) -> None:
    """Add a frame. If the thread cannot keep up, wait, or without `wait` show the previous frame for longer."""
    if self.error is not None:
      return
    if wait or not self._queue.full():
      self._put(snapshot)
    else:
      self._missed += 1

  def begin(self, path: str | os.PathLike[str]) -> None:
    """Finish the film in the background; further frames belong to the film of `path`."""
    self.file = VideoFile(path, self._fps)
    self._put(self.file)

  def close(self) -> Path | None:
    """Wait for all frames, finish the file, and return its path, or None if there is no file."""
    if self._thread.is_alive():
      self._put(None)
    self._thread.join()
    return self.file.path if self.error is None and self.file.num_frames else None

  def _put(self, item: Snapshot | VideoFile | None) -> None:
    self._queue.put((item, self._missed))
    self._missed = 0

  def _run(self, model: mujoco.MjModel, cfg: PictureCfg | None) -> None:
    is_over = False
    file, picture = self.file, None
    try:
      with OffscreenRenderer(model, cfg) as renderer:
        while not is_over:
          item, missed = self._queue.get()
          if picture is not None:
            for _ in range(missed):
              file.add(picture)
          if isinstance(item, Snapshot):
            picture = renderer.render(item)
            file.add(picture)
            continue
          is_over = item is None
          file.close()
          if item is not None:
            file, picture = item, None
    except Exception as error:
      self.error = error
      file.discard()
      # A caller that waits for room must not wait without end.
      while not is_over:
        is_over = self._queue.get()[0] is None
