"""Settings of the tests that cross members."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from mjlab_rl import references


def forget_modules(below: Path, known: set[str]) -> None:
  """Forget modules in files below a folder, except for the known ones."""
  for name in set(sys.modules) - known:
    if Path(getattr(sys.modules[name], "__file__", None) or "").is_relative_to(below):
      del sys.modules[name]


@pytest.fixture(autouse=True, scope="module")
def _forget_installed_packages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
  """Forget packages that tests wrote, installed and imported, so that the next tests can do it again."""
  known = set(sys.modules)
  references._installed_packages.cache_clear()
  yield
  references._installed_packages.cache_clear()
  # The environment itself may be in a folder for temporary files: its modules stay.
  forget_modules(tmp_path_factory.getbasetemp(), known)
  importlib.invalidate_caches()
