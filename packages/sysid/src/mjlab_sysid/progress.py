"""File of an unfinished fit, from which another process resumes it."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mjlab_core.errors import FileError
from mjlab_core.io.files import AtomicWrite, reading

_FORMAT, _MAX_BYTES = "mjlab sysid progress 1", 2**24


@dataclass(kw_only=True)
class FitState:
  """Best candidate of a fit so far."""

  x: np.ndarray
  """The candidate, (parameters,), in units of half the bounds."""
  passes: int = 0
  """Passes done of the present stage."""
  reasons: list[str] = field(default_factory=list)
  """Reason for each parameter that is not identifiable, and "" for the others; empty until the first stage ends."""


def fingerprint(*parts: Any) -> str:
  """Return a digest of arrays, and of the texts of other values."""
  digest = hashlib.sha256()
  for part in parts:
    digest.update(part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode())
  return digest.hexdigest()


def save_state(state: FitState, path: Path, key: str) -> None:
  """Write the state of the fit that `key` names; a file of that name is replaced whole."""
  content = {
    "format": _FORMAT,
    "fit": key,
    "x": state.x.tolist(),
    "passes": state.passes,
    "reasons": state.reasons,
  }
  with AtomicWrite(path) as temporary:
    temporary.write_text(json.dumps(content) + "\n", encoding="utf-8")


def load_state(path: Path, key: str, count: int) -> FitState:
  """Return the state of a fit of `count` parameters.

  Raises:
    FileError: The file is missing or damaged, or of another fit.
  """
  with reading("progress", path, _MAX_BYTES):
    content = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
      raise FileError(f"expected an object with format '{_FORMAT}'")
    if content["fit"] != key:
      raise FileError("it is of other records, parameters or settings; fit again without resuming")
    state = FitState(
      x=np.array(content["x"], dtype=np.float64),
      passes=int(content["passes"]),
      reasons=[str(reason) for reason in content["reasons"]],
    )
    if state.x.shape != (count,) or not np.isfinite(state.x).all() or len(state.reasons) not in (0, count):
      raise FileError(f"expected {count} finite numbers")
    return state
