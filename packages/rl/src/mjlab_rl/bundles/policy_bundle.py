"""Export of policies as bundles for mjlab-deploy."""

import itertools
import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from mjlab_core.errors import MjlabError
from mjlab_core.io.files import AtomicWrite
from mjlab_deploy import (
  Command,
  Description,
  Golden,
  Input,
  Joint,
  Memory,
  Motion,
  Origin,
  Robot,
  Target,
  Timing,
  pack,
  write_description,
)
from mjlab_deploy.arrays import write_arrays
from mjlab_deploy.description import EPISODE_START, LAST_ACTION
from mjlab_deploy.simulation.model_readings import joint_facts
from mjlab_deploy.simulation.scene import write_scene

from mjlab_rl.bundles.bundle_policy import configured
from mjlab_rl.bundles.policy_graph import GraphAction, PolicyGraph, Tensors, export_onnx, refresh_weights
from mjlab_rl.config import RslRlBaseRunnerCfg
from mjlab_rl.runs.manifest import package_versions

GOLDEN_STEPS = 500
"""Steps of the record in a bundle."""


class BundleWriter:
  """Writer of bundles. The graph is traced once; later bundles take only the new weights.

  Args:
    env: Environment that the policy acts in.
    agent: Configuration of the learner.
    task: Task id.

  Raises:
    MjlabError: The policy cannot be exported; the message names the term.
  """

  def __init__(self, env: Any, agent: RslRlBaseRunnerCfg, task: str) -> None:
    self._env, self._agent, self._task = env, agent, task
    self._model: Any = None
    self._scene: dict[str, bytes] | None = None

  def write(
    self,
    folder: Path,
    network: Any,
    *,
    training: Mapping[str, Any] | None = None,
    evaluation: Mapping[str, Any] | None = None,
    golden: Mapping[str, np.ndarray] | None = None,
    picture: bytes | None = None,
  ) -> Description:
    """Write a bundle into a folder; an existing one is replaced.

    Args:
      folder: The folder.
      network: The policy's network, a model of rsl-rl.
      training: Summary of the training.
      evaluation: Statistics of the policy.
      golden: Record that `record` made; None: the bundle has none.
      picture: PNG file.

    Returns:
      The contents of `bundle.json`, without hashes.
    """
    graph = PolicyGraph(self._env, self._agent, network)
    if self._model is None or not refresh_weights(self._model, graph.network.state_dict()):
      example = graph.read() | graph.start()
      self._model = export_onnx(graph, tuple(example.values()), graph.input_names, graph.output_names)
    with AtomicWrite(folder) as made:
      made.mkdir()
      onnx.save(self._model, made / "policy.onnx")
      self._write_scene(made)
      if golden is not None:
        write_arrays(made / "golden.npz", golden)
      if picture is not None:
        (made / "picture.png").write_bytes(picture)
      description = _describe(
        self._env,
        graph,
        task=self._task,
        motion=_write_motion(self._env, made),
        golden=None if golden is None else Golden(steps=len(golden["action"]), engine=str(self._env.sim.engine)),
        has_scene=bool(self._scene),
        created=datetime.now().astimezone().isoformat(timespec="seconds"),
        versions=dict(package_versions()),
        training=_plain(training or {}),
        evaluation=_plain(evaluation or {}),
      )
      write_description(made, description)
    return description

  def _write_scene(self, folder: Path) -> None:
    """Write the model of the first world, compiled once; nothing if it needs other files."""
    if self._scene is None:
      spec, sim = self._env.scene.spec.copy(), self._env.sim
      self._env.cfg.sim.apply(spec)
      write_scene(spec, folder, {name: sim.model[name][0].detach().cpu().numpy() for name in sim.expanded_fields})
      self._scene = {path.name: path.read_bytes() for path in folder.glob("scene.*")}
    for name, content in self._scene.items():
      (folder / name).write_bytes(content)


def _describe(env: Any, graph: PolicyGraph, **parts: Any) -> Description:
  """Return the contents of `bundle.json` for a policy in its environment; `parts` are fields that neither gives."""
  entities = {action.term.cfg.entity for action in graph.actions}
  if len(entities) != 1:
    raise MjlabError(f"the actions drive {len(entities)} entities; a bundle is of one robot")
  targets = tuple(
    Target(
      name=name,
      quantity=actions[0].targets.quantity,
      joints=tuple(joint for action in actions for joint in action.targets.joints),
    )
    for name, actions in graph.targets.items()
  )
  scales = [_scale(action) for action in graph.actions]
  return Description(
    robot=_robot(env, entities.pop(), [joint for target in targets for joint in target.joints]),
    timing=Timing(
      physics_dt=env.physics_dt,
      decimation=env.cfg.decimation,
      # The configuration for watching has episodes without end.
      episode_steps=int(env.max_episode_length) if env.max_episode_length < 10**6 else 0,
    ),
    inputs=tuple(_input(reading) for reading in graph.readings.values()),
    memories=tuple(Memory(input=name, output=f"{name}/next", shape=shape) for name, shape in graph.memories.items()),
    targets=targets,
    observations=tuple(term.described for term in graph.terms),
    action_names=tuple(name for action in graph.actions for name in _column_names(action)),
    action_scale=tuple(itertools.chain(*scales)) if all(scales) else None,
    commands=_commands(env, graph),
    **parts,
  )


def _column_names(action: GraphAction) -> Sequence[str]:
  """Return the joints of an action, or numbers where its columns are not one per joint."""
  joints, width = action.targets.joints, action.columns.stop - action.columns.start
  return joints if len(joints) == width else [f"action {i}" for i in range(width)]


def _scale(action: GraphAction) -> list[float]:
  """Return the scale of each joint of an action; nothing if it has none."""
  scale = getattr(action.term, "scale", None)
  return [] if scale is None else scale.expand(1, len(action.targets.joints)).flatten().tolist()


def _robot(env: Any, name: str, driven: Sequence[str]) -> Robot:
  entity = env.scene[name]
  names = list(entity.joint_names)
  fields = ("stiffness", "damping", "effort_limit", "velocity_limit")
  rows = zip(names, *(configured(entity, field, names) for field in fields), strict=True)
  pose = entity.data.default_joint_pos[0].tolist()
  actuators = entity.cfg.articulation.actuators if entity.cfg.articulation is not None else ()
  # MuJoCo, or a drive of a robot, computes this model from a position target.
  is_servo = {type(cfg).__name__ for cfg in actuators} == {"NativePositionActuatorCfg"}
  return Robot(
    name=name,
    joints=tuple(
      Joint(
        name=joint,
        default_position=pose[i] if len(pose) == len(names) else 0.0,
        is_driven=joint in driven,
        **joint_facts(env.sim.mj_model, entity.prefix + joint),
        **dict(zip(fields, numbers, strict=True)),
      )
      for i, (joint, *numbers) in enumerate(rows)
    ),
    root_body=entity.root_body_name,
    is_floating=entity.is_floating,
    actuator_model="position_servo" if is_servo else "other",
    delay_range=(
      min((cfg.delay_min_lag for cfg in actuators), default=0),
      max((cfg.delay_max_lag for cfg in actuators), default=0),
    ),
  )


def _input(reading: Any) -> Input:
  return Input(
    name=reading.name,
    shape=tuple(reading.read().shape[1:]),
    unit=reading.unit,
    frame=reading.frame,
    columns=tuple(reading.columns),
    origin=None if reading.origin is None else Origin(**reading.origin),
  )


def _commands(env: Any, graph: PolicyGraph) -> tuple[Command, ...]:
  """Return the commands that are readings of the graph, with the ranges of those that have axes."""
  found = {name: Command(input=name, ranges={}) for name in graph.readings if name.startswith("command/")}
  for name in env.command_manager.active_terms:
    term = env.command_manager.get_term(name)
    sources = [reading.name for reading in term.source().readings]
    if len(sources) == 1 and sources[0] in found:
      ranges = {axis: (float(low), float(high)) for axis, low, high in term.axes}
      found[sources[0]] = Command(input=sources[0], name=name, ranges=ranges)
  return tuple(found.values())


def _write_motion(env: Any, folder: Path) -> Motion | None:
  for name in env.command_manager.active_terms:
    term = env.command_manager.get_term(name)
    if (clip_arrays := getattr(term, "clip_arrays", None)) is not None:
      arrays = clip_arrays()
      write_arrays(folder / "motion.npz", arrays)
      return Motion(
        rate=1.0 / env.step_dt,
        num_frames=len(arrays["joint_position"]),
        joint_names=tuple(term.library.joint_names),
        name=name,
        anchor_body=term.cfg.anchor_body,
      )
  return None


def record(
  env: Any, agent: RslRlBaseRunnerCfg, network: Any, policy: Any, steps: int = GOLDEN_STEPS
) -> dict[str, np.ndarray]:
  """Record inputs and outputs of a policy in its environment of one world.

  Args:
    env: Environment without noise, delays, pushes and randomisation, just reset.
    agent: Configuration of the learner.
    network: The policy's network.
    policy: Acts in the environment, as `CheckpointPolicy`.
    steps: Number of steps.

  Returns:
    Arrays (steps, ...) by name: "input/NAME", "observation/GROUP", "action", "target/QUANTITY", "episode_start", and
    the state before each step, "state/qpos" and "state/qvel".

  Raises:
    MjlabError: Environment and graph observe different values, so the declared source of a term is wrong.
  """
  graph = PolicyGraph(env, agent, network)
  rows: list[dict[str, torch.Tensor]] = []
  memories, start = graph.start(), 1.0
  policy.reset(None)
  observations = env.get_observations()
  with torch.no_grad():
    for _ in range(steps):
      readings = graph.read()
      outputs = graph.named(readings | memories)
      memories = {name: outputs.pop(f"{name}/next") for name in graph.memories} | {EPISODE_START: torch.zeros(1, 1)}
      _check_observations(graph, observations, outputs)
      # The trained network acts, not its graph.
      action = policy(observations)
      if LAST_ACTION in memories:
        # The environment observes this action. Feedback would amplify the rounding of the graph's own action.
        memories[LAST_ACTION] = action[:1].detach().cpu().float()
      row = {f"input/{name}": value for name, value in readings.items()} | outputs | {"action": action}
      row |= {"state/qpos": env.sim.data.qpos.double(), "state/qvel": env.sim.data.qvel.double()}
      row["episode_start"] = torch.tensor([start])
      rows.append({name: value[0].detach().cpu().clone() for name, value in row.items()})
      observations, _, terminated, truncated, _ = env.step(action)
      dones = terminated | truncated
      policy.reset(dones)
      start = float(dones[0])
      memories = graph.start() if start else memories
  return {name: torch.stack([row[name] for row in rows]).numpy() for name in rows[0]}


def _check_observations(graph: PolicyGraph, observations: Tensors, outputs: Tensors) -> None:
  for term in graph.terms:
    group, name = term.described.group, term.described.name
    ours = term.described.part(observations[group][0].cpu().float())
    theirs = term.described.part(outputs[f"observation/{group}"][0])
    difference = (ours - theirs).abs()
    if bool((difference > 1e-4 * (1.0 + ours.abs())).any()):
      what = f"observation '{group}/{name}' differs from its declared source"
      raise MjlabError(f"{what} by {float(difference.max()):.3g}: `compute` of its TermSource must return its value")


def without_noise(env: Any) -> Any:
  """Turn an environment's configuration into one for `record`: one world, and only resets and commands at random."""
  env.scene.num_envs = 1
  for group in env.observations.values():
    if group is not None:
      group.corrupt = False
      for term in group.terms.values():
        if term is not None:
          term.delay_min_lag = term.delay_max_lag = 0
  env.events = {name: event for name, event in env.events.items() if event is not None and event.mode == "reset"}
  env.curriculum = {}
  env.recorders = {}
  if hasattr(env.scene.terrain, "rows"):
    # One row, the easiest, is enough.
    env.scene.terrain.rows, env.scene.max_init_terrain_level = 1, None
  for entity in env.scene.entities.values():
    for actuator in getattr(getattr(entity, "articulation", None), "actuators", ()):
      actuator.delay_min_lag = actuator.delay_max_lag = 0
  return env


def write_zip(folder: Path) -> Path:
  """Write the zip of a bundle beside its folder; return its path."""
  path = folder.with_name(f"{folder.name}.zip")
  with AtomicWrite(path) as temporary:
    pack(folder, temporary)
  return path


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
  return json.loads(json.dumps(dict(values), default=str, allow_nan=False))
