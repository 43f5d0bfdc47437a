"""Settings that must hold before any package is imported by a test."""

import dataclasses
import faulthandler
import functools
import importlib.util
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

# Kernels are compiled once and kept between runs. Warp reads this when it is first imported.
os.environ.setdefault("WARP_CACHE_PATH", str(Path(__file__).parent / ".cache" / "warp"))

# Tensors of tests are tiny. Threads of one process that wait for each other on a busy machine cost ten times the work.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Processes that tests start import torch and its like from bytecode; from source each import takes three times as long.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Tests step a few worlds a few times, so that kernels for a CPU take longer to compile than to run: without
# optimisation, compiling takes a third of the time. Processes that tests start, and GPUs, compile as usual.
if importlib.util.find_spec("warp"):
  import warp

  warp.config.cpu_compiler_flags = "-march=native -O0"
  # Textures have a million pixels, for which optimised code pays.
  warp.get_module("mujoco_warp._src.render_util").options["cpu_compiler_flags"] = "-march=native"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
  """Run slow tests first: one that begins last is what all workers but one wait for."""
  items.sort(key=lambda item: item.get_closest_marker("slow") is None)


def pytest_runtest_setup() -> None:
  """Keep what libraries build again for each use: torch's table of ONNX operators, and kernels that draw images."""
  registry = getattr(sys.modules.get("torch.onnx._internal.exporter._registration"), "ONNXRegistry", None)
  if registry is not None and not hasattr(registry.from_torchlib, "cache_info"):
    registry.from_torchlib = staticmethod(functools.cache(registry.from_torchlib))
  render = sys.modules.get("mujoco_warp._src.render")
  if render is not None and not hasattr(render._build_megakernel, "kept"):
    keep_render_kernels(render)


def keep_render_kernels(render: Any) -> None:
  """Build one kernel for all render contexts with the same numbers, which are all that a kernel is built from."""
  build, kept = render._build_megakernel, {}

  def build_once(m: Any, rc: Any) -> Any:
    kinds = (int, bool, float, render.wp.uint32, render.wp.vec3)
    numbers = [str(getattr(rc, field.name)) for field in dataclasses.fields(rc) if field.type in kinds]
    key = (m.nlight, str(rc.geom_ray_types), *numbers)
    if key not in kept:
      kept[key] = build(m, rc)
    return kept[key]

  build_once.kept = kept  # type: ignore[attr-defined]
  render._build_megakernel = build_once


def pytest_unconfigure(config: pytest.Config) -> None:
  """What tests left behind, such as a thread, has as long to end as a test has."""
  limit = float(config.getini("faulthandler_timeout"))
  if limit:
    faulthandler.dump_traceback_later(limit, file=sys.__stderr__ or sys.stderr, exit=True)


@pytest.fixture
def run_readme(
  request: pytest.FixtureRequest,
  capsys: pytest.CaptureFixture[str],
  tmp_path: Path,
  monkeypatch: pytest.MonkeyPatch,
) -> Callable[..., dict[str, Any]]:
  """Run the Python blocks of the member's README as one program in an empty folder; return its names.

  With `prints=True`, comments behind `print(...)` are what a block prints.
  """
  readme = request.path.parents[1] / "README.md"

  def run(*, prints: bool = False) -> dict[str, Any]:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", readme.read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    names: dict[str, Any] = {}
    for block in blocks:
      exec(compile(block, str(readme), "exec"), names)
      printed = capsys.readouterr().out.splitlines()
      if prints:
        assert printed == [text.strip() for text in re.findall(r"print\(.*\)  # (.*)", block)]
    return names

  return run
