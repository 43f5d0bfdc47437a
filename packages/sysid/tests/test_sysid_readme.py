"""The example of the README runs."""

import re
from pathlib import Path

README = Path(__file__).parents[1] / "README.md"


def test_the_example_runs() -> None:
  blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
  assert blocks
  names: dict[str, object] = {}
  for block in blocks:
    exec(compile(block, str(README), "exec"), names)
