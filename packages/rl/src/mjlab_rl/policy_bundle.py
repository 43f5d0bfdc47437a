"""Export of policies as bundles for mjlab-deploy."""

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from mjlab_core.errors import MjlabError
from mjlab_core.files import AtomicWrite
from mjlab_deploy import (
  Command,
  Description,
  Golden,
  Input,
  Joint,
  Memory,
  Motion,
  Observation,
  Origin,
  Robot,
  Target,
  Timing,
  pack,
  write_description,
)
from mjlab_deploy.arrays import write_arrays
from mjlab_deploy.model_readings import joint_facts
from mjlab_deploy.policy import EPISODE_START
from mjlab_deploy.scene import write_scene

from mjlab_rl.config import RslRlBaseRunnerCfg
from mjlab_rl.manifest import package_versions
from mjlab_rl.onnx_metadata import configured
from mjlab_rl.policy_graph import LAST_ACTION, GraphAction, GraphTerm, PolicyGraph, export_onnx, refresh_weights

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
      self._model = export_onnx(graph, graph.example(), graph.input_names, graph.output_names)
    with AtomicWrite(folder) as made:
      made.mkdir()
      onnx.save(self._model, made / "policy.onnx")
      has_scene = self._write_scene(made)
      motion = _write_motion(self._env, made)
      if golden is not None:
        write_arrays(made / "golden.npz", golden)
      if picture is not None:
        (made / "picture.png").write_bytes(picture)
      description = describe_policy(
        self._env,
        graph,
        self._task,
        has_scene=has_scene,
        motion=motion,
        golden=None if golden is None else Golden(steps=len(golden["action"]), engine=str(self._env.sim.engine)),
        training=_plain(training or {}),
        evaluation=_plain(evaluation or {}),
      )
      write_description(made, description)
    return description

  def _write_scene(self, folder: Path) -> bool:
    """Write the model of the first world, compiled once; return False if it needs other files."""
    if self._scene is None:
      spec, sim = self._env.scene.spec.copy(), self._env.sim
      self._env.cfg.sim.apply(spec)
      own = {name: sim.model[name][0].detach().cpu().numpy() for name in sim.expanded_fields}
      before = set(folder.iterdir())
      write_scene(spec, folder, own)
      self._scene = {path.name: path.read_bytes() for path in folder.iterdir() if path not in before}
    for name, content in self._scene.items():
      (folder / name).write_bytes(content)
    return bool(self._scene)


def describe_policy(env: Any, graph: PolicyGraph, task: str, **parts: Any) -> Description:
  """Return the contents of `bundle.json` for a policy in its environment; `parts` are further fields."""
  entities = {action.term.cfg.entity for action in graph.actions}
  if len(entities) != 1:
    raise MjlabError(f"the actions drive {len(entities)} entities; a bundle is of one robot")
  driven = {joint for action in graph.actions for joint in action.targets.joints}
  return Description(
    task=task,
    robot=_robot(env, entities.pop(), driven),
    timing=Timing(
      physics_dt=env.physics_dt,
      decimation=env.cfg.decimation,
      # The configuration for watching has episodes without end.
      episode_steps=int(env.max_episode_length) if env.max_episode_length < 10**6 else 0,
    ),
    inputs=tuple(_input(reading) for reading in graph.readings.values()),
    memories=tuple(Memory(input=name, output=f"{name}/next", shape=shape) for name, shape in graph.memories.items()),
    targets=tuple(
      Target(
        name=output,
        quantity=parts[0].targets.quantity,
        joints=tuple(joint for part in parts for joint in part.targets.joints),
      )
      for output, parts in graph.targets.items()
    ),
    observations=tuple(_observation(env, term) for term in graph.terms),
    action_names=tuple(name for action in graph.actions for name in _column_names(action)),
    action_scale=_scale(graph.actions),
    commands=_commands(env, graph),
    created=datetime.now().astimezone().isoformat(timespec="seconds"),
    versions=dict(package_versions()),
    **parts,
  )


def _column_names(action: GraphAction) -> Sequence[str]:
  """Return the joints of an action, or numbers where its columns are not one per joint."""
  joints, width = action.targets.joints, action.columns.stop - action.columns.start
  return joints if len(joints) == width else [f"action {i}" for i in range(width)]


def _scale(actions: Sequence[GraphAction]) -> tuple[float, ...] | None:
  """Return the scale of each joint; None if an action has none."""
  rows = []
  for action in actions:
    if (scale := getattr(action.term, "scale", None)) is None:
      return None
    rows.append(scale.expand(1, len(action.targets.joints)))
  return tuple(torch.cat(rows, 1).flatten().tolist())


def _robot(env: Any, name: str, driven: set[str]) -> Robot:
  entity = env.scene[name]
  names = list(entity.joint_names)
  fields = ("stiffness", "damping", "effort_limit", "velocity_limit")
  numbers: dict[str, Any] = {field: configured(entity, field, names) for field in fields}
  pose = entity.data.default_joint_pos[0].tolist()
  joints = tuple(
    Joint(
      name=joint,
      default_position=pose[i] if len(pose) == len(names) else 0.0,
      is_driven=joint in driven,
      **joint_facts(env.sim.mj_model, entity.prefix + joint),
      **{field: values[i] for field, values in numbers.items()},
    )
    for i, joint in enumerate(names)
  )
  actuators = entity.cfg.articulation.actuators if entity.cfg.articulation is not None else ()
  # MuJoCo, or a drive of a robot, computes this model from a position target.
  is_servo = {type(cfg).__name__ for cfg in actuators} == {"NativePositionActuatorCfg"}
  delays = [(cfg.delay_min_lag, cfg.delay_max_lag) for cfg in actuators] or [(0, 0)]
  return Robot(
    name=name,
    joints=joints,
    root_body=entity.root_body_name,
    is_floating=entity.is_floating,
    actuator_model="position_servo" if is_servo else "other",
    delay_range=(min(low for low, _ in delays), max(high for _, high in delays)),
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


def _observation(env: Any, term: GraphTerm) -> Observation:
  layout = term.layout
  cfg = env.observation_manager.get_term_cfg(term.group, layout.name)
  scale = layout.scale
  return Observation(
    group=term.group,
    name=layout.name,
    columns=(layout.columns.start, layout.columns.stop) if len(layout.shape) == 1 else (0, 0),
    shape=tuple(layout.shape),
    sources=tuple(LAST_ACTION if name == f"memory/{LAST_ACTION}" else name for name in term.inputs),
    scale=scale if scale is None or isinstance(scale, int | float) else tuple(map(float, scale)),
    clip=layout.clip,
    history_length=layout.history_length,
    delay_range=(cfg.delay_min_lag, cfg.delay_max_lag),
  )


def _commands(env: Any, graph: PolicyGraph) -> tuple[Command, ...]:
  """Return the commands that are readings of the graph, with the ranges of those that have axes."""
  known: dict[str, Command] = {}
  for name in env.command_manager.active_terms:
    term = env.command_manager.get_term(name)
    sources = [reading.name for reading in term.source().readings]
    if len(sources) == 1 and sources[0].startswith("command/"):
      ranges = {axis: (float(low), float(high)) for axis, low, high in term.axes}
      known[sources[0]] = Command(input=sources[0], name=name, ranges=ranges)
  inputs = [name for name in graph.readings if name.startswith("command/")]
  return tuple(known.get(name, Command(input=name, ranges={})) for name in inputs)


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
  rows: dict[str, list[np.ndarray]] = {}
  memories: dict[str, torch.Tensor] = {}
  start = True
  policy.reset(None)
  observations = env.get_observations()
  with torch.no_grad():
    for _ in range(steps):
      readings = {name: reading.read()[:1].detach().cpu().float() for name, reading in graph.readings.items()}
      if start:
        memories = {name: torch.zeros(shape) for name, shape in graph.memories.items()}
      outputs = graph.named(readings | memories | {EPISODE_START: torch.full((1, 1), float(start))})
      memories = {name: outputs[f"{name}/next"] for name in memories}
      _check_observations(graph, observations, outputs)
      row = {f"input/{name}": value[0] for name, value in readings.items()}
      row |= {name: value[0] for name, value in outputs.items() if not name.endswith("/next")}
      row |= {"state/qpos": env.sim.data.qpos[0].double(), "state/qvel": env.sim.data.qvel[0].double()}
      row["episode_start"] = torch.tensor(float(start))
      # The trained network acts, not its graph.
      action = policy(observations)
      row["action"] = action[0]
      if f"memory/{LAST_ACTION}" in memories:
        # The environment observes this action. Feedback would amplify the rounding of the graph's own action.
        memories[f"memory/{LAST_ACTION}"] = action[:1].detach().cpu().float()
      for name, value in row.items():
        rows.setdefault(name, []).append(value.detach().cpu().numpy().copy())
      observations, _, terminated, truncated, _ = env.step(action)
      dones = terminated | truncated
      policy.reset(dones)
      start = bool(dones[0])
  return {name: np.stack(values) for name, values in rows.items()}


def _check_observations(
  graph: PolicyGraph, observations: Mapping[str, torch.Tensor], outputs: Mapping[str, Any]
) -> None:
  for term in graph.terms:
    columns = term.layout.columns if len(term.layout.shape) == 1 else slice(None)
    ours = observations[term.group][0].cpu().float()[columns]
    difference = (ours - outputs[f"observation/{term.group}"][0][columns]).abs()
    if bool((difference > 1e-4 * (1.0 + ours.abs())).any()):
      what = f"observation '{term.group}/{term.layout.name}' differs from its declared source"
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
