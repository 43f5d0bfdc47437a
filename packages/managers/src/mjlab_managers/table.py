"""Plain-text tables for `describe()`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
  """A title line, a header and one line per row, columns aligned."""
  cells = [[str(cell) for cell in row] for row in rows]
  if not cells:
    return f"{title}: none"
  widths = [max(len(line[i]) for line in [list(columns), *cells]) for i in range(len(columns))]
  lines = [columns, ["-" * width for width in widths], *cells]
  return "\n".join(
    [title, *("  " + "  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip() for line in lines)]
  )
