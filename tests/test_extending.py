"""The program of docs/extending.md runs."""

import dataclasses
import re
from pathlib import Path

import pytest
from mjlab_core import DebugDraw
from mjlab_managers import CommandTerm
from mjlab_rl import TaskCfg

GUIDE = Path(__file__).parents[1] / "docs" / "extending.md"


def test_the_blocks_of_the_page_are_one_program() -> None:
  blocks = re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
  names: dict[str, object] = {"__name__": "extending"}
  exec(compile("\n".join(blocks), str(GUIDE), "exec"), names)
  evaluation = names["evaluation"]
  near = evaluation.groups["all"]["near"]  # type: ignore
  assert 0.0 <= near.mean <= 1.0


def of_a_command() -> set[str]:
  """Names of CommandTerm that subclasses override or read."""
  used_by_managers = {"load_progress", "log_values", "steer"}
  return {name for name in vars(CommandTerm) if not name.startswith("_")} - used_by_managers


@pytest.mark.parametrize(
  ("subject", "names"),
  [
    ("TaskCfg", {field.name for field in dataclasses.fields(TaskCfg)}),
    ("CommandTerm", of_a_command()),
    ("DebugDraw", {name for name in vars(DebugDraw) if not name.startswith("_")} - {"worlds"}),
  ],
)
def test_the_page_names_every_part(subject: str, names: set[str]) -> None:
  text = GUIDE.read_text(encoding="utf-8")
  assert names
  assert [name for name in sorted(names) if not re.search(rf"`{name}(\(.*?\))?`", text)] == [], subject
