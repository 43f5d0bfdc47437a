"""Settings of the tests that cross members."""

import importlib
import sys
import tempfile
from collections.abc import Iterator

import pytest
from mjlab_rl import references


@pytest.fixture(autouse=True, scope="module")
def _forget_installed_packages() -> Iterator[None]:
  """Forget packages that tests wrote, installed and imported, so that the next tests can do it again."""
  known = set(sys.modules)
  references._installed_packages.cache_clear()
  yield
  references._installed_packages.cache_clear()
  for name in set(sys.modules) - known:
    if (getattr(sys.modules[name], "__file__", None) or "").startswith(tempfile.gettempdir()):
      del sys.modules[name]
  importlib.invalidate_caches()
