"""Solvers that tile kernels are linked with, made by other processes.

Warp makes one, say a Cholesky factorisation of 35 x 35, while it writes the source of a kernel that calls it. It holds
a lock that the sources of all other modules wait for, and libmathdx, which does the work, serves one thread at a time.
A humanoid needs seven, of two seconds each. Here the source of such a kernel is written twice: once to learn what it is
linked with, and again when other processes have put that into Warp's cache.
"""

import contextlib
import inspect
import json
import os
import subprocess
import sys
import threading
from collections.abc import Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import warp as wp
from warp._src import build

TESTED = "1.19"
PRIVATE = {
  "warp.Module._run_codegen": "writes the source of a module, twice here; else modules are written once, one by one",
  "warp._src.build.build_lto_solver": "makes a solver, in another process here; else under Warp's lock",
}


@contextmanager
def replaced(owner: Any, name: str, value: object) -> Generator[None]:
  """Give an attribute another value inside the context."""
  before = getattr(owner, name)
  setattr(owner, name, value)
  try:
    yield
  finally:
    setattr(owner, name, before)


@contextmanager
def made_elsewhere(processes: int) -> Generator[None]:
  """Make the solvers of modules that compile for a GPU inside the context, in any thread, in several `processes`."""
  write, make = getattr(wp.Module, "_run_codegen", None), getattr(build, "build_lto_solver", None)
  if write is None or make is None or not wp.__version__.startswith(TESTED + "."):
    # Another Warp, which makes its solvers one by one.
    yield
    return
  parameters = inspect.signature(make)
  # Solvers of the source that this thread writes; None in the second, final writing.
  wanted = threading.local()
  started: dict[str, Future[None]] = {}
  lock = threading.Lock()

  def note(*args: Any, **kwargs: Any) -> tuple[str, bytes]:
    if getattr(wanted, "solvers", None) is None:
      return make(*args, **kwargs)
    given = parameters.bind(*args, **kwargs).arguments
    wanted.solvers.append(json.dumps({name: value for name, value in given.items() if name != "builder"}))
    return "", b""

  def write_twice(module: Any, options: dict[str, Any], is_cpu: bool) -> Any:
    wanted.solvers = []
    try:
      source = write(module, options, is_cpu)
      solvers = wanted.solvers
    finally:
      wanted.solvers = None
    if not solvers:
      return source
    with lock:
      made = [started.get(x) or started.setdefault(x, pool.submit(_make, x)) for x in solvers]
    for future in made:
      future.result()
    return write(module, options, is_cpu)

  with (
    ThreadPoolExecutor(processes) as pool,
    replaced(wp.Module, "_run_codegen", write_twice),
    replaced(build, "build_lto_solver", note),
  ):
    yield


def _make(solver: str) -> None:
  # The folder of Warp's version is the process's own to add. It needs no GPU.
  cache = os.path.dirname(wp.config.kernel_cache_dir or "")
  env = {**os.environ, "WARP_CACHE_PATH": cache, "CUDA_VISIBLE_DEVICES": ""}
  # A solver that could not be made there is made here, with its error.
  with contextlib.suppress(OSError, subprocess.SubprocessError):
    # -P: this folder holds modules of mjlab_sim, which are not to be found by short names.
    subprocess.run([sys.executable, "-P", __file__, solver], env=env, capture_output=True, timeout=300)


if __name__ == "__main__":
  wp.init()
  build.build_lto_solver(**json.loads(sys.argv[1]), builder=SimpleNamespace(ltoirs={}, ltoirs_decl={}, fatbins={}))
