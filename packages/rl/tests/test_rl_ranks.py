"""Runs of several processes: seeds, one normaliser, averaged gradients, one run directory."""

import csv
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_rl import checkpoints
from mjlab_rl.ranks import Ranks, mean_of
from test_rl_runner import assert_same

PROGRAM = Path(__file__).parent / "rl_rank_program.py"


def launch(folder: Path, *words: str | Path) -> tuple[list[dict[str, Any]], str]:
  """Train in two processes; return what each kept, and what was printed."""
  command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", PROGRAM, folder]
  done = subprocess.run([*command, *words], capture_output=True, text=True, check=False, timeout=500)
  assert done.returncode == 0, done.stderr
  return [torch.load(folder / f"rank_{rank}.pt") for rank in range(2)], done.stdout


@pytest.mark.slow
def test_two_processes_train_one_policy_in_worlds_of_their_own(tmp_path: Path) -> None:
  (first, second), shown = launch(tmp_path)
  assert_same(first["learner"], second["learner"])
  assert int(first["learner"]["actor_state_dict"]["obs_normalizer.count"]) == 2 * 4 * 6 * 3
  assert first["steps"] == second["steps"] == 2 * 4 * 6 * 3
  for name in ("starts", "draw"):
    assert not torch.isclose(first[name], second[name]).any(), name
  (run,) = (tmp_path / "logs" / "point").iterdir()
  assert [path.name for path in checkpoints(run)] == ["model_3.pt"]
  with (run / "progress.csv").open() as file:
    assert [row["total_steps"] for row in csv.DictReader(file)] == ["48", "96", "144"]
  assert shown.count("3/3") == 1

  (first, second), shown = launch(tmp_path, run / "model_3.pt")
  assert_same(first["learner"], second["learner"])
  assert first["steps"] == second["steps"] == 2 * 4 * 6 * 5
  assert not torch.isclose(first["starts"], second["starts"]).any()
  assert "World state was not restored: a checkpoint holds the worlds of one process" in shown


def test_seeds_of_ranks_are_derived_from_that_of_the_run() -> None:
  seeds = [Ranks(rank=rank, world_size=4).seed(42) for rank in range(4)]
  assert seeds[0] == 42
  assert len(set(seeds)) == 4
  assert seeds == [Ranks(rank=rank, world_size=4).seed(42) for rank in range(4)]
  assert Ranks(rank=1, world_size=4).seed(43) not in seeds


def test_a_process_has_the_gpu_of_its_number() -> None:
  ranks = Ranks(rank=5, local_rank=1, world_size=8)
  assert [ranks.device(name) for name in ("cuda", "cuda:0", "cpu")] == ["cuda:1", "cuda:1", "cpu"]
  assert Ranks().device("cuda:3") == "cuda:3"


@pytest.mark.parametrize(
  ("rank", "world_size", "message"), [("two", "2", "RANK=two: the launcher"), ("2", "2", "RANK=2 with WORLD_SIZE=2")]
)
def test_a_launcher_that_numbers_wrongly_is_named(
  monkeypatch: pytest.MonkeyPatch, rank: str, world_size: str, message: str
) -> None:
  monkeypatch.setenv("RANK", rank)
  monkeypatch.setenv("WORLD_SIZE", world_size)
  with pytest.raises(ConfigError, match=message):
    Ranks.launched()


def test_figures_are_averaged_over_the_ranks_that_have_them() -> None:
  assert mean_of([{"a": 1.0, "b": 2.0}, {"a": 3.0}]) == {"a": 2.0, "b": 2.0}
