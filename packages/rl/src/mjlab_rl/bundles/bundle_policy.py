"""Policies of bundles in the environment of their task."""

import contextlib
import copy
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from mjlab_core import match_names, match_values_full
from mjlab_core.errors import FileError, MjlabError

from mjlab_rl.env_protocol import RlEnv
from mjlab_rl.runs.checkpoint import refuse

if TYPE_CHECKING:
  from mjlab_deploy import Bundle, Description


def is_bundle(path: Path) -> bool:
  """Return True for the path of a bundle: a folder with `bundle.json`, or a zip."""
  return (path / "bundle.json").is_file() or (path.suffix == ".zip" and path.is_file())


def task_of_bundle(path: Path) -> str:
  """Return the task id of a bundle.

  Raises:
    FileError: It cannot be read.
  """
  with _opened(path) as bundle:
    return bundle.description.task


@contextlib.contextmanager
def _opened(path: Path) -> "Generator[Bundle]":
  """Open a bundle; errors inside become `FileError`."""
  # ONNX Runtime is not needed to view checkpoints.
  from mjlab_deploy import DeployError, open_bundle

  try:
    with open_bundle(path) as bundle:
      yield bundle
  except DeployError as error:
    raise FileError(str(error)) from error


class BundlePolicy:
  """Policy of a bundle, run by ONNX Runtime world by world.

  The graph reads the simulation as it would read a robot, so noise and delays of observations do not reach it.

  Args:
    path: Folder or zip.
    env: Environment that it acts in, with managers.

  Raises:
    FileError: It cannot be read, or it does not fit the environment; the message gives both values.
  """

  def __init__(self, path: Path, env: RlEnv) -> None:
    from mjlab_deploy import Policy

    from mjlab_rl.bundles.policy_graph import readings_of

    self._env: Any = env
    with _opened(path) as bundle:
      description, policy = bundle.description, Policy(bundle)
    groups = dict.fromkeys(term.group for term in description.observations)
    found = readings_of(self._env, [group for group in groups if group in self._env.observation_manager.active_terms])
    refuse(f"bundle {path}", _differences(description, found, self._env))
    self._readings = {item.name: found[item.name] for item in description.inputs}
    # One session, and a memory for each world.
    self._policies = [copy.copy(policy) for _ in range(env.num_envs)]
    self.reset(None)

  def __call__(self, observations: Mapping[str, Any]) -> torch.Tensor:
    """Return actions (num_envs, num_actions) for the present state of the environment."""
    del observations
    values = {name: reading.read().detach().cpu().float().numpy() for name, reading in self._readings.items()}
    rows = [
      policy.step({name: value[i] for name, value in values.items()}).action for i, policy in enumerate(self._policies)
    ]
    return torch.from_numpy(np.stack(rows)).to(self._env.device)

  def reset(self, dones: torch.Tensor | None) -> None:
    """Clear the memory of these worlds, bool (num_envs,); None: of all."""
    for i, policy in enumerate(self._policies):
      if dones is None or bool(dones[i]):
        policy.reset()


def _differences(description: "Description", readings: Mapping[str, Any], env: Any) -> Iterator[str]:
  for item in description.inputs:
    if item.name not in readings:
      yield f"it reads '{item.name}', which the environment does not observe"
      continue
    reading = readings[item.name]
    shape, columns = tuple(reading.read().shape[1:]), tuple(reading.columns)
    if (shape, columns) != (item.shape, item.columns):
      there = f"{item.shape} {', '.join(item.columns)}"
      yield f"'{item.name}' is {there} in the bundle and {shape} {', '.join(columns)} in the environment"
  if (count := env.action_manager.total_action_dim) != len(description.action_names):
    yield f"it has {len(description.action_names)} actions, the environment {count}"
  if (entity := env.scene.entities.get(description.robot.name)) is None:
    yield f"its robot is '{description.robot.name}'; the scene has {', '.join(env.scene.entities)}"
    return
  joints = [joint for joint in description.robot.joints if joint.name in entity.joint_names]
  for gain in ("stiffness", "damping"):
    here = configured(entity, gain, [joint.name for joint in joints])
    for joint, value in zip(joints, here, strict=True):
      trained = getattr(joint, gain)
      if trained is not None and value is not None and not np.isclose(trained, value, rtol=1e-4):
        yield f"{gain} of '{joint.name}' was {trained:g} in its training and is {value:g} here"


def configured(entity: Any, gain: str, joints: Sequence[str]) -> list[float | None]:
  """Return the configured gain or limit of each joint; None where its actuator has none."""
  found: dict[str, float] = {}
  for cfg in entity.cfg.articulation.actuators if entity.cfg.articulation is not None else ():
    if (values := getattr(cfg, gain, None)) is None or cfg.transmission_type != "joint":
      continue
    names = match_names(cfg.target_names_expr, entity.joint_names, what="joint")[1]
    with contextlib.suppress(MjlabError):
      found |= zip(names, match_values_full(values, names, what="joint"), strict=True)
  return [found.get(joint) for joint in joints]
