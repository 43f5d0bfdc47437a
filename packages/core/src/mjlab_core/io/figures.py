"""Figures of matplotlib, which is optional: made without its global state, and written as PNG."""

from __future__ import annotations

import io
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mjlab_core.io.files import AtomicWrite
from mjlab_core.lazy import from_extra


def require_matplotlib(package: str) -> Any:
  """Return matplotlib.

  Args:
    package: Distribution that has it in its extra `plot`.

  Raises:
    ModuleNotFoundError: It is not installed; the message says how to get it.
  """
  with from_extra("plot", package, "a plot"):
    import matplotlib as mpl
    import matplotlib.figure
  return mpl


@contextmanager
def figure(
  target: str | Path | io.BytesIO, size: tuple[float, float], *, package: str, dpi: int, style: Mapping[str, Any] = {}
) -> Generator[Any]:
  """Yield a new figure, and write it at the end; a file of that name is replaced whole.

  Args:
    target: File, or memory.
    size: Width and height [inches].
    package: As for `require_matplotlib`.
    dpi: Pixels per inch.
    style: Settings of matplotlib (`rcParams`).

  Raises:
    ModuleNotFoundError: matplotlib is not installed; the message says how to get it.
  """
  mpl = require_matplotlib(package)
  with mpl.rc_context(dict(style)):
    made = mpl.figure.Figure(figsize=size, layout="constrained")
    yield made
    if isinstance(target, io.BytesIO):
      made.savefig(target, format="png", dpi=dpi)
    else:
      with AtomicWrite(target) as temporary:
        made.savefig(temporary, format="png", dpi=dpi)
