"""Processes of one training run, as `torchrun`, Slurm and other launchers start them.

Each process (rank) has its own environment. Gradients and normalisers are averaged over all ranks; rank 0
writes the run directory.
"""

import contextlib
import os
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np
import torch
from mjlab_core import printable
from mjlab_core.errors import ConfigError
from torch import distributed

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Ranks:
  """Place of this process among those of the run."""

  rank: int = 0
  """Number of this process."""
  local_rank: int = 0
  """Number of this process on its host, which is the number of its GPU."""
  world_size: int = 1
  """Number of processes."""

  @classmethod
  def launched(cls) -> Self:
    """Return the place that the launcher gave this process in `RANK`, `LOCAL_RANK` and `WORLD_SIZE`.

    Raises:
      ConfigError: A variable is not such a number.
    """
    texts = {name: os.environ.get(name.upper(), default) for name, default in (("rank", "0"), ("world_size", "1"))}
    texts["local_rank"] = os.environ.get("LOCAL_RANK", texts["rank"])
    wrong = [f"{name.upper()}={printable(text, 40)}" for name, text in texts.items() if not text.isdecimal()]
    numbers = {} if wrong else {name: int(text) for name, text in texts.items()}
    if wrong or numbers["rank"] >= numbers["world_size"]:
      given = ", ".join(wrong) or f"RANK={texts['rank']} with WORLD_SIZE={texts['world_size']}"
      raise ConfigError(f"{given}: the launcher must number the processes from 0 to WORLD_SIZE - 1")
    return cls(**numbers)

  @classmethod
  def current(cls) -> Self:
    """Return the place of this process in the group that `joined` made; alone outside of it."""
    if not distributed.is_available() or not distributed.is_initialized():
      return cls()
    launched = cls.launched()
    return cls(rank=distributed.get_rank(), local_rank=launched.local_rank, world_size=distributed.get_world_size())

  @property
  def is_first(self) -> bool:
    """True for the process that writes files and shows progress."""
    return self.rank == 0

  def for_rsl_rl(self) -> dict[str, int] | None:
    """Return rsl-rl's description of the processes; None for one."""
    ranks = {"global_rank": self.rank, "local_rank": self.local_rank, "world_size": self.world_size}
    return ranks if self.world_size > 1 else None

  def device(self, device: str) -> str:
    """Return the device of this process; each of several processes on GPUs has its own."""
    return f"cuda:{self.local_rank}" if self.world_size > 1 and device.startswith("cuda") else device

  def seed(self, seed: int) -> int:
    """Return the seed of this process, derived from that of the run; rank 0 has the seed of the run."""
    return seed if self.is_first else int(np.random.SeedSequence([seed, self.rank]).generate_state(1)[0])

  @contextlib.contextmanager
  def joined(self, device: str) -> Generator[None]:
    """Connect the processes while entered: NCCL between GPUs, gloo between CPUs; connected ones stay so."""
    if self.world_size == 1 or distributed.is_initialized():
      yield
      return
    is_cuda = torch.device(device).type == "cuda"
    if is_cuda:
      torch.cuda.set_device(device)
    distributed.init_process_group("nccl" if is_cuda else "gloo", rank=self.rank, world_size=self.world_size)
    try:
      yield
    finally:
      distributed.destroy_process_group()

  def gather(self, value: T) -> list[T]:
    """Return the values of all processes, in their order; every process must call it."""
    if self.world_size == 1:
      return [value]
    values: list[Any] = [None] * self.world_size
    distributed.all_gather_object(values, value)
    return values

  def collect(self, value: T) -> list[T]:
    """Return the values of all processes on the first one, and an empty list elsewhere; every process must call it."""
    if self.world_size == 1:
      return [value]
    values: list[Any] | None = [None] * self.world_size if self.is_first else None
    distributed.gather_object(value, values)
    return values or []
