"""Names that are imported when they are asked for."""

import sys
from importlib import import_module
from pathlib import Path

import pytest


def test_a_package_imports_what_is_asked_for_once_and_nothing_else(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  package = tmp_path / "lazy_shop"
  package.mkdir()
  (package / "__init__.py").write_text(
    "from mjlab_core.lazy import lazy_exports\n"
    "__all__ = ['apple', 'pear', 'sqrt']\n"
    "__getattr__, __dir__ = lazy_exports(__name__, {'.fruit': 'apple', '.rest': 'pear', 'math': 'sqrt'})\n"
  )
  (package / "fruit.py").write_text("apple = []\n")
  (package / "rest.py").write_text("raise RuntimeError('imported too early')\n")
  monkeypatch.syspath_prepend(str(tmp_path))
  lazy_shop = import_module("lazy_shop")
  assert {"apple", "pear", "sqrt"} <= set(dir(lazy_shop))
  assert "lazy_shop.fruit" not in sys.modules
  assert lazy_shop.apple is lazy_shop.apple
  assert lazy_shop.sqrt(9.0) == 3.0
  assert "lazy_shop.rest" not in sys.modules
  with pytest.raises(AttributeError, match="module 'lazy_shop' has no attribute 'plum'"):
    _ = lazy_shop.plum
