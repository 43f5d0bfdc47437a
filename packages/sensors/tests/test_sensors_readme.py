"""The examples of the README run, one after another, and print what they say."""

import re
from pathlib import Path
from typing import get_args

import pytest
from mjlab_sensors import NATIVE_TYPES, SensorType

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


def test_the_table_of_native_sensors_is_that_of_the_code() -> None:
  rows = ["| type | attached to | relative to | numbers | frame | unit | stage |", "|---|---|---|---|---|---|---|"]
  for name, kind in NATIVE_TYPES.items():
    how = "" if name in get_args(SensorType) else " (ContactSensorCfg)" if name == "contact" else " (MJCF only)"
    relative = ", ".join(kind.references) + (" (needed)" if kind.needs_reference else "")
    cells = (
      f"`{name}`{how}",
      ", ".join(kind.objects),
      relative,
      kind.dim or "settings",
      kind.frame,
      kind.unit,
      kind.stage,
    )
    rows.append(f"| {' | '.join(str(cell) or '-' for cell in cells)} |")
  assert "\n".join(rows) in README.read_text(), "\n".join(rows)
