"""Processes of one training run, as `torchrun`, Slurm and other launchers start them.

Each process (rank) has its own environment. Gradients and normalisers are averaged over all ranks; rank 0
writes the run directory.
"""

import contextlib
import faulthandler
import os
from collections.abc import Generator
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, Self, TypeVar

import numpy as np
import torch
from mjlab_core import printable
from mjlab_core.errors import ConfigError, MjlabError
from torch import distributed
from torch.distributed.rendezvous import rendezvous

T = TypeVar("T")

_PARENT = os.getppid()


@dataclass(frozen=True, kw_only=True)
class Ranks:
  """Place of this process in the run."""

  rank: int = 0
  """Number of this process."""
  local_rank: int = 0
  """Number of this process on its host, which is the number of its GPU."""
  world_size: int = 1
  """Number of processes."""

  @classmethod
  def launched(cls) -> Self:
    """Read the place from `RANK`, `LOCAL_RANK` and `WORLD_SIZE` of a launcher, or from the variables of `srun`.

    Raises:
      ConfigError: A variable is not such a number.
    """
    if "RANK" not in os.environ and int(os.environ.get("SLURM_STEP_NUM_TASKS", "1")) > 1:
      _translate_slurm()
    rank, get = os.environ.get("RANK", "0"), os.environ.get
    texts = {"rank": rank, "local_rank": get("LOCAL_RANK", rank), "world_size": get("WORLD_SIZE", "1")}
    is_decimal = all(text.isdecimal() for text in texts.values())
    if not is_decimal or int(texts["rank"]) >= int(texts["world_size"]):
      given = ", ".join(f"{name.upper()}={printable(text, 40)}" for name, text in texts.items())
      raise ConfigError(f"{given}: the launcher must number the processes from 0 to WORLD_SIZE - 1")
    return cls(**{name: int(text) for name, text in texts.items()})

  @classmethod
  def current(cls) -> Self:
    """Return the place of this process in the group that `joined` made; alone outside of it."""
    if not distributed.is_initialized():
      return cls()
    launched = cls.launched()
    return cls(rank=distributed.get_rank(), local_rank=launched.local_rank, world_size=distributed.get_world_size())

  @property
  def is_first(self) -> bool:
    """True for the process that writes files and shows progress."""
    return self.rank == 0

  def device(self, device: str) -> str:
    """Return the device of this process; each of several processes on GPUs has its own."""
    return f"cuda:{self.local_rank}" if self.world_size > 1 and device.startswith("cuda") else device

  def seed(self, seed: int) -> int:
    """Return the seed of this process, derived from the seed of the run; rank 0 has the seed of the run."""
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
    store, *_ = next(rendezvous("env://", self.rank, self.world_size))
    # The store of torchrun outlives a restart, with the old addresses in it.
    prefix: Any = getattr(distributed, "PrefixStore")  # noqa: B009 - public, but without a type
    store = prefix(f"attempt_{os.environ.get('TORCHELASTIC_RESTART_COUNT', '0')}", store)
    # With a device NCCL connects at once; without one it would guess a device in barriers.
    how: dict[str, Any] = {"backend": "nccl", "device_id": torch.device(device)} if is_cuda else {"backend": "gloo"}
    distributed.init_process_group(**how, store=store, rank=self.rank, world_size=self.world_size)
    is_failed = True
    try:
      yield
      is_failed = False
    finally:
      # After an error NCCL would wait for messages that another process may never send.
      if not (is_failed and is_cuda):
        faulthandler.cancel_dump_traceback_later()
        distributed.destroy_process_group()

  @property
  def is_orphan(self) -> bool:
    """True if the launcher of several processes has died."""
    return self.world_size > 1 and os.getppid() != _PARENT

  def gather(self, value: T) -> list[T]:
    """Return the values of all processes, in their order; every process must call it."""
    if self.world_size == 1:
      return [value]
    values: list[Any] = [None] * self.world_size
    distributed.all_gather_object(values, value)
    return values

  def sum(self, numbers: torch.Tensor) -> None:
    """Sum numbers over all processes in place.

    Raises:
      MjlabError: Another process has ended or hangs.
    """
    try:
      if self.world_size > 1:
        distributed.all_reduce(numbers)
    except RuntimeError as error:
      reason = printable(error, 200)
      raise MjlabError(f"rank {self.rank}: another process of the run has ended or hangs ({reason})") from error

  def collect(self, value: T) -> list[T]:
    """Return the values of all processes on the first one, and an empty list elsewhere; every process must call it."""
    if self.world_size == 1:
      return [value]
    values: list[Any] | None = [None] * self.world_size if self.is_first else None
    distributed.gather_object(value, values)
    return values or []


@dataclass
class Patience:
  """Limit of the time that the processes of a run wait for each other, in effect after `begin`."""

  seconds: float | None = None
  """Time without progress after which a process ends [s]; None: it waits."""
  _limit: float | None = None

  def begin(self) -> None:
    """Set the limit, after all processes have compiled their kernels."""
    if self._limit is None and self.seconds is not None and distributed.is_initialized():
      self._limit = self.seconds
      _limit_messages(timedelta(seconds=self._limit))

  def progress(self) -> None:
    """Give this process more time; without progress it prints where each thread is, and ends.

    Messages fail a little earlier, so that processes that wait for another one can save their work.
    """
    if self._limit is not None:
      faulthandler.dump_traceback_later(1.25 * self._limit, exit=True)

  @contextlib.contextmanager
  def suspended(self) -> Generator[None]:
    """Lift the limit while entered, for work of one process that the others wait for, such as a checkpoint."""
    if self._limit is None:
      yield
      return
    faulthandler.cancel_dump_traceback_later()
    _limit_messages(distributed.default_pg_timeout)
    yield
    _limit_messages(timedelta(seconds=self._limit))
    self.progress()


def _limit_messages(limit: timedelta) -> None:
  """Let messages from now on fail after a time; older versions of torch have no public function for it."""
  if hasattr(distributed, "set_timeout"):
    distributed.set_timeout(limit)


def _translate_slurm() -> None:
  """Set missing variables of torch from the variables of `srun`.

  The processes meet at the first node of a batch job, on a port derived from the job's number.
  """
  names = {"RANK": "SLURM_PROCID", "LOCAL_RANK": "SLURM_LOCALID", "WORLD_SIZE": "SLURM_STEP_NUM_TASKS"}
  found = {name: os.environ[slurm] for name, slurm in names.items() if slurm in os.environ}
  found["MASTER_ADDR"] = os.environ.get("SLURM_LAUNCH_NODE_IPADDR", "127.0.0.1")
  found["MASTER_PORT"] = str(20000 + int(os.environ.get("SLURM_JOB_ID", "0")) % 20000)
  for name, value in found.items():
    os.environ.setdefault(name, value)
