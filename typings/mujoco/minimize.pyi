import enum
from collections.abc import Callable, Sequence
from typing import TextIO

import numpy as np

class Verbosity(enum.Enum):
  SILENT = 0

class IterLog:
  candidate: np.ndarray
  objective: np.float64

def least_squares(
  x0: np.ndarray,
  residual: Callable[[np.ndarray], np.ndarray],
  bounds: Sequence[np.ndarray] | None = ...,
  *,
  eps: float = ...,
  mu_min: float = ...,
  mu_factor: float = ...,
  xtol: float = ...,
  gtol: float = ...,
  max_iter: int = ...,
  verbose: Verbosity | int = ...,
  output: TextIO | None = ...,
  iter_callback: Callable[[list[IterLog]], None] | None = ...,
) -> tuple[np.ndarray, list[IterLog]]: ...
