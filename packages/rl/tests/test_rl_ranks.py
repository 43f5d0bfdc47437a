"""Runs of several processes: seeds, one normaliser, averaged gradients, one run directory."""

import csv
import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from mjlab_core import seed_everything
from mjlab_core.errors import ConfigError
from mjlab_rl import Console, MjlabOnPolicyRunner, RslRlVecEnvWrapper, TaskCfg, checkpoints, train
from mjlab_rl.onpolicy.captured_ppo import CapturedPPO
from mjlab_rl.processes.ranks import Ranks
from rl_learners import agent, assert_learned_the_same, assert_same, pretend_two_processes
from rl_point_env import PointEnv, PointEnvCfg

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def launched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
  """Trainings of two processes: their folder, and what they printed."""
  folder = tmp_path_factory.mktemp("ranks")
  alone = train(TaskCfg(env=PointEnvCfg(), agent=agent(2)), name="Point", make_env=PointEnv, log_root=folder / "one")
  assert alone.checkpoint is not None
  alone.checkpoint.rename(folder / "alone.pt")
  command = [sys.executable, HERE / "rl_two_processes.py", HERE / "rl_rank_program.py", folder]
  done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=500)
  assert done.returncode == 0, done.stderr
  return folder, done.stdout


def kept(folder: Path, name: str) -> list[dict[str, Any]]:
  """Return what each process of a training kept."""
  return [torch.load(folder / f"{name}_{rank}.pt") for rank in range(2)]


@pytest.mark.slow
def test_two_processes_train_one_policy_in_different_worlds(launched: tuple[Path, str]) -> None:
  folder, shown = launched
  first, second = kept(folder, "half")
  assert_same(first["learner"], second["learner"])
  assert first["rate"] == second["rate"] != 1e-3
  for network in ("actor", "critic"):
    assert int(first["learner"][f"{network}_state_dict"]["obs_normalizer.count"]) == 2 * 4 * 6 * 3
  assert first["steps"] == second["steps"] == 2 * 4 * 6 * 3
  for name in ("starts", "draw"):
    assert not torch.isclose(first[name], second[name]).any(), name
  (run,) = (folder / "logs" / "half").iterdir()
  assert [path.name for path in checkpoints(run)] == ["model_3.pt"]
  with (run / "progress.csv").open() as file:
    assert [row["total_steps"] for row in csv.DictReader(file)] == ["48", "96", "144"]
  assert shown.count("3/3") == 1


@pytest.mark.slow
def test_a_resumed_run_of_two_processes_equals_an_uninterrupted_one(launched: tuple[Path, str]) -> None:
  folder, _ = launched
  for resumed, whole in zip(kept(folder, "resumed"), kept(folder, "whole"), strict=True):
    del resumed["starts"], whole["starts"]
    assert_same(resumed, whole)


@pytest.mark.slow
def test_an_off_policy_run_of_two_processes_has_one_learner_and_resumes_exactly(launched: tuple[Path, str]) -> None:
  folder, _ = launched
  first, second = kept(folder, "replay-whole")
  assert_same(first["learner"], second["learner"])
  modules = first["learner"]["algorithm_state_dict"]["modules"]
  assert int(modules["scale"]["statistics.count"]) == 2 * 4 * 12 * 4
  for resumed, whole in zip(kept(folder, "replay-resumed"), kept(folder, "replay-whole"), strict=True):
    del resumed["starts"], whole["starts"]
    assert_same(resumed, whole)
  own = []
  for name in ("replay.pt", "replay_1.pt"):
    runs = [torch.load(next((folder / "logs" / f"replay-{run}").glob(f"*/{name}"))) for run in ("resumed", "whole")]
    assert_same(*runs)
    own.append((runs[1]["replay"]["rows"], runs[1]["worlds"]["noise"]))
  for ours, theirs in zip(*own, strict=True):
    assert not torch.isclose(ours, theirs).all(-1).any()


@pytest.mark.slow
def test_on_another_number_of_processes_the_learner_continues_in_new_worlds(launched: tuple[Path, str]) -> None:
  folder, shown = launched
  assert "world state was not restored: it was saved by 1 process, there are 2 now" in shown
  first, second = kept(folder, "alone")
  assert_same(first["learner"], second["learner"])
  assert first["steps"] == 4 * 6 * 2 + 2 * 4 * 6 * 3
  assert not torch.isclose(first["starts"], second["starts"]).any()

  text = io.StringIO()
  task = TaskCfg(env=PointEnvCfg(), agent=agent(4))
  (half,) = (folder / "logs" / "half").glob("*/model_3.pt")
  train(task, name="Point", make_env=PointEnv, log_root=None, resume=half, console=Console("normal", text))
  assert "world state was not restored: it was saved by 2 processes, there is 1 now" in text.getvalue()


@pytest.mark.slow
def test_an_iteration_sends_one_message_per_update_and_one_of_figures(launched: tuple[Path, str]) -> None:
  folder, _ = launched
  algorithm = agent().algorithm
  updates = algorithm.num_learning_epochs * algorithm.num_mini_batches
  for rank in range(2):
    short, long = torch.load(folder / f"counts_{rank}.pt")
    assert long.pop("all_reduce") - short.pop("all_reduce") == 3 * (updates + 1)
    assert long == short


@pytest.mark.parametrize("is_covered", [True, False], ids=["captured", "rsl-rl"])
def test_two_processes_with_the_same_worlds_learn_what_one_learns(
  monkeypatch: pytest.MonkeyPatch, is_covered: bool
) -> None:
  """Gradients, adaptive learning rate, normalisers and figures, against one process, with both updates."""
  if not is_covered:
    monkeypatch.setattr(CapturedPPO, "is_covered", False)

  def trained() -> tuple[dict[str, Any], list[str]]:
    seed_everything(1)
    console = Console("verbose", text := io.StringIO())
    env = RslRlVecEnvWrapper(PointEnv(PointEnvCfg(episode_steps=3)))
    runner = MjlabOnPolicyRunner(env, agent(), console=console)
    runner.learn(3)
    names = [line.split()[0] for line in text.getvalue().splitlines()]
    return runner.alg.save() | {"rate": torch.tensor(runner.alg.learning_rate)}, names

  one, one_names = trained()
  pretend_two_processes(monkeypatch)
  two, two_names = trained()
  assert_learned_the_same(one, two)
  assert one["rate"] != 1e-3
  assert two_names == one_names


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
  ("rank", "world_size", "message"),
  [("two", "2", "^RANK=two, .*: the launcher"), ("2", "2", "^RANK=2, .*, WORLD_SIZE=2: ")],
)
def test_wrong_numbers_of_a_launcher_are_refused(
  monkeypatch: pytest.MonkeyPatch, rank: str, world_size: str, message: str
) -> None:
  monkeypatch.setenv("RANK", rank)
  monkeypatch.setenv("WORLD_SIZE", world_size)
  with pytest.raises(ConfigError, match=message):
    Ranks.launched()
