"""Viewers that run until Ctrl-C, and viewer and films of a training."""

import contextlib
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mjlab_viewer
from mjlab_rl import Console, IterationReport
from mjlab_rl.reports.console import duration

from mjlab.cli.shared._progress import imported

if TYPE_CHECKING:
  from mjlab_viewer.browser.training_panel import TrainingPanel


def browse(playback: "mjlab_viewer.Playback", *, host: str, port: int, label: str, **options: Any) -> int:
  """Show an environment in the browser until Ctrl-C; return the exit code.

  Raises:
    MjlabError: The address or port is not available.
  """
  with imported("mjlab_viewer.browser.viewer").BrowserViewer(
    playback.env, playback=playback, host=host, port=port, label=label, **options
  ) as viewer:
    print(f"open {viewer.url} (Ctrl-C ends)", flush=True)
    return until_interrupted(viewer.run)


def browse_replay(replay: "mjlab_viewer.Replay", speed: float = 1.0, **page: Any) -> int:
  """Play a replay in the browser again and again until Ctrl-C; `page` as for `browse`. Return the exit code."""
  playback = mjlab_viewer.Playback(replay, mjlab_viewer.ZeroPolicy(replay.num_envs, 0, replay.sim.device))
  playback.speed = speed
  return browse(playback, **page)


def until_interrupted(run: Callable[[], None]) -> int:
  """Run a viewer until it ends or Ctrl-C; return the exit code."""
  try:
    run()
  except KeyboardInterrupt:
    print()
  return 0


def watch(
  wanted: Any, name: str, console: "Console", opened: contextlib.ExitStack, env: Any, directory: Path | None
) -> Callable[[], None]:
  """Open viewer and films of a training as the flags of `train` request; return the function to call after a step.

  Closing is left to `opened`.
  """
  look = getattr(env.cfg, "viewer", None)
  calls: list[Callable[[], None]] = []
  if wanted.viewer:
    viewer = mjlab_viewer.BrowserViewer(
      env,
      host=wanted.viewer_host,
      port=wanted.viewer_port,
      camera=None if look is None else look.camera(),
      label=name,
      # As by a scheduler: the training saves after the iteration.
      on_stop=lambda: os.kill(os.getpid(), signal.SIGTERM),
    )
    opened.callback(viewer.close)
    print(f"watch at {viewer.url}", flush=True)
    if (panel := viewer.training) is not None:
      console.on_report.append(lambda report: _show_on_page(panel, report))
    calls.append(viewer.update)
  if wanted.video and directory is not None:
    interval, length = wanted.video_interval, wanted.video_length
    picture = None if look is None else look.picture()
    video = mjlab_viewer.TrainingVideo(env, directory / "videos", interval=interval, length=length, cfg=picture)
    opened.callback(video.close)
    calls.append(video.after_step)

  def after_step() -> None:
    for call in calls:
      call()

  return after_step


def _show_on_page(panel: "TrainingPanel", report: "IterationReport") -> None:
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
