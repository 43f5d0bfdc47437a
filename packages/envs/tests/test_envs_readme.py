"""The example in the README runs."""

import re
from pathlib import Path


def test_the_readme_example_of_the_environment_runs() -> None:
  readme = (Path(__file__).parents[1] / "README.md").read_text()
  examples = re.findall(r"```python\n(.*?)```", readme, re.S)
  assert examples
  for example in examples:
    exec(compile(example, "README.md", "exec"), {})
