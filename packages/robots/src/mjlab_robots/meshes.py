"""Where visual meshes are, if they are on this machine at all. Physics never needs one."""

import os
from collections.abc import Collection
from pathlib import Path
from typing import Literal

MeshMode = Literal["auto", "never", "require"]
"""Meshes if they are found, primitives always, or an error without meshes."""


class MeshesNotFoundError(FileNotFoundError):
  """Meshes are required and are not on this machine."""


def find_meshes(robot: str, files: Collection[str], mode: MeshMode = "auto") -> Path | None:
  """Folder that holds all `files` of a MuJoCo Menagerie robot, or None; nothing is ever downloaded.

  Looks under the environment variable MENAGERIE_ROOT where that is set, else in the cache of `mujoco_menagerie`.

  Args:
    robot: Name in Menagerie, such as "unitree_go1".
    files: File names that must all be there.
    mode: "never" returns None without looking.

  Raises:
    MeshesNotFoundError: `mode` is "require" and they are not there; the message says how to get them.
    ValueError: `mode` is none of the three.
  """
  if mode not in ("auto", "never", "require"):
    raise ValueError(f"meshes is {mode!r}; it must be 'auto', 'never' or 'require'")
  if mode == "never":
    return None
  folder = _folder(robot)
  if folder is not None and all((folder / file).is_file() for file in files):
    return folder
  if mode == "require":
    raise MeshesNotFoundError(
      f"the meshes of {robot!r} are not {'in ' + str(folder) if folder else 'on this machine'}. Fetch them with "
      f"`python -c \"import mujoco_menagerie; mujoco_menagerie.prefetch(['{robot}'])\"`, or set MENAGERIE_ROOT to a "
      f"folder that holds {robot}/assets"
    )
  return None


def _folder(robot: str) -> Path | None:
  root = os.environ.get("MENAGERIE_ROOT")
  if root:
    return Path(root) / robot / "assets"
  # Imported here: a registry is read at import, and physics alone has no use for it.
  import mujoco_menagerie

  cache = mujoco_menagerie.Cache()
  entry = mujoco_menagerie.get(robot)
  return cache.model_path(entry) / "assets" if cache.is_cached(entry) else None
