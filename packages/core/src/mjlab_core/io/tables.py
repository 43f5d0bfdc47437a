"""Plain-text tables."""

from collections.abc import Iterable, Sequence


def table(head: Sequence[object], rows: Iterable[Sequence[object]], *, title: str = "") -> str:
  """Return rows below a head, with aligned columns; with a title, one line that counts none if there are no rows."""
  lines = [[str(cell) for cell in line] for line in (head, *rows)]
  if title and len(lines) == 1:
    return f"{title}: none"
  widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
  text = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines]
  return "\n".join([title, *(f"  {line}" for line in text)] if title else text)
