"""Counts in a config: what is no whole number would be truncated, or refused in words of torch or MuJoCo."""

from __future__ import annotations

from numbers import Integral


def why_no_count(value: object, least: int = 0) -> str:
  """What is wrong with a count, to follow its name: "must be a whole number, got 2.5". Empty if nothing is."""
  if isinstance(value, bool) or not isinstance(value, Integral):
    return f"must be a whole number, got {value!r}"
  return "" if int(value) >= least else f"must be at least {least}, got {value}"
