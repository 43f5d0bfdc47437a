"""The smallest robot that shows what motions are about: two legs, exact mirror images, and an arm that slides."""

import math

import mujoco
import torch
from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion

LEG = """
<body name="{side}_thigh" pos="0.02 {y} -0.05" euler="{tilt} 0 0">
  <joint name="{side}_hip_roll" axis="1 0 0" range="-60 60"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1"/>
  <body name="{side}_shin" pos="0 0 -0.3">
    <joint name="{side}_knee" axis="0 1 0" pos="0.01 0 0.02" range="-10 120"/>
    <geom type="box" size="0.05 0.02 0.15" pos="0 0 -0.15" mass="1"/>
  </body>
</body>
"""
XML = f"""
<mujoco>
  <compiler angle="degree"/>
  <worldbody>
    <geom name="ground" type="plane" size="1 1 1"/>
    <body name="pelvis" pos="0 0 0.7">
      <freejoint/>
      <geom type="sphere" size="0.1" mass="3"/>
      {LEG.format(side="left", y=0.1, tilt=10)}
      {LEG.format(side="right", y=-0.1, tilt=-10)}
      <body name="arm" pos="0 0 0.2" euler="0 30 0">
        <joint name="reach" type="slide" axis="0 0 1" range="0 0.3"/>
        <geom type="ellipsoid" size="0.05 0.04 0.03" mass="0.5"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def robot() -> Kinematics:
  return Kinematics(mujoco.MjModel.from_xml_string(XML))


def wiggle(frames: int = 60, rate: float = 50.0) -> Motion:
  """A smooth motion of all joints and the root."""
  t = torch.arange(frames, dtype=torch.float64) / rate
  names = robot().joint_names
  joints = torch.stack([0.3 * torch.sin((1.0 + 0.5 * i) * t + i) for i in range(len(names))], 1)
  joints[:, names.index("reach")] = 0.15 + 0.1 * torch.sin(t)
  yaw, lean = 0.7 * torch.sin(2.0 * t) + 1.4, 0.1 * torch.sin(3.0 * t)
  zero = torch.zeros_like(t)
  quat = torch.stack(
    (
      torch.cos(yaw / 2) * torch.cos(lean / 2),
      torch.cos(yaw / 2) * torch.sin(lean / 2),
      torch.sin(yaw / 2) * torch.sin(lean / 2),
      torch.sin(yaw / 2) * torch.cos(lean / 2),
    ),
    1,
  )
  pos = torch.stack((0.5 * t, 0.1 * torch.sin(math.pi * t), 0.75 + zero), 1)
  return Motion(
    name="wiggle", rate=rate, root_body="pelvis", joint_names=names, root_pos=pos, root_quat=quat, joint_pos=joints
  )


def constant(seconds: float = 1.0, height: float = 0.75, rate: float = 50.0) -> Motion:
  """Standing still."""
  names = robot().joint_names
  frames = round(seconds * rate) + 1
  return Motion(
    name="still",
    rate=rate,
    root_body="pelvis",
    joint_names=names,
    root_pos=torch.tensor([[0.0, 0.0, height]], dtype=torch.float64).repeat(frames, 1),
    root_quat=torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64).repeat(frames, 1),
    joint_pos=torch.zeros(frames, len(names), dtype=torch.float64),
  )
