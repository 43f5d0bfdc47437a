"""Films: frames to a file, encoded and, if wanted, rendered in the background."""

from __future__ import annotations

import contextlib
import os
import queue
import threading
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import mujoco
import numpy as np
from av.container import OutputContainer
from av.video.stream import VideoStream

from mjlab_viewer.errors import ViewerError
from mjlab_viewer.offscreen import OffscreenRenderer, PictureCfg
from mjlab_viewer.snapshot import Snapshot


class VideoFile:
  """An mp4 (H.264) that appears under its name when it is closed, whole.

  Args:
    path: Where; must end in .mp4.
    fps: Frames per second.
  """

  def __init__(self, path: str | os.PathLike[str], fps: float) -> None:
    self.path = check_video_path(path)
    self._fps = Fraction(fps).limit_denominator(1000)
    self._temporary = self.path.with_name(f".{self.path.name}.{os.getpid()}.tmp")
    self._open: tuple[OutputContainer, VideoStream] | None = None
    self.num_frames = 0

  def add(self, frame: np.ndarray) -> None:
    """Append a frame, (height, width, 3) uint8; all have the size of the first. An odd row or column is cut."""
    # H.264 halves the resolution of colours, so sides are even.
    frame = frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]
    if self._open is None:
      self.path.parent.mkdir(parents=True, exist_ok=True)
      container = av.open(str(self._temporary), "w", format="mp4")
      stream = container.add_stream("libx264", rate=self._fps, options={"crf": "23", "preset": "fast"})
      stream.height, stream.width = frame.shape[:2]
      stream.pix_fmt = "yuv420p"
      self._open = container, stream
    container, stream = self._open
    container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")))
    self.num_frames += 1

  def close(self) -> None:
    """Finish the file. Without a frame there is none."""
    if self._open is not None:
      container, stream = self._open
      container.mux(stream.encode())
      container.close()
      self._open = None
      os.replace(self._temporary, self.path)

  def discard(self) -> None:
    """Stop without a file. Where writing failed, so may this, which is no news to anybody."""
    opened, self._open = self._open, None
    if opened is not None:
      with contextlib.suppress(OSError):
        opened[0].close()
    with contextlib.suppress(OSError):
      self._temporary.unlink(missing_ok=True)


class BackgroundVideo:
  """Renders and encodes snapshots in a thread of its own, so that whoever steps the worlds does not wait.

  Where rendering fails, `error` says why and nothing is raised: a film is never worth a training. If it cannot keep up,
  `add` waits when `wait` is set, and else leaves frames out and counts them in `num_dropped`.

  Args:
    path: The mp4 to write.
    fps: Frames per second.
    model: The simulation's model; copied.
    cfg: What pictures look like.
    wait: Whether `add` waits for room.
    on_error: Called in the thread with the first error.
  """

  def __init__(
    self,
    path: str | os.PathLike[str],
    fps: float,
    model: mujoco.MjModel,
    cfg: PictureCfg | None = None,
    *,
    wait: bool = False,
    on_error: Callable[[Exception], None] | None = None,
  ) -> None:
    self.file = VideoFile(path, fps)
    self.error: Exception | None = None
    self.num_dropped = 0
    self._is_finished = False
    self._wait = wait
    self._on_error = on_error
    self._queue: queue.Queue[Snapshot | None] = queue.Queue(maxsize=32)
    self._thread = threading.Thread(target=self._run, args=(model, cfg), name="video", daemon=True)
    self._thread.start()

  def add(self, snapshot: Snapshot) -> None:
    """Hand a frame over."""
    if self.error is not None:
      return
    if self._wait:
      self._queue.put(snapshot)
      return
    try:
      self._queue.put_nowait(snapshot)
    except queue.Full:
      self.num_dropped += 1

  def finish(self) -> None:
    """No frame comes any more; the file is finished in the background."""
    if not self._is_finished:
      self._is_finished = True
      self._queue.put(None)

  def close(self) -> Path | None:
    """Wait for the frames handed over and finish the file; returns its path, None where there is none."""
    self.finish()
    self._thread.join()
    return self.file.path if self.error is None and self.file.num_frames else None

  def _run(self, model: mujoco.MjModel, cfg: PictureCfg | None) -> None:
    is_over = False
    try:
      with OffscreenRenderer(model, cfg) as renderer:
        while (snapshot := self._queue.get()) is not None:
          self.file.add(renderer.render(snapshot))
      is_over = True
      self.file.close()
    except Exception as error:
      self.error = error
      self.file.discard()
      if self._on_error is not None:
        self._on_error(error)
      # Whoever waits for room must not wait for ever.
      while not is_over and self._queue.get() is not None:
        pass


def check_video_path(path: str | os.PathLike[str]) -> Path:
  """The path of a video.

  Raises:
    ViewerError: it does not end in .mp4, or is a folder.
  """
  path = Path(path)
  if path.suffix.lower() != ".mp4":
    raise ViewerError(f"video '{path}': films are written as .mp4")
  if path.is_dir():
    raise ViewerError(f"video '{path}': is a folder")
  return path
