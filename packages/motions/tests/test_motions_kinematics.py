"""Forward kinematics against MuJoCo C, velocities and support points."""

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core.errors import MjlabError
from mjlab_motions.kinematics import Kinematics
from motions_robot import XML, robot, wiggle


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
  return mujoco.MjModel.from_xml_string(XML)


def random_state(model: mujoco.MjModel) -> mujoco.MjData:
  rng = np.random.default_rng(3)
  data = mujoco.MjData(model)
  data.qpos[:] = rng.normal(size=model.nq) * 0.4
  data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
  data.qvel[:] = rng.normal(size=model.nv)
  mujoco.mj_forward(model, data)
  return data


def torch_of(values: np.ndarray) -> torch.Tensor:
  return torch.from_numpy(np.array(values))[None]


def test_bodies_are_where_mujoco_has_them(model: mujoco.MjModel) -> None:
  kinematics, data = Kinematics(model), random_state(model)
  pos, quat = kinematics.poses(torch_of(data.qpos[:3]), torch_of(data.qpos[3:7]), torch_of(data.qpos[7:]))
  assert kinematics.body_names == tuple(model.body(b).name for b in range(1, model.nbody))
  np.testing.assert_allclose(pos[0], data.xpos[1:], atol=1e-12)
  np.testing.assert_allclose((quat[0] * torch.from_numpy(data.xquat[1:])).sum(-1).abs(), 1.0, atol=1e-12)
  np.testing.assert_allclose(kinematics.center_of_mass(pos, quat)[0], data.subtree_com[1], atol=1e-12)


def test_bodies_move_as_mujoco_has_them(model: mujoco.MjModel) -> None:
  kinematics, data = Kinematics(model), random_state(model)
  pos, quat = kinematics.poses(torch_of(data.qpos[:3]), torch_of(data.qpos[3:7]), torch_of(data.qpos[7:]))
  spin = np.empty(3)
  mujoco.mju_rotVecQuat(spin, data.qvel[3:6], data.qpos[3:7])
  linear, angular = kinematics.velocities(pos, quat, torch_of(data.qvel[:3]), torch_of(spin), torch_of(data.qvel[6:]))
  expected = np.empty((model.nbody - 1, 6))
  for body in range(1, model.nbody):
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, expected[body - 1], 0)
  np.testing.assert_allclose(angular[0], expected[:, :3], atol=1e-12)
  np.testing.assert_allclose(linear[0], expected[:, 3:], atol=1e-12)


def test_lowest_points_are_where_a_plane_from_below_first_touches() -> None:
  # MuJoCo's own distance between each geom and a plane far below.
  spec = mujoco.MjSpec.from_string(XML)
  for type_, size in (("mjGEOM_CYLINDER", (0.05, 0.1, 0)), ("mjGEOM_SPHERE", (0.07, 0, 0))):
    spec.body("arm").add_geom(type=getattr(mujoco.mjtGeom, type_), size=size, pos=(0.1, 0, 0), euler=(20, 50, 0))
  spec.geom("ground").pos = (0.0, 0.0, -5.0)
  model = spec.compile()
  kinematics, data = Kinematics(model), random_state(model)
  pos, quat = kinematics.poses(torch_of(data.qpos[:3]), torch_of(data.qpos[3:7]), torch_of(data.qpos[7:]))
  points, rows = kinematics.lowest_points(pos, quat)
  geoms = kinematics.collision_geoms()
  assert [kinematics.body_names[row] for row in rows] == [model.body(model.geom_bodyid[g]).name for g in geoms]
  ground = model.geom("ground").id
  for i, geom in enumerate(geoms):
    distance = mujoco.mj_geomDistance(model, data, geom, ground, 10.0, np.empty(6))
    assert float(points[0, i, 2]) + 5.0 == pytest.approx(distance, abs=1e-5)


def test_a_robot_in_a_scene_is_found_by_its_prefix() -> None:
  scene = mujoco.MjSpec()
  for name in ("one/", "two/"):
    scene.attach(mujoco.MjSpec.from_string(XML), prefix=name, frame=scene.worldbody.add_frame())
  model = scene.compile()
  assert Kinematics(model, "two/").joint_names == robot().joint_names
  with pytest.raises(MjlabError, match="one/pelvis, two/pelvis"):
    Kinematics(model)


def test_a_motion_of_another_robot_is_refused_by_name() -> None:
  motion = wiggle()
  renamed = tuple(name.replace("left_knee", "left_nee") for name in motion.joint_names)
  with pytest.raises(MjlabError, match=r"joint of the robot 'left_nee' does not exist\. Nearest: left_knee"):
    robot().columns_of(motion.changed("renamed", joint_names=renamed))
  strangers = tuple(f"arm{i}" for i in range(len(motion.joint_names) - 1))
  with pytest.raises(MjlabError, match=r"joint of the robot 'arm0' does not exist"):
    robot().columns_of(motion.changed("renamed", joint_names=(motion.joint_names[0], *strangers)))
  fewer = motion.changed("cut", joint_names=motion.joint_names[1:], joint_pos=motion.joint_pos[:, 1:])
  with pytest.raises(MjlabError, match=f"joint of the motion '{motion.joint_names[0]}' does not exist"):
    robot().columns_of(fewer)
  with pytest.raises(MjlabError, match=r"root body of the robot 'torso' does not exist.* pelvis"):
    robot().columns_of(motion.changed("renamed", root_body="torso"))


def test_joints_are_placed_by_name_not_by_order() -> None:
  motion = wiggle()
  backwards = motion.changed("reversed", joint_names=motion.joint_names[::-1], joint_pos=motion.joint_pos.flip(1))
  assert torch.equal(robot().columns_of(backwards), motion.joint_pos)
