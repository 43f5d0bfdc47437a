"""Every registered task, for training and for watching: built, stepped, reset, saved, drawn and written down."""

import copy
import dataclasses
import json
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import mjlab
import mujoco
import pytest
import torch
from mjlab import cli
from mjlab.environments import make
from mjlab_core import RenderingError
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import ReturnEvaluation
from mjlab_rl.runs.manifest import RunManifest, encode_manifest, load_run, write_manifest
from mjlab_sensors import RayCastSensor
from mjlab_viewer import SnapshotTaker

WORLDS = 5
STEPS = 10
VARIANTS = ("-Blind", "-Distill", "-IK", "-No-State-Estimation")
SCENES = [name for name in mjlab.list_tasks() if not name.endswith(VARIANTS)]
"""Tasks with a separate scene."""


def seen(observations: dict[str, Any]) -> list[torch.Tensor]:
  """All tensors of observations, those of groups that are not concatenated included."""
  return [t for value in observations.values() for t in (value.values() if isinstance(value, dict) else [value])]


def leaves(state: Any, where: str = "") -> dict[str, Any]:
  if isinstance(state, dict):
    return {name: leaf for key, value in state.items() for name, leaf in leaves(value, f"{where}.{key}").items()}
  return {where: state}


def changeable(value: Any, where: str = "") -> list[tuple[int, str]]:
  """Return identity and place of each dictionary, list and open dataclass; shared ones have several places."""
  if isinstance(value, dict):
    inside = {f"[{key!r}]": item for key, item in value.items()}
  elif isinstance(value, list | tuple):
    inside = {f"[{i}]": item for i, item in enumerate(value)}
  elif dataclasses.is_dataclass(value) and not isinstance(value, type):
    inside = {f".{field.name}": getattr(value, field.name) for field in dataclasses.fields(value)}
  else:
    return []
  is_frozen = isinstance(value, tuple) or getattr(getattr(value, "__dataclass_params__", None), "frozen", False)
  found = [] if is_frozen else [(id(value), where)]
  for name, item in inside.items():
    found += changeable(item, where + name)
  return found


def act(env: ManagerBasedRlEnv, generator: torch.Generator) -> list[torch.Tensor]:
  """One step of random actions; everything it returns, checked for being what it should be."""
  action = torch.randn(WORLDS, env.action_manager.total_action_dim, generator=generator)
  observations, reward, terminated, truncated, _ = env.step(action)
  assert set(observations) == set(env.single_observation_space.spaces)
  for tensor in (*seen(observations), reward):
    assert tensor.shape[0] == WORLDS
    assert tensor.isfinite().all()
  assert terminated.dtype == truncated.dtype == torch.bool
  return [*seen(observations), reward, terminated, truncated]


def can_be_drawn(env: ManagerBasedRlEnv) -> None:
  """Draw the rays of all sensors and, where there is OpenGL, a picture with something in each of its four tiles."""
  for name, sensor in env.scene.sensors.items():
    if isinstance(sensor, RayCastSensor):
      snapshot = SnapshotTaker(env).take((1,), drawers=(f"sensor {name}",))
      assert snapshot.drawings[0].shapes, f"nothing is drawn of the rays of {name}"
  assert env.render() is None
  env.render_mode = "rgb_array"
  try:
    picture = env.render()
  except RenderingError as error:
    pytest.skip(str(error))
  assert picture is not None
  assert picture.shape == (480, 640, 3)
  for rows in (slice(0, 240), slice(240, 480)):
    for columns in (slice(0, 320), slice(320, 640)):
      assert picture[rows, columns].std() > 5


@pytest.mark.parametrize(
  ("name", "play"), [*((name, False) for name in mjlab.list_tasks()), *((name, True) for name in SCENES)]
)
def test_every_task_steps_resets_some_worlds_and_goes_on_from_a_saved_state(name: str, play: bool) -> None:
  generator = torch.Generator().manual_seed(0)
  with make(name, num_envs=WORLDS, device="cpu", play=play) as env:
    observations, _ = env.reset(seed=0)
    assert all(tensor.isfinite().all() for tensor in seen(observations))
    for _ in range(STEPS):
      act(env, generator)

    before = seen(env.get_observations())
    observations, _ = env.reset(env_ids=[1, 3])
    for old, new in zip(before, seen(observations), strict=True):
      assert torch.equal(old[[0, 2, 4]], new[[0, 2, 4]])
    assert env.episode_length_buf[[1, 3]].eq(0).all()

    assert all(isinstance(value, float) for value in env.drain_log().values())
    assert env.describe()
    if play:
      can_be_drawn(env)
      return
    saved = copy.deepcopy(env.state_dict())
    moved = generator.get_state()
    expected = [act(env, generator) for _ in range(3)]
    # Variants go on in the same environment, after everything in it was drawn again.
    with make(name, num_envs=WORLDS, device="cpu") if name in SCENES else nullcontext(env) as other:
      other.reset(seed=1)
      other.event_manager.apply("startup")
      act(other, generator)
      other.load_state_dict(saved)
      restored = leaves(other.state_dict())
      for key, value in leaves(saved).items():
        assert torch.equal(restored[key], value) if isinstance(value, torch.Tensor) else restored[key] == value, key
      generator.set_state(moved)
      for one in expected:
        assert all(torch.equal(a, b) for a, b in zip(one, act(other, generator), strict=True))


@pytest.mark.parametrize("name", mjlab.list_tasks())
def test_changing_one_part_of_a_task_changes_no_other_part_and_no_other_task(name: str) -> None:
  two = (mjlab.load_task(name), mjlab.load_task(name))
  places: dict[int, list[str]] = {}
  for identity, where in changeable(two):
    places.setdefault(identity, []).append(where)
  assert [shared for shared in places.values() if len(shared) > 1] == []


@pytest.mark.parametrize("name", mjlab.list_tasks())
def test_every_task_is_rebuilt_from_the_manifest_of_a_run(name: str, tmp_path: Any) -> None:
  task = mjlab.load_task(name)
  manifest = RunManifest(task=name, env=task.env, agent=task.agent, play=task.play)
  write_manifest(tmp_path, manifest)
  run = load_run(tmp_path)
  assert run.env == task.env
  assert run.agent == task.agent
  assert json.dumps(encode_manifest(run)) == json.dumps(encode_manifest(manifest))
  if task.play is not None:
    assert run.play is task.play
    assert task.play(copy.deepcopy(run.env)) == task.play(copy.deepcopy(task.env))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("name", mjlab.list_tasks())
def test_every_task_is_one_graph_that_never_waits_on_a_gpu(name: str) -> None:
  with make(name, num_envs=64, device="cuda:0") as env:
    env.reset(seed=0)
    actions = torch.randn(40, 64, env.action_manager.total_action_dim, device=env.device)
    for action in actions[:8]:
      env.step(action)
    assert env.is_captured
    assert env.num_graphs == 1
    # Worlds that end, all of them, do so inside of the recording too.
    env.episode_length_buf.fill_(env.max_episode_length - 10)
    try:
      torch.cuda.set_sync_debug_mode("error")
      outputs = [env.step(action) for action in actions[8:]]
    finally:
      torch.cuda.set_sync_debug_mode("default")
    assert env.num_graphs == 1
    for observations, reward, *_ in outputs:
      assert all(tensor.isfinite().all() for tensor in (*seen(observations), reward))
    ended = torch.stack([terminated | truncated for _, _, terminated, truncated, _ in outputs])
    assert ended.any(0).all()


@pytest.mark.parametrize("name", mjlab.list_tasks())
def test_every_task_can_be_evaluated(name: str) -> None:
  task = mjlab.load_task(name)
  evaluator = task.evaluator or ReturnEvaluation()
  cfg = evaluator.configure(task.env)
  assert cfg.scene.num_envs > 1
  cfg.scene.num_envs, cfg.episode_length_s = WORLDS, 0.2
  generator = torch.Generator().manual_seed(0)
  with (task.make_env or ManagerBasedRlEnv)(cfg, device="cpu") as env:

    def policy(observations: Any) -> torch.Tensor:
      return torch.randn(WORLDS, env.action_manager.total_action_dim, generator=generator)

    result = evaluator.run(env, policy)
  assert result.table()
  json.dumps(result.to_json(), allow_nan=False)
  assert all(interval.count <= WORLDS for interval in result.groups["all"].values())


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_is_exported_as_a_model_that_mujoco_opens(name: str, tmp_path: Path) -> None:
  assert cli.main(["export-scene", name, "--output", str(tmp_path / "scene"), "--env.scene.num-envs", "2"]) == 0
  model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene" / "scene.xml"))
  mujoco.mj_step(model, mujoco.MjData(model))
