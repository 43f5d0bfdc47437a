"""The example in the README runs."""

import re
from pathlib import Path


def test_the_readme_example_runs() -> None:
  readme = (Path(__file__).parents[1] / "README.md").read_text()
  for example in re.findall(r"```python\n(.*?)```", readme, re.S):
    exec(compile(example, "README.md", "exec"), {})
