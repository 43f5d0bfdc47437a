"""Batched MuJoCo worlds seen in a browser, in a window, and in videos.

Every public name is importable from here. The imports are lazy: rendering pictures needs no browser library, and
nothing here needs a screen until it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
  from mjlab_viewer.browser import BrowserViewer
  from mjlab_viewer.camera import Camera, CameraCfg
  from mjlab_viewer.checkpoint_list import CheckpointList
  from mjlab_viewer.draw_list import DrawList
  from mjlab_viewer.errors import RenderingError, ViewerError
  from mjlab_viewer.native import NativeViewer
  from mjlab_viewer.offscreen import OffscreenRenderer, PictureCfg
  from mjlab_viewer.playback import SPEEDS, Playback, RandomPolicy, ZeroPolicy
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
  "Snapshot",
  "SnapshotTaker",
  "Steering",
  "TrainingVideo",
  "VideoFile",
  "ViewedEnv",
  "ViewedSim",
  "ViewerError",
  "ZeroPolicy",
]

_MODULES = {
  "browser": "BrowserViewer",
  "camera": "Camera CameraCfg",
  "checkpoint_list": "CheckpointList",
  "draw_list": "DrawList",
  "errors": "RenderingError ViewerError",
  "native": "NativeViewer",
  "offscreen": "OffscreenRenderer PictureCfg",
  "playback": "SPEEDS Playback RandomPolicy ZeroPolicy",
  "snapshot": "Snapshot SnapshotTaker",
  "training_video": "TrainingVideo",
  "video": "BackgroundVideo VideoFile",
  "worlds": "PlayedEnv Policy Steering ViewedEnv ViewedSim",
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names.split()}


def __getattr__(name: str) -> object:
  if name not in _HOMES:
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
  return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
  return sorted(__all__)
