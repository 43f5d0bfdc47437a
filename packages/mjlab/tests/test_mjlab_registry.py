import importlib
from typing import Any

import mjlab
import mjlab.registry as registry
import mjlab_pendulum
import pytest
import torch
from mjlab.environments import default_num_envs, resolve_device
from mjlab_core import MjlabError, UnknownNameError
from mjlab_rl.encoding import decode, encode


@pytest.fixture(autouse=True)
def _registers_nothing_for_good(monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setattr(registry, "_registered", {})


@pytest.fixture
def pendulum() -> str:
  mjlab.register_task("Test-Pendulum", mjlab_pendulum.pendulum)
  return "Test-Pendulum"


def test_a_registered_task_is_listed_and_loaded_fresh(pendulum: str) -> None:
  assert pendulum in mjlab.list_tasks()
  first, second = mjlab.load_task(pendulum), mjlab.load_task(pendulum)
  assert first.env == second.env
  assert first.env is not second.env


def test_an_unknown_task_names_the_nearest(pendulum: str) -> None:
  with pytest.raises(MjlabError, match=r"task 'Test-Pendulun' does not exist\. Nearest: Test-Pendulum"):
    mjlab.load_task("Test-Pendulun")


def test_an_id_is_registered_once(pendulum: str) -> None:
  with pytest.raises(MjlabError, match="registered already"):
    mjlab.register_task(pendulum, mjlab_pendulum.pendulum)


def test_what_is_no_function_that_returns_a_task_is_a_clear_error() -> None:
  wrong: dict[str, Any] = {"int": lambda: 3, "module": mjlab_pendulum}
  for kind, build in wrong.items():
    mjlab.register_task(f"Test-{kind}", build)
    with pytest.raises(MjlabError, match=rf"must name a function that returns a mjlab_rl\.TaskCfg; got {kind}"):
      mjlab.load_task(f"Test-{kind}")


def test_make_builds_a_stepping_environment(pendulum: str) -> None:
  env = mjlab.make(pendulum, num_envs=3, device="cpu")
  obs, _ = env.reset(seed=0)
  obs, reward, terminated, truncated, _ = env.step(torch.zeros(3, 1))
  assert obs.keys() == {"actor", "critic"}
  assert reward.shape == terminated.shape == truncated.shape == (3,)
  env.close()


def test_play_changes_the_training_configuration(pendulum: str) -> None:
  env = mjlab.make(pendulum, num_envs=1, device="cpu", play=True)
  assert env.max_episode_length_s == 1e6
  env.close()


@pytest.mark.parametrize(
  ("device", "configured", "worlds"), [("cuda:0", 1, 4096), ("cuda:0", 512, 512), ("cpu", 32, 32)]
)
def test_worlds_follow_the_task_and_the_device(device: str, configured: int, worlds: int) -> None:
  assert default_num_envs(device, configured) == worlds


def test_a_cpu_gets_worlds_by_its_cores(monkeypatch: pytest.MonkeyPatch) -> None:
  for cores, worlds in ((0, 64), (2, 256), (64, 1024)):
    monkeypatch.setattr("mjlab.environments.cpu_cores", lambda cores=cores: cores)
    assert default_num_envs("cpu", 4096) == worlds


def test_a_device_that_is_not_there_is_named() -> None:
  with pytest.raises(UnknownNameError, match=r"'cuda:99' does not exist\..* cpu"):
    resolve_device("cuda:99")


def test_every_public_name_exists() -> None:
  for name in mjlab.__all__:
    assert getattr(importlib.import_module("mjlab"), name) is not None
  assert set(mjlab.__all__) <= set(dir(mjlab))


def test_the_configuration_of_every_task_survives_the_manifest(pendulum: str) -> None:
  for name in mjlab.list_tasks():
    task: Any = mjlab.load_task(name)
    for cfg in (task.env, task.agent):
      assert decode(encode(cfg)) == cfg
      assert encode(decode(encode(cfg))) == encode(cfg)
