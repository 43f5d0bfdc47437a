"""Settings that must hold before any package is imported by a test."""

import faulthandler
import os
import sys
from pathlib import Path

import pytest

# Kernels are compiled once and kept between runs. Warp reads this when it is first imported.
os.environ.setdefault("WARP_CACHE_PATH", str(Path(__file__).parent / ".cache" / "warp"))

# Tensors of tests are tiny. Threads of one process that wait for each other on a busy machine cost ten times the work.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Processes that tests start import torch and its like from bytecode; from source each import takes three times as long.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
  """Run slow tests first: one that begins last is what all workers but one wait for."""
  items.sort(key=lambda item: item.get_closest_marker("slow") is None)


def pytest_unconfigure(config: pytest.Config) -> None:
  """What tests left behind, such as a thread, has as long to end as a test has."""
  limit = float(config.getini("faulthandler_timeout"))
  if limit:
    faulthandler.dump_traceback_later(limit, file=sys.__stderr__ or sys.stderr, exit=True)
