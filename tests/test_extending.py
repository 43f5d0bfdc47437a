"""The program of docs/extending.md runs."""

import re
from pathlib import Path

GUIDE = Path(__file__).parents[1] / "docs" / "extending.md"


def test_the_blocks_of_the_page_are_one_program() -> None:
  blocks = re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
  names: dict[str, object] = {"__name__": "extending"}
  exec(compile("\n".join(blocks), str(GUIDE), "exec"), names)
  evaluation = names["evaluation"]
  near = evaluation.groups["all"]["near"]  # type: ignore
  assert 0.0 <= near.mean <= 1.0
