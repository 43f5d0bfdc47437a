"""Faults of one process among several: all end, with a traceback and the learner saved."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from mjlab_rl.ranks import Ranks

PROGRAM = Path(__file__).parent / "rl_fault_program.py"


@pytest.mark.slow
def test_a_process_that_hangs_ends_the_run_and_the_others_save_the_learner(tmp_path: Path) -> None:
  command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", PROGRAM, tmp_path]
  done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=500)
  assert done.returncode != 0
  assert "Timeout (" in done.stderr  # of faulthandler
  assert re.search(r'rl_fault_program.py", line \d+ in step', done.stderr)
  assert "rank 0: another process of the run has ended or hangs" in done.stderr
  (saved,) = tmp_path.glob("point/*/emergency_2.pt")
  assert "actor_state_dict" in torch.load(saved)


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
