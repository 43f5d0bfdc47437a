"""The examples of the README run, one after another, and print what they say."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"


@pytest.mark.warp
def test_the_examples_run_and_print_what_they_say(capsys: pytest.CaptureFixture[str]) -> None:
  block = "\n".join(re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL))
  exec(compile(block, str(README), "exec"), {})
  promised = [text.strip() for text in re.findall(r"print\(.*\)  # (.*)", block)]
  printed = capsys.readouterr().out.splitlines()
  assert len(promised) >= 4
  assert [line.startswith(promise.rstrip(".")) for line, promise in zip(printed, promised, strict=True)] == [
    True
  ] * len(promised), printed
