"""`play TASK [flags]`: watch a policy."""

import math
import os
from dataclasses import dataclass, replace
from typing import Any, Literal

import mjlab_rl
import mjlab_viewer
from mjlab_core import MjlabError, UsageError
from mjlab_core.constraints import Positive, PositiveCount
from mjlab_rl import checkpoints

from mjlab import environments
from mjlab.cli.shared._command_line import CommandLine, PageArguments, TaskArguments, TaskLine, output_file
from mjlab.cli.shared._policies import FoundPolicy, PolicyArguments, find_policy
from mjlab.cli.shared._watching import browse, until_interrupted

_NUM_ENVS = {"browser": 8, "native": 1, "none": 1}
_MOST_TILES = 16
_MOST_FPS = 30.0
"""A film of a faster policy shows every second step, or fewer: without a GPU, drawing takes most of the time."""


@dataclass(kw_only=True)
class Arguments(PolicyArguments, PageArguments, TaskArguments):
  """All that can be given after the task."""

  viewer: Literal["auto", "native", "browser", "none"] = "auto"
  """Native window or browser; auto: a window if there is a screen."""
  video: str | None = None
  """Film to write instead of showing a viewer: FILE.mp4."""
  video_length: Positive = 10.0
  """Length of the film [s]."""
  video_width: PositiveCount = 640
  """Width of the film [px]."""
  video_height: PositiveCount = 480
  """Height of the film [px]."""
  force: bool = False
  """Overwrite the film."""
  num_envs: int | None = None
  """Number of environments; None: 8 in a browser, else 1."""
  seed: int | None = None
  """Seed of the environments; None: a random one."""
  speed: Positive = 1.0
  """Simulated seconds per real second."""
  no_terminations: bool = False
  """Ignore all terminations except time-outs."""
  camera_body: str | None = None
  """Body that the camera follows, such as robot/trunk; None: the first that can move."""


@CommandLine("play", "TASK", Arguments)
def run(wanted: Arguments, line: TaskLine) -> int:
  """Show a policy in a browser, in a native window or as a film."""
  viewer = _viewer(wanted)
  if wanted.video is not None:
    output_file("--video", wanted.video, ".mp4", force=wanted.force)
  device = environments.resolve_device(wanted.device)
  found = find_policy(wanted, line)
  cfg = environments.for_watching(found.parts)
  cfg.scene.num_envs = _NUM_ENVS[viewer] if wanted.num_envs is None else wanted.num_envs
  cfg.seed = wanted.seed
  # Again, with the configuration of the run as the default.
  cfg = line.parse(env=cfg).env
  if wanted.no_terminations:
    kept = {name: term if term is not None and term.time_out else None for name, term in cfg.terminations.items()}
    cfg.terminations = kept
  count = cfg.scene.num_envs
  print(f"{line.name}: {found}, {count} environment{'s' * (count != 1)} on {device}", flush=True)
  with found.acting(cfg, device) as (env, policy):
    policy, checkpoints = _guarded(found, policy)
    if wanted.video is not None:
      return _film(wanted, env, policy)
    playback = mjlab_viewer.Playback(env, policy)
    playback.speed = wanted.speed
    return (_native if viewer == "native" else _browser)(wanted, line.name, playback, checkpoints)


def _viewer(wanted: Arguments) -> str:
  if wanted.video is not None:
    return "none"
  if wanted.viewer == "none":
    raise UsageError("--viewer none shows nothing; add --video FILE.mp4")
  if wanted.viewer == "auto":
    return "native" if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") else "browser"
  return wanted.viewer


def _guarded(found: FoundPolicy, policy: Any) -> "tuple[mjlab_viewer.Policy, mjlab_viewer.CheckpointList | None]":
  """Return a trained policy with a warning about actions that are not finite, and the checkpoints of its run."""
  source = found.source
  if source is None:
    return policy, None
  text = "warning: actions of the policy are NaN or infinite, which the environment takes for zero"
  finite = mjlab_rl.FinitePolicy(policy, lambda: print(text, flush=True))
  if source.suffix != ".pt":
    return finite, None

  def load(name: str) -> "mjlab_viewer.Policy":
    policy.load(source.parent / name)
    return finite

  def names() -> list[str]:
    return [path.name for path in checkpoints(source.parent)]

  return finite, mjlab_viewer.CheckpointList(names=names, load=load, loaded=source.name)


def _camera(wanted: Arguments, env: Any) -> "mjlab_viewer.CameraCfg":
  """Return the camera of the environment's config, on the body of the command line if that names one."""
  viewer = getattr(env.cfg, "viewer", None)
  camera = mjlab_viewer.CameraCfg() if viewer is None else viewer.camera()
  return camera if wanted.camera_body is None else replace(camera, body=wanted.camera_body, lookat=None)


def _film(wanted: Arguments, env: Any, policy: "mjlab_viewer.Policy") -> int:
  assert wanted.video is not None
  steps = math.ceil(1.0 / (_MOST_FPS * env.step_dt) - 1e-6)
  frame_dt = steps * env.step_dt
  frames = max(1, round(wanted.video_length / frame_dt))
  picture = mjlab_viewer.PictureCfg(width=wanted.video_width, height=wanted.video_height, camera=_camera(wanted, env))
  worlds = range(min(env.num_envs, _MOST_TILES))
  playback = mjlab_viewer.Playback(env, policy)
  playback.pause()
  taker = mjlab_viewer.SnapshotTaker(env)
  video = mjlab_viewer.BackgroundVideo(wanted.video, 1.0 / frame_dt, env.sim.mj_model, picture)
  try:
    for frame in range(frames):
      for _ in range(steps if frame else 0):
        if playback.error is None:
          playback.step_once()
      if playback.error is not None or video.error is not None:
        break
      video.add(taker.take(worlds, drawers=env.default_drawers(), apart=True))
      if frame % 50 == 49:
        print(f"{(frame + 1) * frame_dt:.0f} of {frames * frame_dt:.0f} s", flush=True)
  except KeyboardInterrupt:
    if (path := video.close()) is not None:
      print(f"the film of {playback.step_count} steps up to here is {path}")
    raise
  finally:
    path = video.close()
  if video.error is not None:
    raise video.error
  if playback.error is not None:
    raise MjlabError(f"{playback.error}; the film of {playback.step_count} steps up to here is {path}")
  print(f"wrote {path}")
  return 0


def _browser(
  wanted: Arguments, name: str, playback: "mjlab_viewer.Playback", checkpoints: "mjlab_viewer.CheckpointList | None"
) -> int:
  camera = _camera(wanted, playback.env)
  return browse(playback, host=wanted.host, port=wanted.port, label=name, checkpoints=checkpoints, camera=camera)


def _native(
  wanted: Arguments, name: str, playback: "mjlab_viewer.Playback", checkpoints: "mjlab_viewer.CheckpointList | None"
) -> int:
  from mjlab_viewer.native.viewer import KEYS

  del name, checkpoints
  with mjlab_viewer.NativeViewer(playback, camera=_camera(wanted, playback.env)) as viewer:
    print("keys of the window, besides those of MuJoCo (F1):")
    for key, action in KEYS.items():
      print(f"  {'SPACE' if key == ' ' else key:5}  {action}", flush=True)
    return until_interrupted(viewer.run)
