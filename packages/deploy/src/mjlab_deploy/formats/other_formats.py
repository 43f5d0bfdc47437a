"""Description of a policy in the formats of other runners."""

import math
from collections.abc import Iterable

import numpy as np

from mjlab_deploy.description import Description, Observation
from mjlab_deploy.errors import DeployError

_LEGS = [f"{side}_{joint}_joint" for side in ("left", "right") for joint in (
  "hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")]  # fmt: skip
_WAIST = [f"waist_{axis}_joint" for axis in ("yaw", "roll", "pitch")]
_ARMS = [f"{side}_{joint}_joint" for side in ("left", "right") for joint in (
  "shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")]  # fmt: skip
QUADRUPED_MOTORS = tuple(
  f"{leg}_{joint}_joint" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf")
)
"""Joints of a Go2 in the order of Unitree's SDK."""
G1_MOTORS = tuple(_LEGS + _WAIST + _ARMS)
"""Joints of a G1 with 29 joints in the order of Unitree's SDK."""
REFERENCE_OUTPUTS = ("joint_pos", "joint_vel", "body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w")
"""Outputs of BeyondMimic's policies that show the clip at `time_step`; its motion files have these keys too."""
MOTORS = (G1_MOTORS, QUADRUPED_MOTORS)
"""Orders of motors that Unitree's runner knows here."""
# Terms of Unitree's runner by the source that they are read from.
_TERMS = {
  "imu/gyro": "base_ang_vel",
  "imu/projected_gravity": "projected_gravity",
  "command/velocity": "velocity_commands",
  "joint/position": "joint_pos_rel",
  "joint/velocity": "joint_vel_rel",
  "last_action": "last_action",
}


def onnx_metadata(description: Description) -> dict[str, str]:
  """Return the metadata of a policy file of mjlab 1.x, which BeyondMimic's runners read too, in full precision.

  Such a file takes the observation that this package's graph assembles, and returns raw actions.
  """
  robot = description.robot
  terms = description.observations
  names = [command.name for command in description.commands]
  names += [description.motion.name] if description.motion is not None else []
  metadata = {
    "run_path": str(description.training.get("checkpoint", "")),
    "joint_names": ",".join(robot.joint_names),
    "joint_stiffness": _csv(robot.values("stiffness")),
    "joint_damping": _csv(robot.values("damping")),
    "default_joint_pos": _csv(robot.values("default_position")),
    "command_names": ",".join(names),
    "observation_names": ",".join(term.name for term in terms),
    "observation_terms_scale": _csv(1.0 if term.scale is None else term.scale for term in terms),
    "observation_terms_history_length": _csv(term.history_length for term in terms),
    "observation_terms_flatten_history_dim": _csv(len(term.shape) == 1 for term in terms),
    "observation_terms_clip": _csv(term.clip or (-math.inf, math.inf) for term in terms),
  }
  if description.action_scale is not None:
    metadata["action_scale"] = _csv(description.action_scale)
  if description.motion is not None:
    metadata["anchor_body_name"] = description.motion.anchor_body
  return metadata


def unitree_deploy_yaml(description: Description) -> str:
  """Return the deploy.yaml of Unitree's runner for a policy of velocities.

  Raises:
    DeployError: The policy observes or does something that the runner does not know; the message names it.
  """
  robot = description.robot
  names = list(robot.joint_names)
  motors = next((order for order in MOTORS if sorted(order) == sorted(names)), None)
  if motors is None:
    raise DeployError("Unitree's deploy.yaml: the joints are not those of a G1 with 29 joints, nor of a quadruped")
  if [target.quantity for target in description.targets] != ["position"] or description.action_scale is None:
    raise DeployError("Unitree's deploy.yaml: actions must be scale * action + offset to joint positions")
  driven = list(description.targets[0].joints)
  # Its runner sends the gains to the motors as they stand; everything else is in the policy's order.
  at_motor = [names.index(name) for name in motors]
  default = robot.values("default_position").tolist()
  lines = [
    f"joint_ids_map: {[motors.index(name) for name in names]}",
    f"step_dt: {description.timing.control_dt!r}",
    f"stiffness: {robot.values('stiffness')[at_motor].tolist()}",
    f"damping: {robot.values('damping')[at_motor].tolist()}",
    f"default_joint_pos: {default}",
    "commands:",
    "  base_velocity:",
    "    ranges:",
  ]
  for command in description.commands:
    axes = zip(("lin_vel_x", "lin_vel_y", "ang_vel_z"), command.ranges.values(), strict=False)
    lines += [f"      {axis}: {list(limits)}" for axis, limits in axes]
  lines += [
    "      heading: null",
    "actions:",
    "  JointPositionAction:",
    "    clip: null",
    "    joint_names: ['.*']",
    f"    scale: {list(description.action_scale)}",
    f"    offset: {[default[names.index(name)] for name in driven]}",
    f"    joint_ids: {'null' if driven == names else [names.index(name) for name in driven]}",
    "observations:",
  ]
  for term in description.observations:
    name = _TERMS.get(term.sources[0]) if len(term.sources) == 1 else None
    if name is None:
      what = f"no term for '{term.name}' ({', '.join(term.sources)})"
      raise DeployError(f"Unitree's deploy.yaml: its runner has {what}; train without it")
    lines += [
      f"  {name}:",
      "    params: {command_name: base_velocity}" if name == "velocity_commands" else "    params: {}",
      f"    clip: {'null' if term.clip is None else list(term.clip)}",
      f"    scale: {_scales(term)}",
      f"    history_length: {max(term.history_length, 1)}",
    ]
  return "\n".join(lines) + "\n"


def _scales(term: Observation) -> list[float]:
  """Return the scale of each component of one frame."""
  width = term.shape[0] // max(term.history_length, 1) if len(term.shape) == 1 else 1
  return np.full(width, 1.0 if term.scale is None else term.scale).tolist()


def _csv(items: Iterable[float | tuple[float, ...]]) -> str:
  """Return numbers between commas; those of a tuple between semicolons."""
  rows = (item if isinstance(item, tuple) else (item,) for item in items)
  return ",".join(";".join(repr(float(number)) for number in row) for row in rows)
