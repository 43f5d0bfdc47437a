import importlib
from typing import Any

import mjlab
import mjlab.registry as registry
import mjlab_pendulum
import pytest
import torch
from mjlab.environments import default_num_envs
from mjlab_core import MjlabError
from mjlab_rl.runs.encoding import decode, encode


@pytest.fixture(autouse=True)
def _restored_registry(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_an_id_is_registered_once(pendulum: str) -> None:
  with pytest.raises(MjlabError, match="registered already"):
    mjlab.register_task(pendulum, mjlab_pendulum.pendulum)


def test_an_entry_point_must_return_a_task() -> None:
  wrong: dict[str, Any] = {"int": lambda: 3, "module": mjlab_pendulum}
  for kind, build in wrong.items():
    mjlab.register_task(f"Test-{kind}", build)
    with pytest.raises(MjlabError, match=rf"must name a function that returns a mjlab_rl\.TaskCfg; got {kind}"):
      mjlab.load_task(f"Test-{kind}")


def test_make_builds_an_environment_for_training_or_watching(pendulum: str) -> None:
  env = mjlab.make(pendulum, num_envs=3, device="cpu")
  obs, _ = env.reset(seed=0)
  obs, reward, terminated, truncated, _ = env.step(torch.zeros(3, 1))
  assert obs.keys() == {"actor", "critic"}
  assert reward.shape == terminated.shape == truncated.shape == (3,)
  assert env.max_episode_length_s == 0.5
  env.close()
  env = mjlab.make(pendulum, num_envs=1, device="cpu", play=True)
  assert env.max_episode_length_s == 1e6
  env.close()


def test_the_number_of_environments_follows_task_device_and_cores(monkeypatch: pytest.MonkeyPatch) -> None:
  rows = (("cuda:0", 1, 2, 4096), ("cuda:0", 512, 2, 512), ("cpu", 32, 2, 32))
  rows += (("cpu", 4096, 0, 64), ("cpu", 4096, 2, 256), ("cpu", 4096, 64, 1024))
  for device, configured, cores, num_envs in rows:
    monkeypatch.setattr("mjlab.environments.cpu_cores", lambda cores=cores: cores)
    assert default_num_envs(device, configured) == num_envs


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
