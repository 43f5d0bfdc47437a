"""Batched MuJoCo worlds seen in a browser, in a window, and in videos.

Every public name is importable from here. The imports are lazy: rendering pictures needs no browser library, and
nothing here needs a screen until it is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

if TYPE_CHECKING:
  from mjlab_viewer.address import check_address
  from mjlab_viewer.browser import BrowserViewer
  from mjlab_viewer.camera import Camera, CameraCfg
  from mjlab_viewer.checkpoint_list import CheckpointList
  from mjlab_viewer.draw_list import DrawList
  from mjlab_viewer.errors import RenderingError, ViewerError
  from mjlab_viewer.native import NativeViewer
  from mjlab_viewer.offscreen import OffscreenRenderer, PictureCfg
  from mjlab_viewer.playback import SPEEDS, Playback, RandomPolicy, ZeroPolicy
  from mjlab_viewer.replay import Replay
  from mjlab_viewer.snapshot import Snapshot, SnapshotTaker
  from mjlab_viewer.training_video import TrainingVideo
  from mjlab_viewer.video import BackgroundVideo, VideoFile
  from mjlab_viewer.worlds import PlayedEnv, Policy, Steering, ViewedEnv, ViewedSim

__all__ = [
  "SPEEDS",
  "BackgroundVideo",
  "BrowserViewer",
  "Camera",
  "CameraCfg",
  "CheckpointList",
  "DrawList",
  "NativeViewer",
  "OffscreenRenderer",
  "PictureCfg",
  "Playback",
  "PlayedEnv",
  "Policy",
  "RandomPolicy",
  "RenderingError",
  "Replay",
  "Snapshot",
  "SnapshotTaker",
  "Steering",
  "TrainingVideo",
  "VideoFile",
  "ViewedEnv",
  "ViewedSim",
  "ViewerError",
  "ZeroPolicy",
  "check_address",
]

__getattr__, __dir__ = lazy_exports(
  __name__,
  {
    ".address": "check_address",
    ".browser": "BrowserViewer",
    ".camera": "Camera CameraCfg",
    ".checkpoint_list": "CheckpointList",
    ".draw_list": "DrawList",
    ".errors": "RenderingError ViewerError",
    ".native": "NativeViewer",
    ".offscreen": "OffscreenRenderer PictureCfg",
    ".playback": "SPEEDS Playback RandomPolicy ZeroPolicy",
    ".replay": "Replay",
    ".snapshot": "Snapshot SnapshotTaker",
    ".training_video": "TrainingVideo",
    ".video": "BackgroundVideo VideoFile",
    ".worlds": "PlayedEnv Policy Steering ViewedEnv ViewedSim",
  },
)
