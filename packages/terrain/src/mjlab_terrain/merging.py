"""Fewer boxes for the same ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def merge_boxes(
  low: NDArray[np.float64], high: NDArray[np.float64], kind: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
  """Joins upright boxes of one kind that share a whole side and the same top and bottom, first along x, then along y.

  Args:
    low: Lowest corner of each box, (n, 3) [m].
    high: Highest corner of each box, (n, 3) [m].
    kind: Boxes of different kinds stay apart, (n,).

  Returns:
    The same three for the boxes that remain; together they fill the same space.
  """
  for axis in (0, 1):
    other = 1 - axis
    # Corners of neighbouring tiles agree but for rounding.
    keys = np.round(np.column_stack((low[:, other], high[:, other], low[:, 2], high[:, 2])) * 1e6).astype(np.int64)
    start, end = np.round(low[:, axis] * 1e6).astype(np.int64), np.round(high[:, axis] * 1e6).astype(np.int64)
    order = np.lexsort((start, *keys.T, kind))
    same = (keys[order][1:] == keys[order][:-1]).all(1) & (kind[order][1:] == kind[order][:-1])
    new_run = np.concatenate(([True], ~(same & (start[order][1:] == end[order][:-1]))))
    first = np.flatnonzero(new_run)
    last = np.concatenate((first[1:], [len(order)])) - 1
    merged = high[order][first]
    merged[:, axis] = high[order][last, axis]
    low, high, kind = low[order][first], merged, kind[order][first]
  return low, high, kind
