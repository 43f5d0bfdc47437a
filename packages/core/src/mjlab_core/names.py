"""Selection of names by patterns, and messages about names that do not exist.

A pattern is a regular expression that must match a whole name (`re.fullmatch`). Each pattern matches at least one name,
and each name matches at most one pattern; otherwise `UnknownNameError` lists the existing names.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, TypeVar, cast

from mjlab_core.errors import UnknownNameError

T = TypeVar("T")


class _Required:
  """Type of the mark for "no default was given"."""


_REQUIRED: Final = _Required()
_MAX_LISTED: Final = 60
EVERY: Final = ".*"
"""Pattern that matches every name."""


def match_names(
  patterns: str | Sequence[str], names: Sequence[str], *, what: str, owner: str = "", preserve_order: bool = False
) -> tuple[list[int], list[str]]:
  """Return indices and names selected by `patterns`, in the order of `names`, or of `patterns` if `preserve_order`.

  Messages call the names `what`, such as "joint", and their owner `owner`, such as "entity 'robot'".

  Raises:
    UnknownNameError: a pattern matches no name, or two patterns match one name.
  """
  pattern_of = _assign([patterns] if isinstance(patterns, str) else patterns, names, what=what, owner=owner)
  picked = list(pattern_of) if preserve_order else sorted(pattern_of)
  return picked, [names[i] for i in picked]


def match_values(
  values: Mapping[str, T], names: Sequence[str], *, what: str, owner: str = ""
) -> tuple[list[int], list[str], list[T]]:
  """Return indices, names and values of the names that a pattern of `values` selects, in the order of `names`.

  The pattern ".*" gives the value of the names that no other pattern matches.

  Raises:
    UnknownNameError: a pattern matches no name, or two patterns other than ".*" match one name.
  """
  pattern_of = _assign([pattern for pattern in values if pattern != EVERY], names, what=what, owner=owner)
  if EVERY in values:
    pattern_of = dict.fromkeys(range(len(names)), EVERY) | pattern_of
  picked = sorted(pattern_of)
  return picked, [names[i] for i in picked], [values[pattern_of[i]] for i in picked]


def match_values_full(
  values: T | Mapping[str, T], names: Sequence[str], *, what: str, owner: str = "", default: T | _Required = _REQUIRED
) -> list[T]:
  """Return one value per name: `values` itself for all, or by pattern, with `default` where no pattern matches.

  Raises:
    UnknownNameError: as `match_values`, or a name is left without a value and there is no default.
  """
  if not isinstance(values, Mapping):
    return [cast(T, values)] * len(names)
  table = cast("Mapping[str, T]", values)
  picked, _, found = match_values(table, names, what=what, owner=owner)
  by_index = dict(zip(picked, found, strict=True))
  left = [name for i, name in enumerate(names) if i not in by_index]
  if left and isinstance(default, _Required):
    raise UnknownNameError(
      f"{_prefix(owner)}no pattern gives a value for {what} {_listing(left)}. Patterns: {_listing(list(table))}."
    )
  return [by_index[i] if i in by_index else cast(T, default) for i in range(len(names))]


def nearest(name: str, candidates: Iterable[str], n: int = 3) -> list[str]:
  """Return up to `n` candidates most like `name`, best first; empty when none is like it."""
  matcher = difflib.SequenceMatcher(b=name.lower())
  scored: list[tuple[float, str]] = []
  for candidate in candidates:
    matcher.set_seq1(candidate.lower())
    if matcher.quick_ratio() >= 0.5 and (ratio := matcher.ratio()) >= 0.5:
      scored.append((ratio, candidate))
  # The sort is stable: equally good candidates keep their order.
  return [candidate for _, candidate in sorted(scored, key=lambda pair: -pair[0])[:n]]


def unknown(what: str, name: str, candidates: Iterable[str], owner: str = "") -> str:
  """Return the message for a name that does not exist: "owner: what 'x' does not exist. Nearest: a, b. All 12: ..."."""
  return f"{_prefix(owner)}{what} {name!r} does not exist. {_offer(name, list(candidates))}"


def check_name(what: str, name: str, candidates: Iterable[str], owner: str = "") -> str:
  """Return `name`.

  Raises:
    UnknownNameError: it is not one of `candidates`.
  """
  candidates = list(candidates)
  if name not in candidates:
    raise UnknownNameError(unknown(what, name, candidates, owner))
  return name


def _assign(patterns: Sequence[str], names: Sequence[str], *, what: str, owner: str) -> dict[int, str]:
  """Return the pattern that selects each name, by the index of the name, in the order of the patterns."""
  pattern_of: dict[int, str] = {}
  for pattern in patterns:
    try:
      matches = re.compile(pattern).fullmatch
    except re.error as error:
      raise UnknownNameError(f"{_prefix(owner)}pattern {pattern!r} is not a regular expression: {error}.") from error
    matched = [i for i, name in enumerate(names) if matches(name)]
    if not matched:
      raise UnknownNameError(f"{_prefix(owner)}pattern {pattern!r} matches no {what}. {_offer(pattern, names)}")
    for i in matched:
      if i in pattern_of:
        raise UnknownNameError(
          f"{_prefix(owner)}{what} {names[i]!r} is matched by two patterns, {pattern_of[i]!r} and {pattern!r}; "
          f"each name may match one. {_all(names)}"
        )
      pattern_of[i] = pattern
  return pattern_of


def _prefix(owner: str) -> str:
  return f"{owner}: " if owner else ""


def _offer(name: str, candidates: Sequence[str]) -> str:
  # Without quantifiers and anchors, a pattern often resembles the intended name.
  close = nearest(re.sub(r"[\\^$.*+?()\[\]{}|]+", "", name) or name, candidates)
  return (f"Nearest: {', '.join(close)}. " if close else "") + _all(candidates)


def _all(candidates: Sequence[str]) -> str:
  return f"All {len(candidates)}: {_listing(candidates)}." if candidates else "There are none."


def _listing(names: Sequence[str]) -> str:
  shown = ", ".join(names[:_MAX_LISTED])
  return shown if len(names) <= _MAX_LISTED else f"{shown}, and {len(names) - _MAX_LISTED} more"
