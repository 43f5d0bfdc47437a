"""Launcher of two processes that share one import of torch: `rl_two_processes.py PROGRAM [ARGUMENT ...] [-- ...]`.

Words after each `--` are the arguments of one more run of the program. The exit code is 1 if any process failed.
"""

import itertools
import os
import runpy
import sys
from pathlib import Path
from typing import Any

import rsl_rl.runners  # noqa: F401 - what takes long to import
from torch import distributed


def run(program: str, arguments: list[str]) -> bool:
  """Return True if a process of the run failed."""
  reader, writer = os.pipe()
  children = []
  for rank in range(2):
    if not (child := os.fork()):
      # The store has a thread, which a process that is forked after it would lack.
      os.environ |= {"RANK": str(rank), "LOCAL_RANK": str(rank), "MASTER_PORT": os.read(reader, 5).decode()}
      sys.argv = [program, *arguments]
      runpy.run_path(program, run_name="__main__")
      sys.exit()
    children.append(child)
  make_store: Any = getattr(distributed, "TCPStore")  # noqa: B009 - public, but without a type
  store = make_store("localhost", 0, is_master=True, wait_for_workers=False)
  os.write(writer, f"{store.port:05}".encode() * 2)
  return max(os.waitpid(child, 0)[1] for child in children) > 0


if __name__ == "__main__":
  _, program, *words = sys.argv
  sys.path[0] = str(Path(program).parent)
  os.environ |= {"MASTER_ADDR": "localhost", "WORLD_SIZE": "2", "TORCHELASTIC_USE_AGENT_STORE": "True"}
  runs = [list(group) for is_end, group in itertools.groupby(words, lambda word: word == "--") if not is_end]
  failed = [run(program, arguments) for arguments in runs]
  print("failed runs:", *(number for number, is_failed in enumerate(failed) if is_failed))
  sys.exit(int(any(failed)))
