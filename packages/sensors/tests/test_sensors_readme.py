"""The example of the README runs, and prints what it says."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"


def test_the_example_runs_and_prints_what_it_says(capsys: pytest.CaptureFixture[str]) -> None:
  (block,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
  exec(compile(block, str(README), "exec"), {})
  promised = [text.strip() for text in re.findall(r"print\(.*\)  # (.*)", block)]
  printed = capsys.readouterr().out.splitlines()
  assert len(promised) >= 4
  assert [line.startswith(promise.rstrip(".")) for line, promise in zip(printed, promised, strict=True)] == [
    True
  ] * len(promised), printed
