"""Settings of the tests that cross members."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from mjlab_rl.runs import references

if TYPE_CHECKING:
  from playwright.sync_api import Browser

ROOT = Path(__file__).parents[1]
# These tests share modules with each other and with the tests of members.
sys.path += [
  str(ROOT / "tests"),
  *(str(ROOT / "packages" / name / "tests") for name in ("dr", "mjlab", "sim", "viewer")),
]


@pytest.fixture(scope="module")
def launched() -> Iterator["Browser"]:
  from viewer_page import headless_chromium

  with headless_chromium() as browser:
    yield browser


@pytest.fixture
def chromium(launched: "Browser") -> Iterator["Browser"]:
  from viewer_page import closing_pages

  with closing_pages(launched) as browser:
    yield browser


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
