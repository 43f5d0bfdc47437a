"""OpenGL without a screen."""

from __future__ import annotations

import contextlib
import ctypes.util
import importlib
import os
import sys
from typing import Any

from mjlab_core import RenderingError

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}


def make_context(width: int, height: int) -> Any:
  """Return an OpenGL context of MuJoCo, current in this thread; use it only in this thread.

  The environment variable MUJOCO_GL chooses egl, osmesa or glfw. The default is the first that works.

  Raises:
    RenderingError: None works; the message is one line with the attempts and a remedy.
  """
  chosen = os.environ.get("MUJOCO_GL", "").lower().strip()
  if chosen in ("disable", "disabled", "off", "false", "0"):
    raise RenderingError(f"no pictures: MUJOCO_GL={chosen} switches OpenGL off")
  if sys.platform != "linux":
    candidates = ["cgl" if sys.platform == "darwin" else "glfw"]
  elif chosen in ("egl", "osmesa", "glfw"):
    candidates = [chosen]
  else:
    # PyOpenGL keeps the first library that it tries, so a missing one must not be tried.
    candidates = [name for name, library in _LIBRARIES.items() if ctypes.util.find_library(library)]
    candidates += ["glfw"] if os.environ.get("DISPLAY") else []
  _load_triton()
  failures: list[str] = []
  for name in candidates:
    try:
      context = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
      context.make_current()
    except Exception as error:
      # A missing driver makes PyOpenGL raise AttributeError, ImportError or its own errors.
      failures.append(f"{name}: {' '.join(str(error).split())[:100] or type(error).__name__}")
    else:
      return context
  tried = "; ".join(failures) or "neither EGL nor OSMesa is installed"
  raise RenderingError(
    f"no pictures: OpenGL fails on this machine ({tried}); on Debian, install libegl1 libgl1-mesa-dri"
  )


def _load_triton() -> None:
  # Software OpenGL and torch's compiler both bring an LLVM. OpenGL's is visible to the whole process, and a Triton that
  # is loaded after it crashes; in the other order both work.
  with contextlib.suppress(ImportError):
    importlib.import_module("triton")
