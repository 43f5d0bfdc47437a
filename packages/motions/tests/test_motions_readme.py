"""The README's examples run and print what they say."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"


def test_the_examples_run_and_print_what_they_say(
  capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  monkeypatch.chdir(tmp_path)
  blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
  assert blocks
  for block in blocks:
    exec(compile(block, str(README), "exec"), {})
    promised = [text.strip() for text in re.findall(r"print\(.*\)  # (.*)", block)]
    assert capsys.readouterr().out.splitlines() == promised
