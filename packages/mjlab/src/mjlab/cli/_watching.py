"""Viewers that run until Ctrl-C, and viewer and films of a training."""

import contextlib
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
  from mjlab_rl import Console, IterationReport
  from mjlab_viewer import Playback
  from mjlab_viewer.browser.training_panel import TrainingPanel


def browse(playback: "Playback", *, host: str, port: int, label: str, **options: Any) -> int:
  """Show an environment in the browser until Ctrl-C; return the exit code.

  Raises:
    MjlabError: The address or port is not available.
  """
  from mjlab_viewer import BrowserViewer

  with BrowserViewer(playback.env, playback=playback, host=host, port=port, label=label, **options) as viewer:
    print(f"open {viewer.url} (Ctrl-C ends)", flush=True)
    return until_interrupted(viewer.run)


def until_interrupted(run: Callable[[], None]) -> int:
  """Run a viewer until it ends or Ctrl-C; return the exit code."""
  try:
    run()
  except KeyboardInterrupt:
    print()
  return 0


class Watchers:
  """Viewer and films of a running training, as the flags of `train` ask for them."""

  def __init__(self, wanted: Any, name: str, console: "Console") -> None:
    if wanted.viewer:
      from mjlab_viewer import check_address

      check_address(wanted.viewer_host, wanted.viewer_port)
    self._wanted, self._name, self._console = wanted, name, console
    self._open = contextlib.ExitStack()

  def open(self, env: Any, directory: Path | None) -> Callable[[], None]:
    """Open viewer and films; return the function to call after every step."""
    from mjlab_viewer import BrowserViewer, TrainingVideo

    wanted, look = self._wanted, getattr(env.cfg, "viewer", None)
    calls: list[Callable[[], None]] = []
    if wanted.viewer:
      camera = None if look is None else look.camera()
      viewer = BrowserViewer(
        env,
        host=wanted.viewer_host,
        port=wanted.viewer_port,
        camera=camera,
        label=self._name,
        # As by a scheduler: the training saves after the iteration.
        on_stop=lambda: os.kill(os.getpid(), signal.SIGTERM),
      )
      print(f"watch at {viewer.url}", flush=True)
      if (panel := viewer.training) is not None:
        self._console.on_report.append(lambda report: _show_on_page(panel, report))
      self._open.callback(viewer.close)
      calls.append(viewer.update)
    if wanted.video and directory is not None:
      interval, length = wanted.video_interval, wanted.video_length
      picture = None if look is None else look.picture()
      video = TrainingVideo(env, directory / "videos", interval=interval, length=length, cfg=picture)
      self._open.callback(video.close)
      calls.append(video.after_step)

    def after_step() -> None:
      for call in calls:
        call()

    return after_step

  def close(self) -> None:
    """Close viewer and films."""
    self._open.close()


def _show_on_page(panel: "TrainingPanel", report: "IterationReport") -> None:
  from mjlab_rl.console import duration

  shown = ("Episode_Reward/", "Episode_Metrics/", "Metrics/")
  panel.show(
    iteration=report.iteration + 1,
    end=report.end,
    reward=report.mean_reward,
    episode_length=report.mean_episode_length,
    steps_per_second=report.steps_per_second,
    eta=duration(report.eta),
    terms={tag.partition("/")[2]: value for tag, value in report.scalars.items() if tag.startswith(shown)},
  )
