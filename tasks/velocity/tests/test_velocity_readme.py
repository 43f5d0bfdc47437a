"""The README's examples run and print what they say; its table of rewards is the task's."""

import re
from pathlib import Path

import pytest
from mjlab_velocity import go1_flat_env

README = Path(__file__).parents[1] / "README.md"


def test_the_examples_run_and_print_what_they_say(capsys: pytest.CaptureFixture[str]) -> None:
  blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
  assert blocks
  for block in blocks:
    exec(compile(block, str(README), "exec"), {})
    promised = [text.strip() for text in re.findall(r"print\(.*\)  # (.*)", block)]
    assert capsys.readouterr().out.splitlines() == promised


def test_the_table_of_rewards_is_that_of_the_task() -> None:
  section = README.read_text(encoding="utf-8").split("### Rewards")[1].split("###")[0]
  table = {name: float(weight) for name, weight in re.findall(r"^\| `(\w+)` \|.*\| (\S+) \|$", section, re.MULTILINE)}
  assert table == {name: term.weight for name, term in go1_flat_env().rewards.items() if term is not None}
