"""Launcher of two processes that share one import of torch: `rl_two_processes.py PROGRAM [ARGUMENT ...]`."""

import os
import runpy
import sys
from pathlib import Path
from typing import Any

import rsl_rl.runners  # noqa: F401 - what takes long to import
from torch import distributed

if __name__ == "__main__":
  sys.argv = sys.argv[1:]
  sys.path[0] = str(Path(sys.argv[0]).parent)
  os.environ |= {"MASTER_ADDR": "localhost", "WORLD_SIZE": "2", "TORCHELASTIC_USE_AGENT_STORE": "True"}
  reader, writer = os.pipe()
  children = []
  for rank in range(2):
    if not (child := os.fork()):
      # The store has a thread, which a process that is forked after it would lack.
      os.environ |= {"RANK": str(rank), "LOCAL_RANK": str(rank), "MASTER_PORT": os.read(reader, 5).decode()}
      runpy.run_path(sys.argv[0], run_name="__main__")
      break
    children.append(child)
  else:
    make_store: Any = getattr(distributed, "TCPStore")  # noqa: B009 - public, but without a type
    store = make_store("localhost", 0, is_master=True, wait_for_workers=False)
    os.write(writer, f"{store.port:05}".encode() * 2)
    sys.exit(min(1, max(os.waitpid(child, 0)[1] for child in children)))
