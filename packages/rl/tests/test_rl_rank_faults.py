"""Faults of one process among several: all end, with a traceback and the learner saved."""

import faulthandler
import inspect
import os
import re
import subprocess
import sys
from datetime import timedelta
from pathlib import Path
from typing import Any

import mjlab_rl
import pytest
import rl_learners
import torch
from mjlab_rl import checkpoints
from mjlab_rl.processes.ranks import Patience, Ranks
from mjlab_rl.runs import checkpoint
from torch import distributed

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
  """Runs of two processes of which the second one has a fault: their folder, and what they said of it."""
  folder = tmp_path_factory.mktemp("faults")
  runs = [folder / "diverges", "diverges", "--", folder / "hangs", "hangs"]
  command = [sys.executable, HERE / "rl_two_processes.py", HERE / "rl_fault_program.py", *runs]
  done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=500)
  assert "failed runs: 0 1\n" in done.stdout
  return folder, done.stderr


@pytest.mark.slow
def test_a_process_that_diverges_ends_all_with_the_last_good_checkpoint(ended: tuple[Path, str]) -> None:
  folder, said = ended
  for rank in range(2):
    assert re.search(rf"rank{rank}\]:.*DivergedError: iteration 3: .* not finite, so the state is not saved", said)
  (run,) = folder.glob("diverges/point/*")
  assert [path.name for path in checkpoints(run)] == ["model_1.pt", "model_2.pt"]
  assert not list(run.glob("emergency_*"))


@pytest.mark.skipif(not hasattr(distributed, "set_timeout"), reason="this torch cannot limit messages")
@pytest.mark.slow
def test_a_process_that_hangs_ends_the_run_and_the_others_save_the_learner(ended: tuple[Path, str]) -> None:
  folder, said = ended
  assert "Timeout (" in said  # of faulthandler
  assert re.search(r'rl_fault_program.py", line \d+ in step', said)
  assert "rank 0: another process of the run has ended or hangs" in said
  (saved,) = folder.glob("hangs/point/*/emergency_2.pt")
  assert "actor_state_dict" in torch.load(saved)


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
  """Limits of a process and its work, in their order; it believes that there is a second process like it."""
  found: list[Any] = []
  rl_learners.pretend_two_processes(monkeypatch)
  # Older versions of torch have no limit that could be changed.
  monkeypatch.setattr(distributed, "set_timeout", lambda limit: found.append(("messages", limit)), raising=False)
  monkeypatch.setattr(distributed, "is_initialized", lambda: True)
  monkeypatch.setattr(faulthandler, "dump_traceback_later", lambda limit, exit: found.append(("traceback", limit)))
  monkeypatch.setattr(faulthandler, "cancel_dump_traceback_later", lambda: found.append("no traceback"))
  monkeypatch.setattr(checkpoint, "write_checkpoint", lambda path, state: found.append("written"))
  monkeypatch.setattr(Ranks, "collect", lambda _, value: [value])
  monkeypatch.setattr(Ranks, "gather", lambda _, value: (value is None and found.append("all wait")) or [value] * 2)
  return found


def test_a_process_without_progress_ends_within_thirty_seconds_and_after_the_messages_of_others(
  events: list[Any],
) -> None:
  patience = Patience(inspect.signature(mjlab_rl.train).parameters["rank_timeout"].default)
  patience.begin()
  patience.progress()
  (_, messages), (_, traceback) = events
  assert messages < timedelta(seconds=traceback) <= timedelta(seconds=30)


def test_a_checkpoint_may_take_longer_than_processes_wait_for_each_other(events: list[Any], tmp_path: Path) -> None:
  runner = rl_learners.runner(tmp_path, rl_learners.agent(save_interval=1))
  runner.patience.seconds = 20.0
  runner.learn(2)
  limit, none = ("messages", timedelta(seconds=20)), ("messages", distributed.default_pg_timeout)
  assert none[1] >= timedelta(minutes=10)
  watched = ("traceback", 25.0)
  save = ["no traceback", none, "written", "all wait", limit, watched]
  assert events[events.index(limit) :] == [limit, *save, *[watched] * 6, *save]


def test_processes_of_srun_are_numbered_by_its_variables(monkeypatch: pytest.MonkeyPatch) -> None:
  for name in ("RANK", "LOCAL_RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT"):
    # Set first, so that the test puts them back.
    monkeypatch.setenv(name, "")
    monkeypatch.delenv(name)
  slurm = {"PROCID": "5", "LOCALID": "1", "STEP_NUM_TASKS": "8", "LAUNCH_NODE_IPADDR": "10.0.0.7", "JOB_ID": "30011"}
  for name, value in slurm.items():
    monkeypatch.setenv(f"SLURM_{name}", value)
  assert Ranks.launched() == Ranks(rank=5, local_rank=1, world_size=8)
  assert (os.environ["MASTER_ADDR"], os.environ["MASTER_PORT"]) == ("10.0.0.7", "30011")
