"""Viewers for batched MuJoCo worlds: a browser page, a window, pictures and films.

Every public name is importable from here. The imports are lazy: rendering pictures needs no browser library, and a
screen is needed only by the window.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

if TYPE_CHECKING:
  from mjlab_core.policies import Policy, RandomPolicy, ZeroPolicy

  from mjlab_viewer.browser.address import check_address
  from mjlab_viewer.browser.viewer import BrowserViewer
  from mjlab_viewer.camera import Camera, CameraCfg
  from mjlab_viewer.drawing.draw_list import DrawList
  from mjlab_viewer.env import ViewedEnv
  from mjlab_viewer.native.viewer import NativeViewer
  from mjlab_viewer.pictures.offscreen import OffscreenRenderer, PictureCfg
  from mjlab_viewer.pictures.training_video import TrainingVideo
  from mjlab_viewer.pictures.video import BackgroundVideo, VideoFile
  from mjlab_viewer.playback import SPEEDS, CheckpointList, Playback
  from mjlab_viewer.replay import Replay
  from mjlab_viewer.snapshot import Snapshot, SnapshotTaker

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
  "Policy",
  "RandomPolicy",
  "Replay",
  "Snapshot",
  "SnapshotTaker",
  "TrainingVideo",
  "VideoFile",
  "ViewedEnv",
  "ZeroPolicy",
  "check_address",
]

__getattr__, __dir__ = lazy_exports(
  __name__,
  {
    ".browser.address": "check_address",
    ".browser.viewer": "BrowserViewer",
    ".camera": "Camera CameraCfg",
    ".drawing.draw_list": "DrawList",
    ".env": "ViewedEnv",
    ".native.viewer": "NativeViewer",
    ".pictures.offscreen": "OffscreenRenderer PictureCfg",
    ".pictures.training_video": "TrainingVideo",
    ".pictures.video": "BackgroundVideo VideoFile",
    ".playback": "SPEEDS CheckpointList Playback",
    "mjlab_core.policies": "Policy RandomPolicy ZeroPolicy",
    ".replay": "Replay",
    ".snapshot": "Snapshot SnapshotTaker",
  },
)
