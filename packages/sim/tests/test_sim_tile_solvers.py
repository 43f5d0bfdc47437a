"""Solvers of tile kernels, made by other processes or in this one. Compiling needs no GPU."""

import sys
from pathlib import Path
from typing import Any

import pytest
import warp as wp
from mjlab_sim.warp.solver.tile_solvers import made_elsewhere
from warp._src import build, context

SIZE = wp.constant(4)


def factorize(matrix: wp.array2d[float]):  # pyright: ignore
  tile = wp.tile_load(matrix, shape=(SIZE, SIZE))  # pyright: ignore  # ty: ignore
  wp.tile_cholesky_inplace(tile)
  wp.tile_store(matrix, tile)  # pyright: ignore  # ty: ignore


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> wp.Module:
  """A kernel that calls a solver which no cache has, and which this process refuses to make."""
  wp.init()
  runtime: Any = context.runtime
  core = runtime.core
  if not core.wp_is_mathdx_enabled():
    pytest.skip("Warp was built without solvers")

  def refuse(*_: Any) -> bool:
    raise RuntimeError("made in this process")

  monkeypatch.setattr(core, "wp_cuda_compile_solver", refuse)
  monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / wp.config.version))
  kernel: Any = wp.kernel(factorize, enable_backward=False, module="unique", module_options={"block_dim": 32})
  return kernel.module


def _compile(module: wp.Module, folder: Path) -> list[Path]:
  return wp.compile_aot_module(module, arch=90, module_dir=folder)


@pytest.mark.warp
def test_another_process_makes_the_solver_that_a_kernel_calls(module: wp.Module, tmp_path: Path) -> None:
  with made_elsewhere(1):
    (made,) = _compile(module, tmp_path / "kernel")
  assert made.stat().st_size > 0
  assert "potrf_4_4" in next((tmp_path / "kernel").glob("*.cu")).read_text()


@pytest.mark.warp
def test_a_solver_that_no_other_process_makes_is_made_in_this_one(
  module: wp.Module, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  monkeypatch.setattr(sys, "executable", str(tmp_path / "missing"))
  with made_elsewhere(1), pytest.raises(RuntimeError, match="made in this process"):
    _compile(module, tmp_path / "kernel")


@pytest.mark.warp
def test_without_it_the_solver_is_made_in_this_process(module: wp.Module, tmp_path: Path) -> None:
  with pytest.raises(RuntimeError, match="made in this process"):
    _compile(module, tmp_path / "kernel")


@pytest.mark.warp
@pytest.mark.parametrize(("owner", "name"), [(wp.Module, "_run_codegen"), (build, "build_lto_solver")])
def test_a_warp_that_has_no_such_functions_is_left_alone(
  monkeypatch: pytest.MonkeyPatch, owner: Any, name: str
) -> None:
  monkeypatch.delattr(owner, name)
  with made_elsewhere(1):
    assert not hasattr(owner, name)
