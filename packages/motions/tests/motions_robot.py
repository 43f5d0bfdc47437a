"""A small robot with two legs, exact mirror images, and an arm that slides; its motions, and their files."""

import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_motions.kinematics import Kinematics, derived_arrays
from mjlab_motions.motion import Motion
from mjlab_motions.motion_file import save_motion

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
  """Return a smooth motion of all joints and the root."""
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
  """Return a motion that stands still."""
  moving = wiggle(round(seconds * rate) + 1, rate)
  pos, quat = torch.zeros_like(moving.root_pos), torch.zeros_like(moving.root_quat)
  pos[:, 2], quat[:, 0] = height, 1.0
  joints = torch.zeros_like(moving.joint_pos)
  return moving.changed("", name="still", root_pos=pos, root_quat=quat, joint_pos=joints)


def qpos_of(motion: Motion, quat: torch.Tensor | None = None) -> np.ndarray:
  """Return root and joints in one array, with other quaternions if given."""
  return torch.cat((motion.root_pos, motion.root_quat if quat is None else quat, motion.joint_pos), 1).numpy()


def npz(path: Path, **arrays: Any) -> Path:
  np.savez(path, **arrays)
  return path


def arrays_of(motion: Motion, path: Path) -> dict[str, Any]:
  """Save a motion with its derived arrays, and return the arrays of the file."""
  save_motion(motion, path, derived_arrays(motion, robot()))
  with np.load(path) as file:
    return dict(file)
