import enum
import functools
import json
import math
import threading
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
from mjlab_core.errors import ConfigError, FileError, UnknownNameError
from mjlab_rl import RslRlOnPolicyRunnerCfg, RunManifest, find_checkpoint, load_run
from mjlab_rl.runs.encoding import decode, encode
from mjlab_rl.runs.manifest import package_versions, write_manifest
from mjlab_rl.runs.references import resolve
from mjlab_rl.runs.run_directory import create_run_directory
from rl_point_env import PointEnvCfg, point_reward


def roundtrip(value: Any) -> Any:
  return decode(json.loads(json.dumps(encode(value), allow_nan=False)))


class Colour(enum.Enum):
  RED = 1


class Pair(NamedTuple):
  low: float
  high: float


@dataclass(frozen=True)
class Frozen:
  values: tuple[float, ...] = (1.0,)
  kept: int = field(default=3, init=False)


@pytest.mark.parametrize(
  "value",
  [
    None,
    True,
    1,
    0.1 + 0.2,
    -0.0,
    math.inf,
    "text",
    [1, [2.0]],
    (1, (2.0, [3])),
    {"a": (1,), "$odd": 2},
    {1: "one", (2, 3): "pair"},
    {1, 2},
    frozenset({"x"}),
    slice(None, 3),
    range(1, 9, 2),
    Path("a/b"),
    RslRlOnPolicyRunnerCfg(clip_actions=100.0),
    Pair(0.1, 2.0),
    Frozen((0.1,)),
    Colour.RED,
    PointEnvCfg(rewards={"f": point_reward, "kind": PointEnvCfg}),
    mujoco.mjtGeom.mjGEOM_BOX,
  ],
  ids=lambda value: type(value).__name__,
)
def test_values_come_back_equal_and_of_the_same_type(value: Any) -> None:
  back = roundtrip(value)
  assert back == value
  assert type(back) is type(value)
  assert repr(back) == repr(value)


def test_nan_and_arrays_and_partials_come_back() -> None:
  assert math.isnan(roundtrip(math.nan))
  array = np.array([[1.5, np.inf]], dtype=np.float32)
  back = roundtrip(array)
  assert back.dtype == array.dtype
  assert np.array_equal(back, array)
  assert roundtrip(np.float64(0.1)) == 0.1
  partial = roundtrip(functools.partial(point_reward, weight=2.0))
  assert partial.func is point_reward
  assert partial.keywords == {"weight": 2.0}


@pytest.mark.parametrize(
  ("value", "message"),
  [
    (lambda env: env, ": a lambda has no importable name"),
    (functools.partial(lambda x: x, 1), ": a lambda has no importable name"),
    ([1, threading.Lock()], r"\[1\]: a _thread.lock cannot be written"),
  ],
)
def test_a_value_that_cannot_be_written_is_refused_with_its_field(value: Any, message: str) -> None:
  with pytest.raises(ConfigError, match=f"env.rewards.mine{message}"):
    encode(PointEnvCfg(rewards={"mine": value}), "env")


def test_all_fields_with_lambdas_are_refused_together() -> None:
  rewards = {"a": lambda env: env, "b": point_reward, "c": [1, lambda env: env]}
  with pytest.raises(ConfigError) as caught:
    encode(PointEnvCfg(rewards=rewards), "env")
  assert [problem.partition(":")[0] for problem in caught.value.problems] == ["env.rewards.a", "env.rewards.c[1]"]
  assert "write `def` at the top of a module" in caught.value.problems[0]


@pytest.mark.parametrize(
  ("data", "message"),
  [
    ({"f": {"$ref": "rl_point_env:point_rewards"}}, r"'rl_point_env' has no 'point_rewards'\. Nearest: point_reward"),
    ({"$type": "rl_point_env:PointEnvCfg", "fields": {"colour": 1}}, "PointEnvCfg: field 'colour' does not exist"),
    ({"$type": "rl_point_env:point_reward", "fields": {}}, "is not a dataclass"),
    ({"$enum": f"{__name__}:Colour", "name": "BLUE"}, r"enum '.*:Colour': member 'BLUE' does not exist"),
    ({"$type": f"{__name__}:Pair", "fields": {"low": 1.0}}, r"env: .type: Pair.* 'high'"),
  ],
)
def test_an_unknown_name_is_in_the_message(data: Any, message: str) -> None:
  with pytest.raises(FileError, match=message):
    decode(data, "env")


@pytest.mark.parametrize(
  "value",
  [
    {"$tuple": 3},
    {"$set": {"a": 1}},
    {"$set": [[1]]},
    {"$range": [1, 2]},
    {"$range": [1.5, 2, 1]},
    {"$float": "1.0"},
    {"$path": 3},
    {"$dict": [1]},
    {"$partial": "rl_point_env:point_reward", "args": [], "keywords": {}},
    {"$array": [1], "dtype": "O", "shape": [1]},
    {"$array": [1], "dtype": "float32", "shape": [10**12]},
    {"$array": [1], "shape": [1]},
    {"$colour": "red"},
  ],
  ids=str,
)
def test_an_unknown_or_malformed_value_is_refused_with_its_field(value: Any) -> None:
  with pytest.raises(FileError, match=r"^env\.f: \$"):
    decode({"f": value}, "env")


@pytest.mark.parametrize(
  ("text", "message"),
  [
    ("", ""),
    ("[]", ""),
    ("\udcff", ""),
    ("[" * 100_000, ""),
    ('{"format": 1}', ""),
    ('{"format": 1, "colour": 2}', "RunManifest: field 'colour' does not exist"),
    ('{"format": 1, "task": 3, "env": null, "agent": null}', ""),
  ],
  ids=lambda text: text[:60],
)
def test_a_file_that_is_not_a_manifest_is_refused(tmp_path: Path, text: str, message: str) -> None:
  (tmp_path / "manifest.json").write_bytes(text.encode(errors="surrogateescape"))
  with pytest.raises(FileError, match=rf"manifest .*manifest\.json: {message}"):
    load_run(tmp_path)


def test_versions_are_those_of_all_members_and_of_the_stack() -> None:
  versions = package_versions()
  members = {name for dist in metadata.distributions() if (name := dist.name).startswith("mjlab")}
  assert members | {"python", "platform", "torch", "rsl-rl-lib", "tensordict", "numpy"} <= versions.keys()
  assert versions["mjlab-rl"] == metadata.version("mjlab-rl")


def test_a_manifest_is_found_from_its_run_its_checkpoint_and_itself(tmp_path: Path) -> None:
  manifest = RunManifest(task="T", env=PointEnvCfg(gains=(0.1, 1e-17)), agent=RslRlOnPolicyRunnerCfg())
  path = write_manifest(tmp_path, manifest)
  for given in (tmp_path, path, tmp_path / "model_10.pt"):
    assert load_run(given) == manifest
  with pytest.raises(FileNotFoundError, match=r"is .* a run directory"):
    load_run(tmp_path / "elsewhere" / "model_1.pt")


def test_run_directories_of_one_second_differ(tmp_path: Path) -> None:
  made = [create_run_directory(tmp_path, "exp", "name") for _ in range(3)]
  assert len(set(made)) == 3


def test_a_log_root_that_cannot_be_made_is_an_error_at_once(tmp_path: Path) -> None:
  (tmp_path / "gone").symlink_to(tmp_path / "unmounted")
  with pytest.raises(FileExistsError):
    create_run_directory(tmp_path / "gone", "exp")


def make_run(logs: Path, name: str, *files: str) -> Path:
  run = logs / "exp" / name
  run.mkdir(parents=True)
  for file in files:
    (run / file).touch()
  return run


def test_the_newest_run_with_a_checkpoint_is_the_latest(tmp_path: Path) -> None:
  trained = make_run(tmp_path, "2026-01-01_00-00-00", "model_9.pt", "model_10.pt", "model_11.pt.bak")
  make_run(tmp_path, "2026-01-02_00-00-00")
  newest = trained / "model_10.pt"
  for run in ("latest", "2026-01-01_00-00-00", str(newest.parent), str(newest)):
    assert find_checkpoint(run, log_root=tmp_path, experiment="exp") == newest
  for run, experiment, message in (
    ("2025", "exp", "newest runs: 2026-01-02"),
    ("2025", "", "newest runs: exp/2026-01-02_00-00-00, exp/2026-01-01_00-00-00$"),
    ("latest", "other", "no run with a checkpoint"),
    (str(tmp_path / "exp"), "exp", r"exp has no checkpoint; the newest run in it .*2026-01-01_00-00-00$"),
  ):
    with pytest.raises(UnknownNameError, match=message):
      find_checkpoint(run, log_root=tmp_path, experiment=experiment)


def test_the_latest_run_of_a_task_is_found_among_runs_of_others(tmp_path: Path) -> None:
  for day, task in enumerate(("Flat", "Rough"), start=1):
    run = make_run(tmp_path, f"2026-01-0{day}_00-00-00", "model_1.pt")
    (run / "manifest.json").write_text(json.dumps({"task": task}))
  for task, day in (("Flat", "2026-01-01"), ("Rough", "2026-01-02"), (None, "2026-01-02")):
    found = find_checkpoint("latest", log_root=tmp_path, experiment="exp", task=task)
    assert found.parent.name.startswith(day)
  with pytest.raises(UnknownNameError, match=r"no run of Steep .*; 2026-01-02_00-00-00 is of another task, and must"):
    find_checkpoint("latest", log_root=tmp_path, experiment="exp", task="Steep")


def test_the_later_of_two_runs_of_one_second_is_the_latest(tmp_path: Path) -> None:
  for run in ("2026-01-01_00-00-00_name", "2026-01-01_00-00-00.2_name", "notes"):
    make_run(tmp_path, run, "model_1.pt")
  assert find_checkpoint("latest", log_root=tmp_path, experiment="exp").parent.name == "2026-01-01_00-00-00.2_name"


# Class: a name that is read from a file (here a run's configuration) becomes part of a path.
@pytest.mark.parametrize("name", ["../../outside", "ABSOLUTE", "..", "a/b", "\x1b[2J\nname", r"..\outside"])
def test_names_of_runs_and_experiments_are_single_folders(tmp_path: Path, name: str) -> None:
  root = tmp_path / "home" / "logs"
  name = name.replace("ABSOLUTE", str(tmp_path / "outside"))
  run = create_run_directory(root, name, name)
  assert run.is_dir()
  assert run.parent.parent == root
  assert run.resolve().is_relative_to(root.resolve())
  assert str(run).isprintable()
  assert [path.name for path in tmp_path.iterdir()] == ["home"]
  (run / "model_5.pt").write_bytes(b"")
  assert find_checkpoint("latest", log_root=root, experiment=name) == run / "model_5.pt"


def test_a_function_that_has_moved_is_found_where_its_package_exports_it() -> None:
  for former in ("former_module", "config", "gone.former_module"):
    assert resolve(f"mjlab_rl.{former}:find_checkpoint", "env") is find_checkpoint
  for hidden in ("mjlab_rl.former_module:os", "mjlab_rl.former_module:reference", "mjlab_gone.gone:find_checkpoint"):
    with pytest.raises(FileError, match=r"refused|has no|cannot be imported"):
      resolve(hidden, "env")
