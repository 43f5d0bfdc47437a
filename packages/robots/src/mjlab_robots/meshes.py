"""Folders of visual meshes. Physics needs no mesh."""

import sys
import tarfile
from collections.abc import Collection
from pathlib import Path
from typing import Literal, get_args

from mjlab_core.errors import FileError
from mjlab_core.names import check_name

MeshMode = Literal["auto", "never", "require", "download"]
"""Source of drawn geoms: meshes if they are on this machine, primitives, meshes or an error, downloaded meshes."""


def find_meshes(robot: str, files: Collection[str], mode: MeshMode = "auto") -> Path | None:
  """Return the folder with all `files` of a MuJoCo Menagerie robot, or None. Only mode "download" uses the network.

  Look below the environment variable MENAGERIE_ROOT if it is set, else in the cache of `mujoco_menagerie`.

  Args:
    robot: Name in Menagerie, such as "unitree_go1".
    files: Names of all files that are needed.
    mode: "auto" returns None if a file is missing, "never" always.

  Raises:
    FileError: A file is missing with mode "require", or a download fails; the message names ways to get the files.
    UnknownNameError: `mode` does not exist.
  """
  check_name("mode of meshes", mode, get_args(MeshMode))
  if mode == "never":
    return None
  folder = _folder(robot)
  if folder is None and mode == "download":
    folder = download_meshes(robot)
  missing = [file for file in files if folder is None or not (folder / file).is_file()]
  if not missing:
    return folder
  if mode == "auto":
    return None
  where = f"{len(missing)} of {len(files)} are missing in {folder}" if folder else "none is on this machine"
  raise FileError(f"meshes of {robot!r}: {where}. {_way_out(robot)}")


def download_meshes(robot: str) -> Path:
  """Fetch a MuJoCo Menagerie robot into the cache of `mujoco_menagerie`, unless it is there.

  A terminal shows a progress bar. If MENAGERIE_ROOT is set, that folder is used and nothing is fetched.

  Args:
    robot: Name in Menagerie, such as "unitree_go1".

  Returns:
    Folder with its mesh files.

  Raises:
    FileError: The download failed, does not match its digest, or cannot be unpacked; the message says what to do.
    mujoco_menagerie.UnknownRobotError: Menagerie has no such robot.
  """
  import mujoco_menagerie

  entry, cache = mujoco_menagerie.get(robot), mujoco_menagerie.Cache()
  if cache.root is None and not cache.is_cached(entry):
    if not hasattr(tarfile, "data_filter"):
      raise FileError(f"meshes of {robot!r}: Python before 3.11.4 cannot unpack archives safely. {_way_out(robot)}")
    size = f"{(entry.download_size or 0) / 2**20:.1f} MB"
    print(f"fetching the meshes of {robot}, {size}, from {cache.base_url} into {cache.dir}", file=sys.stderr)
  try:
    return entry.path(cache) / "assets"
  except (mujoco_menagerie.MenagerieError, OSError) as error:
    raise FileError(f"meshes of {robot!r} could not be fetched: {error}. {_way_out(robot)}") from error


def _way_out(robot: str) -> str:
  return (
    f"With a network, `python -c \"import mjlab_robots; mjlab_robots.download_meshes('{robot}')\"` fetches them; "
    f"without, set MENAGERIE_ROOT to a folder that contains {robot}/assets; no other folder is then searched. "
    "Physics needs no meshes: meshes='auto' draws primitives without them"
  )


def _folder(robot: str) -> Path | None:
  # Imported here because it reads a registry, which physics does not need.
  import mujoco_menagerie

  cache = mujoco_menagerie.Cache()
  if cache.root is not None:
    return cache.root / robot / "assets"
  entry = mujoco_menagerie.get(robot)
  return cache.model_path(entry) / "assets" if cache.is_cached(entry) else None
