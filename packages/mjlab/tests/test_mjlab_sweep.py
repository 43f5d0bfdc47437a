"""`sweep`: the file of values, mistakes in it, results, and trials if Ray is installed."""

import csv
import json
import math
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from mjlab.cli import sweep
from mjlab.cli._sweep import report
from mjlab.cli.shared._sweep_space import Range, Space, Trial, trial_flags
from mjlab_command import running

TASK = "Mjlab-Cartpole-Balance"
COMMAND = "import sys; from mjlab.cli import sweep; sys.exit(sweep())"
ENTROPY, KL = "agent.algorithm.entropy-coef", "agent.algorithm.desired-kl"
VALUES = f"values:\n  {ENTROPY}: [0.0, 0.005]\n  {KL}: {{low: 5e-3, high: 0.05, log: true}}\n"

MISTAKES = {
  "": "missing required field `values`",
  "values: {}": "Expected `object` of length >= 1",
  "values: [1": "space ",
  "value: {}": "unknown field `value`",
  "values: {agent.algorithm.entropy-cof: [0.1]}": "entropy-coef",
  "values: {agent.algorithm.entropy-coef: [much]}": "much",
  "values: {agent.algorithm.entropy-coef: []}": "Expected `array` of length >= 1",
  "values: {seed: [1]}": "--seed: no such option",
  "values: {agent.algorithm.gamma: {low: 0.99, high: 0.9}}": "needs low < high",
  "values: {agent.algorithm.gamma: {low: 0, high: 0.9, log: true}}": "needs 0 < low < high",
}
PBT_MISTAKES = {
  "": "needs the names of values that it may change",
  "perturb: [agent.algorithm.gamma]": "perturb: value 'agent.algorithm.gamma' does not exist",
  "  env.scene.num-envs: [8, 16]\nperturb: [env.scene.num-envs]": "of the environment only weights of rewards can",
  "  agent.algorithm.learning-rate: [1e-3]\nperturb: [agent.algorithm.learning-rate]": "algorithm.schedule fixed",
}


CASES = [
  *((text, (), message) for text, message in MISTAKES.items()),
  *((VALUES + more, ("--scheduler", "pbt"), message) for more, message in PBT_MISTAKES.items()),
]


@pytest.mark.parametrize(("text", "flags", "message"), CASES)
def test_a_mistake_in_the_file_of_values_is_named(
  text: str, flags: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
  space = tmp_path / "space.yaml"
  space.write_text(text)
  assert sweep([TASK, "--space", str(space), "--log-root", str(tmp_path / "logs"), *flags]) != 0
  assert not (tmp_path / "logs").exists()
  error = capsys.readouterr().err
  assert message in error
  assert "Traceback" not in error


def test_values_of_a_trial_are_flags() -> None:
  values = {"agent.algorithm.gamma": 0.9, "agent.actor.obs-normalization": False, "env.sim.capture": True}
  assert trial_flags(values) == [
    *("--agent.algorithm.gamma", "0.9"),
    *("--agent.actor.no-obs-normalization", "--env.sim.capture"),
  ]


def test_results_are_a_table_and_a_picture_with_the_best_trial_first(tmp_path: Path) -> None:
  space = Space(values={KL: Range(0.001, 0.1, log=True), "agent.actor.activation": ["elu", "relu"]})
  found = [(0.002, "elu", 3.0), (0.05, "relu", 7.5), (0.01, "elu", math.nan)]
  trials = [
    Trial(str(i), {KL: kl, "agent.actor.activation": name}, reward, 20, "failed" if math.isnan(reward) else "done")
    for i, (kl, name, reward) in enumerate(found)
  ]
  said = report(trials, space, tmp_path).splitlines()
  assert said[0].split() == ["trial", "reward", "iterations", "state", "desired-kl", "activation"]
  assert [line.split()[0] for line in said[1:4]] == ["1", "0", "2"]
  with (tmp_path / "trials.csv").open(newline="") as file:
    assert [row["agent.actor.activation"] for row in csv.DictReader(file)] == ["relu", "elu", "elu"]
  assert (tmp_path / "trials.png").read_bytes().startswith(b"\x89PNG")


needs_ray = pytest.mark.skipif(
  find_spec("ray") is None,
  reason="sweeps need Ray, the extra sweep of mjlab, which the developers' environment lacks",
)
# Each trial imports everything, and there are two cores for all of them [s].
LONG = 1200.0
SMALL = ("--env.scene.num-envs", "8", "--agent.max-iterations", "4", "--agent.num-steps-per-env", "40")
DONE = r"(?m)^\w+ +[-\d.]+ +\d+ +done"
CLUSTER = """
import threading, ray
print("cluster at", ray.init(num_cpus=2, include_dashboard=False).address_info["gcs_address"], flush=True)
threading.Event().wait()
"""


def results(folder: Path) -> list[list[dict[str, Any]]]:
  """Return the reports of each trial, in their order."""
  return [list(map(json.loads, path.read_text().splitlines())) for path in folder.glob("*/result.json")]


@needs_ray
@pytest.mark.slow
def test_resume_continues_trials_that_ctrl_c_ended(tmp_path: Path) -> None:
  (tmp_path / "space.yaml").write_text(VALUES)
  folder = tmp_path / "logs" / "sweeps" / "four"
  with running(
    COMMAND, TASK, "--space", "space.yaml", "--trials", "4", "--name", "four", *SMALL, folder=tmp_path
  ) as command:
    command.wait_until(lambda: any(results(folder)), LONG)
    said = command.interrupt(LONG)
  assert f"not all trials are done: sweep {TASK} --resume four continues them" in said
  assert re.search(r"(?m)^\w+ +\S+ +\d+ +stopped", said)
  with running(COMMAND, TASK, "--resume", "four", folder=tmp_path) as command:
    command.wait_for(r"wrote .*trials.png", LONG)
    said = command.said
  assert len(re.findall(DONE, said)) == 4
  assert "not all trials are done" not in said
  with (folder / "trials.csv").open(newline="") as file:
    rows = list(csv.DictReader(file))
  assert max(int(row["iterations"]) for row in rows) == 4
  assert all(5e-3 <= float(row[KL]) <= 0.05 for row in rows)


@needs_ray
@pytest.mark.slow
def test_a_population_copies_learners_and_changes_only_named_values(tmp_path: Path) -> None:
  (tmp_path / "space.yaml").write_text(f"{VALUES}perturb: [{ENTROPY}]\n")
  words = (TASK, "--space", "space.yaml", "--trials", "4", "--name", "four", "--scheduler", "pbt")
  with running(COMMAND, *words, *SMALL, folder=tmp_path) as command:
    command.wait_for(r"wrote .*trials.png", LONG)
    said = command.said
  assert len(re.findall(DONE, said)) == 4, said
  found = results(tmp_path / "logs" / "sweeps" / "four")
  drawn = {trial[0]["config"][KL] for trial in found}
  assert {line["config"][KL] for trial in found for line in trial} <= drawn
  for trial in found:
    # A part of a trial begins with the iteration after the checkpoint, so that none is lost.
    iterations = [line["iteration"] for line in trial]
    assert iterations == sorted(iterations)
    assert iterations[-1] == 4


@needs_ray
@pytest.mark.slow
def test_trials_run_on_a_cluster(tmp_path: Path) -> None:
  (tmp_path / "space.yaml").write_text(VALUES)
  words = (TASK, "--space", "space.yaml", "--trials", "2", "--scheduler", "none", "--name", "two")
  with running(COMMAND, *words, *SMALL, "--address", "127.0.0.1:1", folder=tmp_path) as command:
    command.wait_for("error: --address 127.0.0.1:1: .*refused")
  # All that reaches a cluster shares its token.
  token: dict[str, Any] = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": "0" * 64}
  with running(CLUSTER, folder=tmp_path, **token) as cluster:
    address = cluster.wait_for(r"cluster at (\S+)")[1]
    with running(COMMAND, TASK, "--resume", "two", "--address", address, folder=tmp_path, **token) as command:
      command.wait_for(r"wrote .*trials.png", LONG)
      assert len(re.findall(DONE, command.said)) == 2, command.said
    assert cluster.exit_code is None
