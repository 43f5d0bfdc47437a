"""`train --gpus` and `--hosts`: processes on this host and on others."""

import os
import signal
import sys
from pathlib import Path

import pytest
from mjlab.cli import train
from mjlab_command import running

TASK = "Mjlab-Cartpole-Balance"
LAUNCH = "import sys; from mjlab.cli import train; sys.exit(train())"


def processes(parent: int) -> dict[str, int]:
  """Return the process ids of ranks by their numbers."""
  children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
  variables = {int(child): Path(f"/proc/{child}/environ").read_text().split("\0") for child in children}
  return {text[5:]: child for child, texts in variables.items() for text in texts if text.startswith("RANK=")}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_run_restarts_after_a_process_died_and_ctrl_c_ends_all(tmp_path: Path) -> None:
  flags = ["--device", "cpu", "--gpus", "2", "--max-restarts", "1", "--env.scene.num-envs", "4"]
  flags += ["--agent.max-iterations", "1_000_000", "--agent.save-interval", "1", "--agent.num-steps-per-env", "4"]
  with running(LAUNCH, TASK, *flags, folder=tmp_path) as command:
    # The second iteration begins when the checkpoint of the first is written.
    command.wait_for(r"(?m)^ *([2-9]|\d\d+)/1000000 ")
    before = processes(command.pid)
    os.kill(before["1"], signal.SIGKILL)
    command.wait_for(r"continuing from logs/cartpole/.*/model_\d+.pt")
    command.wait_for(r"(?s)continuing from.*\d/1000000 ")
    after = processes(command.pid)
    assert command.interrupt().count("Stopping after this iteration") == 2
    assert "world state was not restored" not in command.said
    assert "stopped (SIGINT)" in command.said
  assert not [pid for pid in (*before.values(), *after.values()) if Path(f"/proc/{pid}").exists()]
  assert len(list((tmp_path / "logs" / "cartpole").iterdir())) == 2


def test_a_dry_run_shows_processes_and_the_command_of_torchrun(capsys: pytest.CaptureFixture[str]) -> None:
  words = [TASK, "--device", "cpu", "--gpus=2", "--env.scene.num-envs", "8", "--max-restarts", "3", "--dry-run"]
  assert train(words) == 0
  same = f"--no-python train {TASK} --device cpu --env.scene.num-envs 8"
  assert capsys.readouterr().out.splitlines() == [
    "rank 0: cpu, 8 environments",
    "rank 1: cpu, 8 environments",
    f"torchrun --standalone --nproc-per-node 2 --max-restarts 3 {same}",
  ]
  assert train([*words, "--hosts", "a,b"]) == 0
  shown = capsys.readouterr().out.splitlines()
  assert shown[:4] == [f"rank {rank}: {'aabb'[rank]} cpu, 8 environments" for rank in range(4)]
  for number, line in enumerate(shown[4:]):
    assert line.startswith("torchrun --nnodes 2 --master-addr a --master-port ")
    assert line.endswith(f"--nproc-per-node 2 --max-restarts 3 --node-rank {number} {same}")


def test_processes_have_the_learner_of_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
  assert train([TASK, "--agent", "fastsac", "--device", "cpu", "--gpus", "2", "--dry-run"]) == 0
  assert f"--no-python train {TASK} --agent fastsac --device cpu\n" in capsys.readouterr().out


def test_each_host_runs_torchrun_by_ssh_and_a_failure_ends_all(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
  ssh = tmp_path / "ssh"
  ssh.write_text('#!/bin/sh\necho "$2: $3"\ncase "$2" in a) exec sleep 1000;; *) exit 7;; esac\n')
  ssh.chmod(0o755)
  monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
  assert train([TASK, "--device", "cpu", "--gpus", "1", "--hosts", "a,b", "--seed", "3"]) == 7
  said = capfd.readouterr().out
  for number, host in enumerate("ab"):
    assert f"{host}: cd " in said
    assert f"--node-rank {number} --no-python train {TASK} --device cpu --seed 3" in said
