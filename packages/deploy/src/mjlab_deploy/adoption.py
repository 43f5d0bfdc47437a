"""Bundles of policies that others exported, on a robot in MJCF."""

import contextlib
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjlab_deploy.arrays import write_arrays
from mjlab_deploy.bundle import MAX_BYTES, Bundle, write_description
from mjlab_deploy.description import (
  Command,
  Description,
  Input,
  Joint,
  Memory,
  Motion,
  Observation,
  Origin,
  Robot,
  Target,
  Timing,
)
from mjlab_deploy.errors import DeployError, check_known, read_limited, reading
from mjlab_deploy.model_readings import actuators_of
from mjlab_deploy.network_graph import GROUP, NetworkGraph
from mjlab_deploy.other_formats import REFERENCE_OUTPUTS
from mjlab_deploy.policy import open_graph
from mjlab_deploy.scene import write_scene
from mjlab_deploy.unitree_policy import find_deploy_yaml, read_deploy_yaml, with_metadata

_ROBOT = "robot"
_MAX_FRAMES = 100_000
_STANDSTILL = 500
"""Frames at the last pose after which a clip is over."""
_VELOCITY = {"lin_vel_x": (-1.0, 1.0), "lin_vel_y": (-1.0, 1.0), "ang_vel_z": (-1.0, 1.0)}
_ORIGINS: dict[str, Any] = {
  "joint/position": "joint_position",
  "joint/velocity": "joint_velocity",
  "imu/gyro": "angular_velocity",
  "imu/projected_gravity": "projected_gravity",
  "estimate/linear_velocity": "linear_velocity",
}


@contextlib.contextmanager
def adopted(policy: Path, model: Path, rate: float | None = None) -> Generator[Bundle]:
  """Open an ONNX file with the metadata of mjlab 1.x or BeyondMimic as a bundle, for as long as it is needed.

  Args:
    policy: The ONNX file. Without metadata, a `deploy.yaml` of Unitree's runner beside it takes their place.
    model: MJCF file of its robot. Its actuators are replaced by position servos with the gains of the metadata.
    rate: Rate of the policy [Hz]; None: that of `deploy.yaml`, or 50, because the metadata does not tell.

  Raises:
    DeployError: Either file cannot be read, or they do not fit; the message begins with the path of the policy.
  """
  with tempfile.TemporaryDirectory(prefix="bundle-") as temporary:
    with reading(f"policy {policy}"):
      bundle = _adopt(policy, model, rate, Path(temporary))
    yield bundle


def _adopt(policy: Path, model: Path, rate: float | None, folder: Path) -> Bundle:
  data = read_limited(policy, MAX_BYTES["policy.onnx"])
  session = open_graph(data)
  if "joint_names" not in session.get_modelmeta().custom_metadata_map and (beside := find_deploy_yaml(policy)):
    metadata = read_deploy_yaml(beside)
    data = with_metadata(data, metadata)
    session = open_graph(data)
    rate = rate or 1.0 / float(metadata["step_dt"])
  rate = rate or 50.0
  graph = NetworkGraph(session)
  (folder / "policy.onnx").write_bytes(data)
  spec = _scene(model, graph)
  if not write_scene(spec, folder):
    raise DeployError(f"{model}: its collisions need mesh files, which a bundle cannot hold; use primitives")
  compiled = spec.compile()
  motion = _write_motion(graph, folder, rate) if graph.follows_clip else None
  description = _description(graph, compiled, motion, policy.stem, rate)
  write_description(folder, description)
  return Bundle(folder)


def _scene(path: Path, graph: NetworkGraph) -> mujoco.MjSpec:
  """Return the robot's scene with position servos; its elements are named "robot/..."."""
  with reading(path, ValueError, mujoco.FatalError):
    spec = mujoco.MjSpec.from_file(str(path))
    child_model = spec.compile()
  for part in (*spec.keys, *spec.actuators):
    spec.delete(part)
  prefix = f"{_ROBOT}/"
  if not any(joint.name.startswith(prefix) for joint in spec.joints):
    whole = mujoco.MjSpec()
    whole.option.timestep, whole.option.integrator = spec.option.timestep, spec.option.integrator
    whole.attach(spec, prefix=prefix, frame=whole.worldbody.add_frame())
    spec = whole
  if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.geoms):
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0.0, 0.0, 1.0))
  there = [joint.name.removeprefix(prefix) for joint in spec.joints if joint.name.startswith(prefix)]
  for name, kp, kd in zip(graph.joints, graph.stiffness, graph.damping, strict=True):
    check_known(f"{path}: joint", name, there)
    servo = spec.add_actuator(name=prefix + name, target=prefix + name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0], servo.biasprm[1], servo.biasprm[2] = kp, -kp, -kd
    if (effort := _effort(child_model, name, prefix)) is not None:
      servo.forcelimited, servo.forcerange = True, (-effort, effort)
  return spec


def _effort(model: mujoco.MjModel, name: str, prefix: str) -> float | None:
  """Return the effort limit of a joint in a model, from its actuator or itself; None without one."""
  numbers = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, part) for part in (name, prefix + name)]
  number = max(numbers)
  if number < 0:
    return None
  limits = [float(model.jnt_actfrcrange[number, 1])] if model.jnt_actfrclimited[number] else []
  servos = actuators_of(model, number)
  limits += [float(model.actuator_forcerange[i, 1]) for i in servos if model.actuator_forcelimited[i]]
  return min(limits) if limits else None


def _write_motion(graph: NetworkGraph, folder: Path, rate: float) -> Motion:
  """Write the clip that a network shows frame by frame; its last frame is repeated for all later steps."""
  last, frames, same = graph.frame(_MAX_FRAMES), [], 0
  # A clip may pass through its last frame earlier.
  while same < _STANDSTILL:
    if len(frames) >= _MAX_FRAMES:
      raise DeployError(f"its clip has more than {_MAX_FRAMES} frames")
    frames.append(graph.frame(len(frames)))
    same = same + 1 if all(np.array_equal(frames[-1][name], last[name]) for name in REFERENCE_OUTPUTS) else 0
  frames = frames[: len(frames) - same + 1]
  # Step t of a bundle shows frame t + 1, that of the network frame t.
  frames.insert(0, frames[0])
  with reading("anchor_body_name of the metadata", ValueError):
    anchor = graph.words("body_names").index(graph.anchor)
  rows = {
    "joint_position": [frame["joint_pos"] for frame in frames],
    "joint_velocity": [frame["joint_vel"] for frame in frames],
    "anchor_position": [frame["body_pos_w"][anchor] for frame in frames],
    "anchor_orientation": [frame["body_quat_w"][anchor] for frame in frames],
  }
  write_arrays(folder / "motion.npz", {name: np.array(values, np.float64) for name, values in rows.items()})
  return Motion(rate=rate, num_frames=len(frames), joint_names=graph.joints, anchor_body=graph.anchor)


def _description(
  graph: NetworkGraph, model: mujoco.MjModel, motion: Motion | None, task: str, rate: float
) -> Description:
  dt = float(model.opt.timestep)
  decimation = round(1.0 / (rate * dt))
  if decimation < 1 or abs(decimation * dt * rate - 1.0) > 1e-6:
    raise DeployError(f"a rate of {rate:g} Hz is no multiple of the model's time step of {dt:g} s; give another --rate")
  root = int(model.body_rootid[model.jnt_bodyid[model.joint(f"{_ROBOT}/{graph.joints[0]}").id]])
  free = model.body_jntnum[root] > 0 and model.jnt_type[model.body_jntadr[root]] == mujoco.mjtJoint.mjJNT_FREE
  root_body = model.body(root).name
  joints = []
  for i, name in enumerate(graph.joints):
    element, servo = model.joint(f"{_ROBOT}/{name}"), model.actuator(f"{_ROBOT}/{name}")
    joints.append(
      Joint(
        name=name,
        default_position=float(graph.default[i]),
        is_driven=True,
        stiffness=float(graph.stiffness[i]),
        damping=float(graph.damping[i]),
        armature=float(model.dof_armature[element.dofadr[0]]),
        effort_limit=float(servo.forcerange[1]) if servo.forcelimited[0] else None,
        position_range=(float(element.range[0]), float(element.range[1])) if element.limited[0] else None,
      )
    )
  columns, start = [], 0
  for term in graph.terms:
    columns.append((start, start + term.width * term.history))
    start = columns[-1][1]
  has_velocity = "command/velocity" in graph.readings
  return Description(
    task=task,
    robot=Robot(
      name=_ROBOT,
      joints=tuple(joints),
      root_body=root_body.removeprefix(f"{_ROBOT}/"),
      is_floating=bool(free),
    ),
    timing=Timing(physics_dt=dt, decimation=decimation, episode_steps=0),
    inputs=tuple(
      Input(name=name, shape=(width,), origin=_origin(name, root_body)) for name, width in graph.readings.items()
    ),
    memories=tuple(Memory(input=name, output=f"{name}/next", shape=shape) for name, shape in graph.memories.items()),
    targets=(Target(name="target/position", quantity="position", joints=graph.joints),),
    observations=tuple(
      Observation(
        group=GROUP,
        name=term.name,
        columns=place,
        shape=(term.width * term.history,),
        sources=term.sources,
        scale=tuple(map(float, term.scale)),
        clip=term.clip,
        history_length=term.history if term.history > 1 else 0,
      )
      for term, place in zip(graph.terms, columns, strict=True)
    ),
    action_names=graph.joints,
    action_scale=tuple(map(float, graph.action_scale)),
    commands=(Command(input="command/velocity", ranges=_VELOCITY),) if has_velocity else (),
    motion=motion,
    has_scene=True,
  )


def _origin(name: str, root: str) -> Origin | None:
  if name in _ORIGINS:
    of_joints = name.startswith("joint/")
    return Origin(quantity=_ORIGINS[name], name="" if of_joints else root, object_type="" if of_joints else "body")
  kind, *rest = name.split("/")
  if kind in ("imu", "estimate") and len(rest) == 2:
    quantity: Any = rest[1]
    return Origin(quantity=quantity, name=f"{_ROBOT}/{rest[0]}", object_type="body")
  return None
