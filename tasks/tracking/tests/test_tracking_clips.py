"""The clips that ship: named, faultless, smooth, and balanced in every frame."""

import math
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from mjlab_motions.editing import mirror, twin_name
from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion
from mjlab_motions.motion_file import load_motion
from mjlab_motions.quality import check_quality
from mjlab_motions.timeline import derivative
from mjlab_robots import SOFT_JOINT_POS_LIMIT_FACTOR, g1_spec, go1_spec

CLIPS = sorted(Path(str(files("mjlab_motions") / "clips")).glob("*.npz"))
DIRECTIONS = torch.stack([torch.tensor([math.cos(a), math.sin(a)]) for a in np.linspace(0, 2 * np.pi, 72)]).double()


@pytest.fixture(scope="module")
def robot() -> Kinematics:
  return Kinematics(g1_spec(meshes="never").compile())


RECORDED = next(path for path in CLIPS if path.stem == "go1_trot")


@pytest.fixture(params=[path for path in CLIPS if path != RECORDED], ids=lambda path: path.stem)
def clip(request: pytest.FixtureRequest) -> Motion:
  return load_motion(request.param)


def test_four_clips_ship_with_their_licence() -> None:
  assert [path.stem for path in CLIPS] == ["go1_trot", "march_in_place", "side_step_dance", "squat_and_wave"]
  assert {load_motion(path).license for path in CLIPS} == {"Apache-2.0"}
  assert sum(path.stat().st_size for path in CLIPS) < 400_000


def test_the_clip_of_a_policy_is_a_faultless_trot_along_an_arc() -> None:
  trot, robot = load_motion(RECORDED), Kinematics(go1_spec(meshes="never").compile())
  assert "Mjlab-Velocity-Flat-Unitree-Go1" in trot.source
  assert trot.history == ("recorded from a simulation",)
  report = check_quality(trot, robot)
  assert report.severity == "ok", report.table()
  # The command was 0.8 m/s ahead and 0.5 rad/s to the left for 4 s.
  way = trot.root_pos[1:] - trot.root_pos[:-1]
  assert 2.8 < float(way[:, :2].norm(dim=1).sum()) < 3.6
  turned = 2.0 * torch.atan2(trot.root_quat[:, 3], trot.root_quat[:, 0])
  assert 1.6 < float(turned[-1] - turned[0]) < 2.4
  # Diagonal legs swing together.
  thigh = {name[:2]: trot.joint_pos[:, i] for i, name in enumerate(trot.joint_names) if "thigh" in name}
  together = np.corrcoef(np.stack([thigh[leg].numpy() for leg in ("FL", "RR", "FR", "RL")]))
  assert together[0, 1] > 0.5
  assert together[2, 3] > 0.5
  assert together[0, 2] < 0.0


def test_a_clip_that_ships_is_faultless(clip: Motion, robot: Kinematics) -> None:
  report = check_quality(clip, robot)
  assert report.severity == "ok", report.table()


def test_a_clip_that_ships_is_within_soft_limits(clip: Motion, robot: Kinematics) -> None:
  low, high = torch.from_numpy(robot.model.jnt_range[robot.joint_ids]).unbind(1)
  inset = 0.5 * (1.0 - SOFT_JOINT_POS_LIMIT_FACTOR) * (high - low)
  joints = robot.columns_of(clip)
  assert (joints > low + inset).all()
  assert (joints < high - inset).all()


def test_a_clip_that_ships_is_smooth(clip: Motion) -> None:
  # Servos of the G1 turn no joint faster than some hundred rad/s^2.
  acceleration = derivative(derivative(clip.joint_pos, clip.rate), clip.rate)
  assert acceleration.abs().max() < 40.0
  assert derivative(clip.root_pos, clip.rate).abs().max() < 0.5


def test_a_clip_that_ships_is_balanced_in_every_frame(clip: Motion, robot: Kinematics) -> None:
  pos, quat = robot.poses(clip.root_pos, clip.root_quat, robot.columns_of(clip))
  mass = robot.center_of_mass(pos, quat)[:, :2]
  # The soles are capsules; the robot stands on their ends.
  model = robot.model
  soles = [geom for geom in robot.collision_geoms() if "foot" in model.geom(geom).name]
  assert len(soles) == 14
  data = mujoco.MjData(model)
  margins = []
  for frame in range(clip.num_frames):
    data.qpos[:] = torch.cat((clip.root_pos[frame], clip.root_quat[frame], clip.joint_pos[frame]))
    mujoco.mj_kinematics(model, data)
    points = []
    for geom in soles:
      along = data.geom_xmat[geom].reshape(3, 3)[:, 2] * model.geom_size[geom][1]
      points += [data.geom_xpos[geom] + along, data.geom_xpos[geom] - along]
    lowest = min(point[2] for point in points)
    touching = torch.tensor(np.array([point[:2] for point in points if point[2] < lowest + 0.004]))
    # Within the support polygon: in every direction something stands further out.
    reach = (touching @ DIRECTIONS.T).amax(0) - mass[frame] @ DIRECTIONS.T
    margins.append(float(reach.min()))
  assert min(margins) > 0.015


def test_in_a_clip_that_ships_the_robot_touches_itself_nowhere(clip: Motion, robot: Kinematics) -> None:
  data = mujoco.MjData(robot.model)
  touched = set()
  for frame in range(clip.num_frames):
    data.qpos[:] = torch.cat((clip.root_pos[frame], clip.root_quat[frame], clip.joint_pos[frame]))
    mujoco.mj_fwdPosition(robot.model, data)
    touched |= {tuple(robot.model.geom(int(geom)).name for geom in contact.geom) for contact in data.contact}
  assert touched == set()


def test_the_g1_is_symmetric_to_a_tenth_of_a_millimetre(robot: Kinematics) -> None:
  torch.manual_seed(0)
  joints = 0.5 * torch.randn(8, 29, dtype=torch.float64)
  motion = Motion(
    name="random",
    rate=50.0,
    root_body="pelvis",
    joint_names=robot.joint_names,
    root_pos=torch.zeros(8, 3, dtype=torch.float64),
    root_quat=torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64).repeat(8, 1),
    joint_pos=joints,
  )
  mirrored = mirror(motion, robot)
  pos, _ = robot.poses(motion.root_pos, motion.root_quat, motion.joint_pos)
  pos_m, _ = robot.poses(mirrored.root_pos, mirrored.root_quat, mirrored.joint_pos)
  twins = [robot.body_names.index(twin_name(name)) for name in robot.body_names]
  flip = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
  assert (pos_m - pos[:, twins] * flip).abs().max() < 1e-4
