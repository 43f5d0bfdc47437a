"""Kernels of MuJoCo Warp, compiled several at once: one after another they take a minute on a GPU's first run.

Processes that need the same kernels, such as those of one training, share Warp's cache: the first one compiles.
"""

import contextlib
import hashlib
import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import warp as wp

from mjlab_sim.warp.solver.tile_solvers import made_elsewhere, replaced

_Variants = dict[Any, dict[int | None, None]]


def load_kernels(stages: Sequence[Callable[[], None]], device: Any) -> None:
  """Compile and load, in parallel, the kernels that `stages` launch on a Warp device.

  The stages run once with launches that do nothing, to learn which kernels they need. Copies and fills do happen: the
  caller puts back what they change.
  """
  device = wp.get_device(device)
  variants: _Variants = {}
  with _launching_nothing(variants):
    for stage in stages:
      stage()
  cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

  def load(module: Any) -> None:
    # A module notes the block size that it loads for, so that two of one module take turns.
    for block_dim in variants[module]:
      module.load(device, block_dim)

  with _once_per_cache(_digest(variants, device)), made_elsewhere(cores), ThreadPoolExecutor(cores) as pool:
    # The longest begin first.
    list(pool.map(load, sorted(variants, key=_work, reverse=True)))


def _digest(variants: _Variants, device: Any) -> str:
  """Return a name for the compiled kernels of `variants`."""
  hashes = sorted(module.get_module_hash(block_dim).hex() for module, dims in variants.items() for block_dim in dims)
  return hashlib.sha256(" ".join([str(device.arch) if device.is_cuda else "cpu", *hashes]).encode()).hexdigest()[:16]


@contextmanager
def _once_per_cache(digest: str) -> Generator[None]:
  """Let one process fill the cache while others that need the same kernels wait; these then load at once."""
  with contextlib.ExitStack() as stack:
    file = None
    # Windows has no such locks, nor have some network file systems. Nothing is compiled into a cache that is read-only.
    with contextlib.suppress(ImportError, OSError):
      import fcntl

      file = stack.enter_context(Path(str(wp.config.kernel_cache_dir), f"mjlab_{digest}.lock").open("ab"))
      # The system takes the lock from a process that dies.
      fcntl.flock(file, fcntl.LOCK_EX)
      if os.fstat(file.fileno()).st_size > 0:
        file.close()
    yield
    if file is not None and not file.closed:
      file.write(b"filled\n")


def _work(module: Any) -> tuple[bool, int]:
  """Return a key that grows with the time a module takes: first tiles, which wait for solvers, then code."""
  sources = [kernel.adj.source for kernel in module.kernels.values()]
  return any("tile_" in source for source in sources), sum(map(len, sources))


@contextmanager
def _launching_nothing(variants: _Variants) -> Generator[None]:
  def note(module: Any, device: Any, block_dim: int | None = None) -> None:
    # A launch whose module does not load returns at once.
    variants.setdefault(module, {})[block_dim] = None

  def suggest(kernel: Any, device: Any = None) -> tuple[int, int]:
    # A GPU can only answer for a loaded kernel. Any answer will do: nothing is launched.
    if wp.get_device(device).is_cuda:
      note(kernel.module, device)
    return 1, 1

  def once(condition: Any, while_body: Callable[..., None], stream: Any = None, **arguments: Any) -> None:
    while_body(**arguments)

  def both(condition: Any, on_true: Any = None, on_false: Any = None, stream: Any = None, **arguments: Any) -> None:
    for branch in (on_true, on_false):
      if branch is not None:
        branch(**arguments)

  with (
    replaced(wp.Module, "load", note),
    replaced(wp, "get_suggested_block_size", suggest),
    replaced(wp, "capture_while", once),
    replaced(wp, "capture_if", both),
  ):
    yield
