"""Processes of `train --gpus` and `--hosts`: torch's own launcher on this host, and on others by ssh."""

import itertools
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from mjlab_core import MjlabError, UsageError
from mjlab_rl.runs.run_directory import find_launch

from mjlab import environments
from mjlab.cli.shared._command_line import TaskLine, take

_OURS = ("--gpus", "--hosts", "--max-restarts", "--dry-run")
_PORT = 29400


def launch(wanted: Any, line: TaskLine) -> int:
  """Start the processes of a training and wait for them; return the exit code.

  torchrun passes a Ctrl-C to each process once, ends all if one fails, and starts them again up to `--max-restarts`
  times. torchrunx, which needs a program to pickle, has no restarts and a licence (GPL-3) that does not fit.

  Raises:
    UsageError: There are no such GPUs.
  """
  device = environments.resolve_device(wanted.device)
  gpus = _gpus(wanted.gpus or "all", device)
  hosts = wanted.hosts.split(",") if wanted.hosts else []
  train = ["train", line.name, *_without_launch(line.given)]
  processes = ["--nproc-per-node", str(len(gpus))]
  if wanted.max_restarts:
    processes += ["--max-restarts", str(wanted.max_restarts)]
  # The words of torchrun for each host.
  launches = [["--standalone", *processes]]
  if hosts:
    meeting = ["--nnodes", str(len(hosts)), "--master-addr", hosts[0], "--master-port", str(_PORT)]
    meeting += ["--rdzv-id", f"mjlab-{int(time.time())}", *processes]
    launches = [[*meeting, "--node-rank", str(number)] for number in range(len(hosts))]
  lines = [["torchrun", *words, "--no-python", *train] for words in launches]
  num_envs = wanted.env.scene.num_envs
  if not any(word.startswith("--env.scene.num-envs") for word in line.given):
    num_envs = environments.default_num_envs(device, num_envs)
  if wanted.dry_run:
    for rank, (host, gpu) in enumerate(itertools.product(hosts or [""], gpus)):
      place = f"{host} {gpu if gpu == 'cpu' else f'cuda:{gpu}'}".strip()
      print(f"rank {rank}: {place}, {num_envs} environments")
    print("\n".join(map(shlex.join, lines)))
    return 0
  environment = {} if device == "cpu" else {"CUDA_VISIBLE_DEVICES": ",".join(gpus)}
  if hosts:
    variables = [f"{key}={value}" for key, value in environment.items()]
    return _over_ssh(hosts, [shlex.join(["env", *variables, *words]) for words in lines])
  if environment and (visible := os.environ.get("CUDA_VISIBLE_DEVICES")):
    # The numbers count the GPUs that this process sees.
    names = visible.split(",")
    environment["CUDA_VISIBLE_DEVICES"] = ",".join(names[int(gpu)] for gpu in gpus)
  os.environ.update(environment)
  os.environ.setdefault("OMP_NUM_THREADS", str(max(1, environments.cpu_cores() // len(gpus))))
  return _locally([*launches[0], "--no-python", sys.executable, "-c", _PROGRAM, *train[1:]])


def _locally(words: list[str]) -> int:
  """Run torchrun in this process."""
  from torch.distributed.elastic.multiprocessing import SignalException
  from torch.distributed.elastic.multiprocessing.errors import ChildFailedError
  from torch.distributed.run import parse_args, run

  try:
    run(parse_args(words))
  except SignalException:
    return 0  # All processes have saved their work.
  except ChildFailedError as error:
    rank, failure = error.get_first_failure()
    how = f"exit code {failure.exitcode}" if failure.exitcode >= 0 else failure.signal_name()
    raise MjlabError(f"process {rank} of the run failed ({how}), and all were ended; its message is above") from error
  return 0


_PROGRAM = "import sys; from mjlab.cli import train; sys.exit(train())"


def restarted_from(log_root: Path, experiment: str) -> Path | None:
  """Return the checkpoint to continue from after torchrun has started the processes again; None otherwise."""
  if os.environ.get("TORCHELASTIC_RESTART_COUNT", "0") == "0":
    return None
  return find_launch(os.environ["TORCHELASTIC_RUN_ID"], log_root=log_root, experiment=experiment)


def _gpus(wanted: str, device: str) -> list[str]:
  """Return the numbers of the GPUs that `--gpus` names; with a CPU as device, those of the processes."""
  import torch

  count = 0 if device == "cpu" else torch.cuda.device_count()
  numbers = [part for part in wanted.split(",") if part]
  if wanted == "all" or wanted.isdecimal():
    numbers = [str(number) for number in range((count or 1) if wanted == "all" else int(wanted))]
  if not all(number.isdecimal() for number in numbers) or len(set(numbers)) != len(numbers):
    raise UsageError(f"--gpus {wanted}: give all, a number of GPUs, or a list of their numbers such as 0,1")
  if not numbers or (device != "cpu" and max(map(int, numbers)) >= count):
    raise UsageError(f"--gpus {wanted}: this host has {count} GPU{'s' * (count != 1)}")
  return ["cpu"] * len(numbers) if device == "cpu" else numbers


def _without_launch(given: list[str]) -> list[str]:
  """Return the words without the flags of the launch."""
  for flag in _OURS:
    _, given = take(given, flag)
  return given


def _over_ssh(hosts: list[str], lines: list[str]) -> int:
  """Run a line on each host in the current folder; end all if one fails. Return the exit code."""
  shell = (
    f"cd {shlex.quote(str(Path.cwd()))} && export PATH={shlex.quote(os.path.dirname(sys.executable))}:$PATH && exec "
  )
  # With a terminal (-tt), the processes of a host end with their connection.
  started = [
    subprocess.Popen(["ssh", "-tt", host, shell + line], stdin=subprocess.DEVNULL)
    for host, line in zip(hosts, lines, strict=True)
  ]
  try:
    codes: list[int | None] = [None]
    while None in codes and not any(codes):
      time.sleep(0.2)
      codes = [process.poll() for process in started]
    return next(filter(None, codes), 0)
  finally:
    for process in started:
      if process.poll() is None:
        process.send_signal(signal.SIGTERM)
    for process in started:
      process.wait()
