"""A place to render to without a screen."""

from __future__ import annotations

import contextlib
import ctypes.util
import importlib
import os
import sys
from typing import Any

from mjlab_viewer.errors import RenderingError

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}


def make_context(width: int, height: int) -> Any:
  """An OpenGL context of MuJoCo's, current in this thread.

  MUJOCO_GL says which (egl, osmesa or glfw); without it the first that works is taken. A context belongs to the thread
  that made it.

  Raises:
    RenderingError: there is none; one line that says what was tried and what helps.
  """
  chosen = os.environ.get("MUJOCO_GL", "").lower().strip()
  if chosen in ("disable", "disabled", "off", "false", "0"):
    raise RenderingError(f"no pictures: MUJOCO_GL={chosen} switches OpenGL off")
  if sys.platform != "linux":
    candidates = ["cgl" if sys.platform == "darwin" else "glfw"]
  elif chosen in ("egl", "osmesa", "glfw"):
    candidates = [chosen]
  else:
    # PyOpenGL takes the first library that it is pointed at for good, so one that is not there must not be tried.
    candidates = [name for name, library in _LIBRARIES.items() if ctypes.util.find_library(library)]
    candidates += ["glfw"] if os.environ.get("DISPLAY") else []
  _load_triton()
  failures: list[str] = []
  for name in candidates:
    try:
      context = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
      context.make_current()
    except Exception as error:
      # Whatever a missing driver makes PyOpenGL raise: AttributeError, ImportError, its own errors.
      failures.append(f"{name}: {' '.join(str(error).split())[:100] or type(error).__name__}")
    else:
      return context
  tried = "; ".join(failures) or "neither EGL nor OSMesa is installed"
  raise RenderingError(
    f"no pictures, OpenGL does not work here ({tried}). On Debian: apt install libegl1 libgl1-mesa-dri"
  )


def _load_triton() -> None:
  # Software OpenGL and torch's compiler both bring an LLVM. OpenGL's is seen by the whole process, and a Triton that is
  # loaded after it crashes; the other way round both work.
  with contextlib.suppress(ImportError):
    importlib.import_module("triton._C.libtriton")
