"""Bundles of policies of other projects, on a robot in MJCF."""

import contextlib
import tempfile
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjlab_deploy.arrays import write_arrays
from mjlab_deploy.bundle import MAX_BYTES, Bundle, write_description
from mjlab_deploy.description import Command, Description, Input, Joint, Motion, Origin, Robot, Target, Timing
from mjlab_deploy.errors import DeployError, check_known, read_limited, reading
from mjlab_deploy.formats.network_graph import NetworkGraph
from mjlab_deploy.formats.network_metadata import NetworkMetadata, find_deploy_yaml, read_deploy_yaml, read_metadata
from mjlab_deploy.formats.onnx_graph import OnnxGraph
from mjlab_deploy.simulation.model_readings import actuators_of, joint_facts
from mjlab_deploy.simulation.scene import write_scene

_ROBOT = "robot"
_MAX_FRAMES = 100_000
_STANDSTILL = 500
"""Frames at the last pose after which a clip is over."""
_VELOCITY = {"lin_vel_x": (-1.0, 1.0), "lin_vel_y": (-1.0, 1.0), "ang_vel_z": (-1.0, 1.0)}


@contextlib.contextmanager
def adopted(policy: Path, model: Path, rate: float | None = None) -> Generator[Bundle]:
  """Open an ONNX file with the metadata of mjlab 1.x or BeyondMimic as a bundle, for as long as it is needed.

  Args:
    policy: The ONNX file. Without metadata, a `deploy.yaml` of Unitree's runner beside it takes their place.
    model: MJCF file of its robot. Its actuators are replaced by position servos with the gains of the metadata.
    rate: Rate of the policy [Hz]; None: that of `deploy.yaml`, or 50, because metadata has none.

  Raises:
    DeployError: Either file cannot be read, or they do not fit; the message begins with the path of the policy.
  """
  with tempfile.TemporaryDirectory(prefix="bundle-") as temporary:
    with reading(f"policy {policy}", LookupError, ValueError):
      bundle = _adopt(policy, model, rate, Path(temporary))
    yield bundle


def _adopt(policy: Path, model: Path, rate: float | None, folder: Path) -> Bundle:
  data = read_limited(policy, MAX_BYTES["policy.onnx"])
  network = OnnxGraph(data)
  check_known("input of the network", "obs", network.inputs)
  beside = None if "joint_names" in network.metadata else find_deploy_yaml(policy)
  follows_clip = "time_step" in network.inputs and "joint_pos" in network.outputs
  metadata = read_metadata(network.metadata, follows_clip=follows_clip) if beside is None else read_deploy_yaml(beside)
  rate = rate or metadata.rate or 50.0
  names = tuple(joint.name for joint in metadata.joints)
  spec, joints = _scene(model, metadata.joints)
  compiled = spec.compile()
  description = Description(
    task=policy.stem,
    robot=_robot(compiled, joints),
    timing=_timing(compiled.opt.timestep, rate),
    inputs=(),
    memories=(),
    targets=(Target(name="target/position", quantity="position", joints=names),),
    observations=metadata.observations,
    action_names=names,
    action_scale=metadata.action_scale,
    has_scene=True,
  )
  graph, root = NetworkGraph(network, description), f"{_ROBOT}/{description.robot.root_body}"
  (folder / "policy.onnx").write_bytes(data)
  if not write_scene(spec, folder):
    raise DeployError(f"{model}: its collisions need mesh files, which a bundle cannot hold; use primitives")
  description = replace(
    description,
    inputs=tuple(Input(name=name, shape=size[1:], origin=_origin(name, root)) for name, size in graph.inputs.items()),
    commands=(Command(input="command/velocity", ranges=_VELOCITY),) if "command/velocity" in graph.inputs else (),
    motion=_write_motion(network, metadata, folder, rate) if follows_clip else None,
  )
  write_description(folder, description)
  return Bundle(folder)


def _scene(path: Path, joints: tuple[Joint, ...]) -> tuple[mujoco.MjSpec, tuple[Joint, ...]]:
  """Return the robot's scene with position servos, its elements named "robot/...", and the joints with its facts."""
  prefix = f"{_ROBOT}/"
  with reading(path, ValueError, mujoco.FatalError):
    spec = mujoco.MjSpec.from_file(str(path))
    for key in list(spec.keys):
      spec.delete(key)
    if not any(joint.name.startswith(prefix) for joint in spec.joints):
      whole = mujoco.MjSpec()
      whole.option.timestep, whole.option.integrator = spec.option.timestep, spec.option.integrator
      whole.attach(spec, prefix=prefix, frame=whole.worldbody.add_frame())
      spec = whole
    model = spec.compile()
  for actuator in list(spec.actuators):
    spec.delete(actuator)
  if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.geoms):
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0.0, 0.0, 1.0))
  there, found = [joint.name.removeprefix(prefix) for joint in spec.joints if joint.name.startswith(prefix)], []
  for joint in joints:
    check_known(f"{path}: joint", joint.name, there)
    name = prefix + joint.name
    effort = min(_effort_limits(model, model.joint(name).id), default=None)
    servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=joint.stiffness or 0.0, kv=joint.damping or 0.0)
    if effort is not None:
      servo.forcelimited, servo.forcerange = True, (-effort, effort)
    found.append(replace(joint, effort_limit=effort, **joint_facts(model, name)))
  return spec, tuple(found)


def _effort_limits(model: mujoco.MjModel, joint: int) -> list[float]:
  """Return the effort limits of a joint in a model, its own and those of its actuators."""
  limits = [float(model.jnt_actfrcrange[joint, 1])] if model.jnt_actfrclimited[joint] else []
  servos = actuators_of(model, joint)
  return limits + [float(model.actuator_forcerange[i, 1]) for i in servos if model.actuator_forcelimited[i]]


def _robot(model: mujoco.MjModel, joints: tuple[Joint, ...]) -> Robot:
  root = model.body_rootid[model.jnt_bodyid[model.joint(f"{_ROBOT}/{joints[0].name}").id]]
  return Robot(
    name=_ROBOT,
    joints=joints,
    root_body=model.body(root).name.removeprefix(f"{_ROBOT}/"),
    is_floating=bool((model.jnt_type[model.jnt_bodyid == root] == mujoco.mjtJoint.mjJNT_FREE).any()),
  )


def _timing(dt: float, rate: float) -> Timing:
  decimation = round(1.0 / (rate * dt))
  if decimation < 1 or abs(decimation * dt * rate - 1.0) > 1e-6:
    raise DeployError(f"a rate of {rate:g} Hz is no multiple of the model's time step of {dt:g} s; give another --rate")
  return Timing(physics_dt=dt, decimation=decimation, episode_steps=0)


def _origin(name: str, root: str) -> Origin | None:
  """Return the place of a reading in the scene; None if MuJoCo cannot supply it."""
  kind, *body, last = name.split("/")
  if kind not in ("joint", "imu", "estimate"):
    return None
  quantity: Any = {"joint": f"joint_{last}", "imu": last.replace("gyro", "angular_velocity")}.get(kind, last)
  if kind == "joint":
    return Origin(quantity=quantity)
  return Origin(quantity=quantity, name=f"{_ROBOT}/{body[0]}" if body else root, object_type="body")


def _write_motion(network: OnnxGraph, metadata: NetworkMetadata, folder: Path, rate: float) -> Motion:
  """Write the clip that a network shows frame by frame; its last frame is repeated for all later steps."""
  anchor = metadata.bodies.index(metadata.anchor)
  zeros = network.zeros(*network.inputs)

  def shown(step: int) -> dict[str, np.ndarray]:
    values = network.run(zeros | {"time_step": np.full_like(zeros["time_step"], step)})
    return {
      "joint_position": values["joint_pos"][0],
      "joint_velocity": values["joint_vel"][0],
      "anchor_position": values["body_pos_w"][0, anchor],
      "anchor_orientation": values["body_quat_w"][0, anchor],
    }

  last, same = shown(_MAX_FRAMES), 0
  # Step t of a bundle shows frame t + 1, that of the network frame t.
  frames = [shown(0)]
  # A clip may pass through its last frame earlier.
  while same < _STANDSTILL:
    if len(frames) > _MAX_FRAMES:
      raise DeployError(f"its clip has more than {_MAX_FRAMES} frames")
    frames.append(shown(len(frames) - 1))
    same = same + 1 if all(np.array_equal(frames[-1][name], last[name]) for name in last) else 0
  frames = frames[: len(frames) - same + 1]
  write_arrays(folder / "motion.npz", {name: np.array([frame[name] for frame in frames], float) for name in last})
  names = tuple(joint.name for joint in metadata.joints)
  return Motion(rate=rate, num_frames=len(frames), joint_names=names, anchor_body=metadata.anchor)
