"""Where visual meshes are, if they are on this machine at all. Physics never needs one."""

import os
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Literal, get_args

MeshMode = Literal["auto", "never", "require", "download"]
"""Meshes if they are found, primitives always, an error without meshes, or a download of those that are missing."""


class MeshesNotFoundError(FileNotFoundError):
  """Meshes are asked for, are not on this machine and cannot be fetched."""


def find_meshes(robot: str, files: Collection[str], mode: MeshMode = "auto") -> Path | None:
  """Folder that holds all `files` of a MuJoCo Menagerie robot, or None; only mode "download" ever touches the network.

  Looks under the environment variable MENAGERIE_ROOT where that is set, else in the cache of `mujoco_menagerie`.

  Args:
    robot: Name in Menagerie, such as "unitree_go1".
    files: File names that must all be there.
    mode: "auto" returns None where a file is missing, "never" without looking.

  Raises:
    MeshesNotFoundError: A file is missing and `mode` is "require", or is "download" and that fails; the message says
      how to get them.
    ValueError: `mode` is none of the four.
  """
  if mode not in get_args(MeshMode):
    raise ValueError(f"meshes is {mode!r}; it must be 'auto', 'never', 'require' or 'download'")
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
  raise MeshesNotFoundError(f"meshes of {robot!r}: {where}. {_way_out(robot)}")


def download_meshes(robot: str) -> Path:
  """Fetch a MuJoCo Menagerie robot into the cache of `mujoco_menagerie`, unless it is there.

  A terminal shows a progress bar. Where MENAGERIE_ROOT is set, that folder is taken instead and nothing is fetched.

  Args:
    robot: Name in Menagerie, such as "unitree_go1".

  Returns:
    Folder that holds its mesh files.

  Raises:
    MeshesNotFoundError: There is no network, or what came is not what was asked for; the message says what to do.
    mujoco_menagerie.UnknownRobotError: Menagerie has no such robot.
  """
  import mujoco_menagerie

  entry, cache = mujoco_menagerie.get(robot), mujoco_menagerie.Cache()
  if cache.root is None and not cache.is_cached(entry):
    size = f"{(entry.download_size or 0) / 2**20:.1f} MB"
    print(f"fetching the meshes of {robot}, {size}, from {cache.base_url} into {cache.dir}", file=sys.stderr)
  try:
    return entry.path(cache) / "assets"
  except (mujoco_menagerie.MenagerieError, OSError) as error:
    raise MeshesNotFoundError(f"meshes of {robot!r} could not be fetched: {error}. {_way_out(robot)}") from error


def _way_out(robot: str) -> str:
  return (
    f"With a network, `python -c \"import mjlab_robots; mjlab_robots.download_meshes('{robot}')\"` fetches them; "
    f"without, set MENAGERIE_ROOT to a folder that holds {robot}/assets (MENAGERIE_ROOT, where set, is all that is "
    "looked at). Physics needs none: meshes='auto' draws the robot from primitives until they are there"
  )


def _folder(robot: str) -> Path | None:
  root = os.environ.get("MENAGERIE_ROOT")
  if root:
    return Path(root) / robot / "assets"
  # Imported here: a registry is read at import, and physics alone has no use for it.
  import mujoco_menagerie

  cache = mujoco_menagerie.Cache()
  entry = mujoco_menagerie.get(robot)
  return cache.model_path(entry) / "assets" if cache.is_cached(entry) else None
