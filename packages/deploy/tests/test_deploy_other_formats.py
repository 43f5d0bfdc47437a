"""Descriptions in the words of other runners, read by the schema of each."""

from dataclasses import replace
from itertools import pairwise

import pytest
import yaml
from deploy_bundles import DESCRIPTION
from mjlab_deploy import Command, DeployError, Description, Joint, Observation, Target
from mjlab_deploy.formats.other_formats import QUADRUPED_MOTORS, onnx_metadata, unitree_deploy_yaml


def quadruped() -> Description:
  """A policy whose joints are in another order than the motors: by kind, as Isaac Lab has them."""
  names = sorted(QUADRUPED_MOTORS, key=lambda name: (name.split("_")[1], QUADRUPED_MOTORS.index(name)))
  joints = tuple(
    Joint(name=name, default_position=0.1 * i, is_driven=True, stiffness=10.0 + i / 3, damping=1.0 + i)
    for i, name in enumerate(names)
  )
  widths = {"imu/gyro": 3, "joint/position": 12, "last_action": 12, "command/velocity": 3}
  starts = [0, 3, 15, 27, 30]
  terms = tuple(
    Observation(
      group="actor", name=source.replace("/", "_"), columns=columns, shape=(2 * width,), sources=(source,),
      scale=0.2, history_length=2, clip=(-5.0, 5.0),
    )
    for (source, width), columns in zip(widths.items(), pairwise(starts), strict=True)
  )  # fmt: skip
  ranges = {"forward": (-1.0, 1.0), "left": (-0.4, 0.4), "turn": (-0.5, 0.5)}
  return replace(
    DESCRIPTION,
    robot=replace(DESCRIPTION.robot, joints=joints),
    targets=(Target(name="target/position", quantity="position", joints=tuple(names)),),
    observations=terms,
    action_names=tuple(names),
    action_scale=tuple(0.25 + i / 7 for i in range(12)),
    commands=(Command(input="command/velocity", name="twist", ranges=ranges),),
  )


def test_unitrees_file_gives_each_motor_its_gains() -> None:
  description = quadruped()
  data = yaml.safe_load(unitree_deploy_yaml(description))
  for joint, motor in zip(description.robot.joints, data["joint_ids_map"], strict=True):
    assert QUADRUPED_MOTORS[motor] == joint.name
    # Its runner sends stiffness[i] to motor i.
    assert (data["stiffness"][motor], data["damping"][motor]) == (joint.stiffness, joint.damping)
  assert data["default_joint_pos"] == [joint.default_position for joint in description.robot.joints]
  assert data["actions"]["JointPositionAction"]["scale"] == list(description.action_scale or ())
  assert data["observations"]["joint_pos_rel"] == {
    "params": {}, "clip": [-5.0, 5.0], "scale": [0.2] * 12, "history_length": 2,
  }  # fmt: skip
  assert data["commands"]["base_velocity"]["ranges"] == {
    "lin_vel_x": [-1.0, 1.0], "lin_vel_y": [-0.4, 0.4], "ang_vel_z": [-0.5, 0.5], "heading": None,
  }  # fmt: skip


def test_a_robot_that_unitrees_runner_does_not_drive_is_refused() -> None:
  with pytest.raises(DeployError, match="not those of a G1 with 29 joints, nor of a quadruped"):
    unitree_deploy_yaml(DESCRIPTION)


def test_metadata_keep_full_precision() -> None:
  description = quadruped()
  metadata = onnx_metadata(description)
  assert [float(word) for word in metadata["joint_stiffness"].split(",")] == [
    joint.stiffness for joint in description.robot.joints
  ]
  assert [float(word) for word in metadata["action_scale"].split(",")] == list(description.action_scale or ())
  assert metadata["observation_terms_clip"] == ",".join(["-5.0;5.0"] * 4)
