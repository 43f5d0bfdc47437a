"""Every quantity of an entity against MuJoCo C, and against what its docstring says of it."""

import inspect
import re

import mujoco
import numpy as np
import pytest
import torch
from mjlab_scene import EntityArticulationCfg, EntityData, InitialStateCfg, Scene
from mjlab_sim import Simulation
from scene_models import MakeWorlds, entity

# The free joint is not the first, one joint is a ball, and geoms and sites are turned against their bodies.
EVERYTHING = """
<mujoco>
  <worldbody>
    <body name="stand" pos="1 0 0">
      <joint name="crank" axis="0 1 0"/>
      <geom name="crank" size=".1" pos=".1 .2 0"/>
    </body>
    <body name="trunk" pos="0 0 1">
      <freejoint/>
      <geom name="trunk" type="box" size=".1 .2 .3" pos=".05 .02 0" euler="10 20 30"/>
      <site name="imu" pos=".1 0 0" euler="0 0 90"/>
      <body name="thigh" pos="0 0 -.3">
        <joint name="hip" range="-60 30"/>
        <geom name="thigh" type="capsule" size=".04" fromto="0 0 0 .1 0 -.3"/>
        <body name="shank" pos="0 0 -.3" euler="0 30 0">
          <joint name="ankle" type="ball"/>
          <joint name="stretch" type="slide" axis="0 0 1" range="-.1 .3"/>
          <geom name="shank" type="capsule" size=".04" fromto="0 0 0 0 .1 -.3"/>
          <site name="foot" pos="0 .1 -.3"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="rope"><joint joint="hip" coef="1"/><joint joint="stretch" coef="2"/></fixed></tendon>
  <actuator><motor name="push" joint="hip"/><position name="hold" joint="stretch" kp="20"/></actuator>
</mujoco>
"""
NUM_ENVS = 3


@pytest.fixture
def moving(make_worlds: MakeWorlds) -> tuple[Scene, Simulation, list[mujoco.MjData]]:
  """Two such robots in random states, and MuJoCo's own data of each world."""
  articulation = EntityArticulationCfg(soft_joint_pos_limit_factor=0.8)
  scene, sim = make_worlds(NUM_ENVS, other=EVERYTHING, robot=entity(EVERYTHING, articulation=articulation))
  generator = torch.Generator().manual_seed(1)
  for field in (sim.data.qvel, sim.data.xfrc_applied, sim.data.ctrl):
    field.copy_(torch.randn(field.shape, generator=generator, dtype=field.dtype))
  sim.data.qpos.add_(torch.randn(sim.data.qpos.shape, generator=generator, dtype=sim.dtype), alpha=0.3)
  for joint in range(sim.mj_model.njnt):
    kind, adr = sim.mj_model.jnt_type[joint], int(sim.mj_model.jnt_qposadr[joint])
    if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
      start = adr + (3 if kind == mujoco.mjtJoint.mjJNT_FREE else 0)
      quat = sim.data.qpos[:, start : start + 4]
      quat.copy_(quat / quat.norm(dim=-1, keepdim=True))
  sim.step()
  return scene, sim, [_in_c(sim, world) for world in range(NUM_ENVS)]


def _in_c(sim: Simulation, world: int) -> mujoco.MjData:
  data = mujoco.MjData(sim.mj_model)
  for name in ("qpos", "qvel", "ctrl", "xfrc_applied", "mocap_pos", "mocap_quat"):
    getattr(data, name)[:] = getattr(sim.data, name)[world].numpy()
  mujoco.mj_forward(sim.mj_model, data)
  return data


def _velocity(sim: Simulation, data: mujoco.MjData, kind: mujoco.mjtObj, index: int, local: bool = False) -> np.ndarray:
  twist = np.zeros(6)
  mujoco.mj_objectVelocity(sim.mj_model, data, kind.value, index, twist, int(local))
  return np.concatenate((twist[3:], twist[:3]))


def _quat(matrix: np.ndarray) -> np.ndarray:
  quat = np.zeros(4)
  mujoco.mju_mat2Quat(quat, matrix.reshape(9))
  return quat


def _same(actual: torch.Tensor, expected: np.ndarray | list, quaternion: bool = False) -> None:
  wanted = np.asarray(expected)
  if quaternion:
    wanted = wanted * np.sign(np.sum(wanted * actual.numpy(), axis=-1, keepdims=True))
  np.testing.assert_allclose(actual.numpy(), wanted, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", ["robot", "other"])
def test_poses_and_velocities_of_all_frames_equal_mujoco_c(moving, name: str) -> None:
  scene, sim, worlds = moving
  data, ids = scene[name].data, scene[name].indexing.ids
  obj = mujoco.mjtObj
  bodies, geoms, sites = (ids[kind] for kind in ("body", "geom", "site"))
  _same(data.body_link_pos_w, [d.xpos[bodies] for d in worlds])
  _same(data.body_link_quat_w, [d.xquat[bodies] for d in worlds], quaternion=True)
  _same(data.body_link_vel_w, [[_velocity(sim, d, obj.mjOBJ_XBODY, i) for i in bodies] for d in worlds])
  _same(data.body_com_pos_w, [d.xipos[bodies] for d in worlds])
  _same(data.body_com_quat_w, [[_quat(d.ximat[i]) for i in bodies] for d in worlds], quaternion=True)
  _same(data.body_com_vel_w, [[_velocity(sim, d, obj.mjOBJ_BODY, i) for i in bodies] for d in worlds])
  _same(data.geom_pos_w, [d.geom_xpos[geoms] for d in worlds])
  _same(data.geom_quat_w, [[_quat(d.geom_xmat[i]) for i in geoms] for d in worlds], quaternion=True)
  _same(data.geom_vel_w, [[_velocity(sim, d, obj.mjOBJ_GEOM, i) for i in geoms] for d in worlds])
  _same(data.site_pos_w, [d.site_xpos[sites] for d in worlds])
  _same(data.site_quat_w, [[_quat(d.site_xmat[i]) for i in sites] for d in worlds], quaternion=True)
  _same(data.site_vel_w, [[_velocity(sim, d, obj.mjOBJ_SITE, i) for i in sites] for d in worlds])
  _same(data.body_external_wrench, [d.xfrc_applied[bodies] for d in worlds])
  for frame in ("body_link", "body_com", "geom", "site", "root_com"):
    pos, quat, pose = (getattr(data, f"{frame}_{part}_w") for part in ("pos", "quat", "pose"))
    assert torch.equal(pose, torch.cat((pos, quat), -1)), frame


def test_saved_state_has_the_same_names_for_any_number_of_worlds(
  make_worlds: MakeWorlds,
) -> None:
  saved = [set(make_worlds(worlds, robot=EVERYTHING)[0]["robot"].data.state_dict()) for worlds in range(1, 10)]
  assert all(names == saved[0] for names in saved)


@pytest.mark.parametrize("name", ["robot", "other"])
def test_root_quantities_equal_mujoco_c(moving, name: str) -> None:
  scene, sim, worlds = moving
  data = scene[name].data
  root = sim.mj_model.body(f"{name}/trunk").id
  obj = mujoco.mjtObj
  _same(data.root_link_pose_w[:, :3], [d.xpos[root] for d in worlds])
  _same(data.root_link_quat_w, [d.xquat[root] for d in worlds], quaternion=True)
  _same(data.root_link_vel_w, [_velocity(sim, d, obj.mjOBJ_XBODY, root) for d in worlds])
  _same(data.root_com_pos_w, [d.xipos[root] for d in worlds])
  _same(data.root_com_quat_w, [_quat(d.ximat[root]) for d in worlds], quaternion=True)
  _same(data.root_com_vel_w, [_velocity(sim, d, obj.mjOBJ_BODY, root) for d in worlds])
  local = [_velocity(sim, d, obj.mjOBJ_XBODY, root, local=True) for d in worlds]
  _same(torch.cat((data.root_link_lin_vel_b, data.root_link_ang_vel_b), -1), local)
  rotations = [d.xmat[root].reshape(3, 3) for d in worlds]
  com = [_velocity(sim, d, obj.mjOBJ_BODY, root) for d in worlds]
  _same(data.root_com_lin_vel_b, [r.T @ v[:3] for r, v in zip(rotations, com, strict=True)])
  _same(data.root_com_ang_vel_b, [r.T @ v[3:] for r, v in zip(rotations, com, strict=True)])
  _same(data.projected_gravity_b, [r.T @ [0, 0, -1] for r in rotations])
  _same(data.heading_w, [np.arctan2(r[1, 0], r[0, 0]) for r in rotations])


@pytest.mark.parametrize("name", ["robot", "other"])
def test_joint_tendon_and_actuator_quantities_equal_mujoco_c(moving, name: str) -> None:
  scene, sim, worlds = moving
  data, model = scene[name].data, sim.mj_model
  joints = ["crank", "hip", "ankle", "stretch"]
  _same(data.joint_pos, [np.concatenate([d.joint(f"{name}/{j}").qpos for j in joints]) for d in worlds])
  _same(data.joint_vel, [np.concatenate([d.joint(f"{name}/{j}").qvel for j in joints]) for d in worlds])
  dofs = np.concatenate([np.arange(model.nv)[model.dof_jntid == model.joint(f"{name}/{j}").id] for j in joints])
  external = np.zeros((NUM_ENVS, model.nv))
  for d, row in zip(worlds, external, strict=True):
    for body in range(1, model.nbody):
      wrench = d.xfrc_applied[body]
      mujoco.mj_applyFT(model, d, wrench[:3], wrench[3:], d.xipos[body], body, row)
  _same(data.qfrc_external, external[:, dofs])
  _same(data.tendon_len[:, 0], [d.tendon(f"{name}/rope").length[0] for d in worlds])
  _same(data.tendon_vel[:, 0], [d.tendon(f"{name}/rope").velocity[0] for d in worlds])


def test_acceleration_stage_quantities_are_those_of_the_substep_just_done(make_worlds) -> None:
  scene, sim = make_worlds(1, robot=EVERYTHING)
  sim.data.ctrl.fill_(0.7)
  expected = _in_c(sim, 0)
  sim.step()
  data = scene["robot"].data
  dofs = [0, 7, 8, 9, 10, 11]
  _same(data.joint_acc[0], expected.qacc[dofs])
  _same(data.actuator_force[0], expected.actuator_force)
  _same(data.qfrc_actuator[0], expected.qfrc_actuator[dofs])


def test_limits_are_the_models_and_soft_limits_narrow_them_about_the_middle(moving) -> None:
  data = moving[0]["robot"].data
  inf = np.inf
  low, high = np.deg2rad([-60.0, 30.0])
  ball = [[-inf, inf]] * 4
  _same(data.joint_pos_limits[0], [[-inf, inf], [low, high], *ball, [-0.1, 0.3]])
  inset = 0.1 * (high - low)
  _same(data.soft_joint_pos_limits[0], [[-inf, inf], [low + inset, high - inset], *ball, [-0.06, 0.26]])


def test_limits_and_gravity_follow_their_randomisation(make_worlds) -> None:
  articulation = EntityArticulationCfg(soft_joint_pos_limit_factor=0.8)
  scene, sim = make_worlds(2, robot=entity(EVERYTHING, articulation=articulation))
  data = scene["robot"].data
  sim.expand_model_fields(["jnt_range", "opt.gravity"])
  hip = sim.mj_model.joint("robot/hip").id
  sim.model.jnt_range[1, hip] = torch.tensor([-0.5, 0.5], dtype=sim.dtype)
  _same(data.joint_pos_limits[:, 1], [np.deg2rad([-60, 30]), [-0.5, 0.5]])
  _same(data.soft_joint_pos_limits[:, 1], [np.deg2rad([-51, 21]), [-0.4, 0.4]])
  sim.model.opt.gravity[1] = torch.tensor([-9.81, 0.0, 0.0], dtype=sim.dtype)
  _same(data.gravity_vec_w, [[0, 0, -1], [-1, 0, 0]])
  _same(data.projected_gravity_b, [[0, 0, -1], [-1, 0, 0]])


def test_gravity_direction_is_the_simulators(make_worlds) -> None:
  tilted = EVERYTHING.replace("<mujoco>", '<mujoco><option gravity="3 0 -4"/>', 1)
  scene, _ = make_worlds(1, robot=tilted)
  _same(scene["robot"].data.gravity_vec_w, [[0.6, 0, -0.8]])
  _same(scene["robot"].data.projected_gravity_b, [[0.6, 0, -0.8]])


def _quantities() -> dict[str, str]:
  """Public tensors of EntityData and their documentation, attributes included."""
  found: dict[str, str] = {}
  for cls in EntityData.__mro__:
    for name, member in vars(cls).items():
      if isinstance(member, property) and not name.startswith("_"):
        found[name] = member.__doc__ or ""
    if cls.__module__.startswith("mjlab_scene"):
      fields = r'^  (\w+)(?:: torch\.Tensor| = forwarded\("[\w.]+"\))\n  """(.*?)"""'
      for name, doc in re.findall(fields, inspect.getsource(cls), re.M | re.S):
        found[name] = doc
  return found


@pytest.mark.parametrize("fixed", [False, True], ids=["floating", "fixed"])
def test_every_documented_shape_is_the_real_one(make_worlds, fixed: bool) -> None:
  text = EVERYTHING.replace("<freejoint/>", "") if fixed else EVERYTHING
  scene, _ = make_worlds(NUM_ENVS, robot=entity(text, init_state=InitialStateCfg(pos=(0, 0, 1))))
  sizes = {"num_envs": NUM_ENVS, "num_bodies": 5 if fixed else 4, "num_geoms": 4, "num_sites": 2, "num_tendons": 1}
  sizes |= {"num_actuators": 2, "num_joint_pos": 7, "num_joint_vel": 6, "13 or 7": 7 if fixed else 13}
  quantities = _quantities()
  assert len(quantities) > 60
  for name, doc in quantities.items():
    shape = re.search(r"\(((?:num_envs|1)(?:, [\w ]+)*),?\) \[[^\]]+\]", doc)
    assert shape, f"{name}: says no shape and unit: {doc}"
    documented = tuple(sizes.get(part) or int(part) for part in shape.group(1).split(", "))
    assert tuple(getattr(scene["robot"].data, name).shape) == documented, name


def test_a_quantity_is_computed_once_for_each_state(make_worlds, monkeypatch: pytest.MonkeyPatch) -> None:
  scene, sim = make_worlds(2, robot=EVERYTHING)
  data = scene["robot"].data
  first = data.root_link_lin_vel_b
  assert data.root_link_lin_vel_b is first
  sim.data.qvel.add_(1.0)
  assert not torch.equal(data.root_link_lin_vel_b, first)
  second = data.root_link_lin_vel_b
  sim.step()
  assert data.root_link_lin_vel_b is not second


def test_derived_quantities_are_right_immediately_after_a_write(make_worlds) -> None:
  scene, _ = make_worlds(2, robot=EVERYTHING)
  robot = scene["robot"]
  before = robot.data.body_link_pos_w.clone()
  pose = robot.data.root_link_pose_w.clone()
  pose[:, 0] += 2.0
  robot.write_root_pose(pose, torch.tensor([False, True]))
  moved = robot.data.body_link_pos_w - before
  _same(moved[0], np.zeros((4, 3)))
  _same(moved[1, 1:], np.tile([2.0, 0, 0], (3, 1)))


def test_joint_and_root_state_are_live_views_where_the_layout_allows(make_worlds) -> None:
  text = """
  <mujoco><worldbody><body><freejoint/><geom size=".1"/>
    <body><joint/><geom size=".1"/></body></body></worldbody></mujoco>
  """
  scene, sim = make_worlds(2, a=text, b=text)
  data = scene["b"].data
  kept = (data.joint_pos, data.joint_vel, data.root_link_pose_w, data.root_link_lin_vel_w, data.root_link_ang_vel_b)
  sim.data.qpos.fill_(0.25)
  sim.data.qvel.fill_(0.5)
  assert all((view == value).all() for view, value in zip(kept, (0.25, 0.5, 0.25, 0.5, 0.5), strict=True))
