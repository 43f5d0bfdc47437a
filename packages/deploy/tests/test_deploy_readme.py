"""The examples of the README run."""

import re
from pathlib import Path

import pytest
from deploy_bundles import write_bundle

README = Path(__file__).parents[1] / "README.md"


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  write_bundle(tmp_path / "bundle")
  monkeypatch.chdir(tmp_path)
  blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
  assert blocks
  names: dict[str, object] = {}
  for block in blocks:
    exec(compile(block, str(README), "exec"), names)
