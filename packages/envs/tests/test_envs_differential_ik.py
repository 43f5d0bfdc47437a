"""Differential inverse kinematics against MuJoCo's Jacobians and NumPy's solver."""

from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from envs_hopper import Make
from envs_watch import Watch
from mjlab_actuators import NativePositionActuatorCfg
from mjlab_core.errors import ConfigError
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_envs.mdp.action_terms.differential_ik import solve_definite
from mjlab_scene import EntityArticulationCfg, EntityCfg, InitialStateCfg, SceneCfg
from mjlab_sim import SimulationCfg

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 0"/>
  <default>
    <geom type="capsule" size=".02" mass=".3" contype="0" conaffinity="0"/>
    <joint axis="0 1 0" range="-2 2" armature=".05"/>
  </default>
  <worldbody>
    <body name="base">
      <body name="turret">
        <joint name="yaw" axis="0 0 1"/>
        <geom fromto="0 0 0 0 0 .1"/>
        <body name="upper" pos="0 0 .1">
          <joint name="shoulder"/>
          <geom fromto="0 0 0 .3 0 0"/>
          <body name="fore" pos=".3 0 0" quat="1 0 0 .1">
            <joint name="elbow"/>
            <geom fromto="0 0 0 .25 0 0"/>
            <body name="slider" pos=".25 0 0">
              <joint name="reach" type="slide" axis="1 0 0" range="-.1 .1"/>
              <geom fromto="0 0 0 .05 0 0"/>
              <body name="wrist" pos=".05 0 0">
                <joint name="roll" axis="1 0 0" pos="0 .01 0"/>
                <joint name="pitch"/>
                <geom name="palm" type="box" size=".03 .02 .01" pos=".02 0 .01" quat="1 .3 0 .2"/>
                <site name="tip" pos=".06 .01 -.02" quat="1 .5 -.2 0"/>
                <body name="finger" pos=".05 0 0">
                  <joint name="finger" type="slide" axis="0 1 0" range="0 .04"/>
                  <geom type="sphere" size=".01"/>
                </body>
                <body name="thumb" pos=".05 0 0">
                  <joint name="thumb" type="slide" axis="0 1 0" range="-.04 0"/>
                  <geom type="sphere" size=".01"/>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
JOINTS = ("yaw", "shoulder", "elbow", "reach", "roll", "pitch")
HOME = {"shoulder": 0.4, "elbow": 0.7, "pitch": -0.3}
ROOT: dict[str, Any] = {"pos": (0.3, -0.2, 0.1), "rot": (0.8, 0.1, -0.2, 0.5)}


def arm_cfg(engine: Any = "native", num_envs: int = 4, **options: Any) -> ManagerBasedRlEnvCfg:
  """An arm on a base that stands askew, driven by IK."""
  servo = NativePositionActuatorCfg(target_names_expr=(".*",), stiffness=60.0, damping=8.0)
  arm = EntityCfg(
    spec_fn=lambda: mujoco.MjSpec.from_string(ARM),
    init_state=InitialStateCfg(joint_pos=HOME, **ROOT),
    articulation=EntityArticulationCfg(actuators=(servo,), soft_joint_pos_limit_factor=0.8),
  )
  ik: dict[str, Any] = {"actuators": JOINTS, "frame_type": "site", "frame_name": "tip"} | options
  return ManagerBasedRlEnvCfg(
    decimation=2,
    episode_length_s=100.0,
    seed=3,
    scene=SceneCfg(num_envs=num_envs, entities={"robot": arm}),
    sim=SimulationCfg(engine=engine, timestep=0.005, num_threads=1, nconmax=8, njmax=32),
    actions={"hand": mdp.DifferentialIKActionCfg(**ik)},
  )


def reaching(make: Make, **options: Any) -> tuple[Any, mdp.DifferentialIKAction]:
  """An environment at random joint positions, some outside their soft limits, and its action."""
  env = make(arm_cfg(**options))
  scramble(env, 0.95)
  return env, env.action_manager.get_term("hand")


def scramble(env: Any, share: float) -> None:
  robot = env.scene["robot"]
  limits = robot.data.joint_pos_limits
  unit = torch.rand(env.num_envs, limits.shape[1], generator=torch.Generator().manual_seed(1)).to(limits)
  position = torch.lerp(limits[..., 0], limits[..., 1], 0.5 + share * (unit - 0.5))
  robot.write_joint_state(position, torch.zeros_like(position))


def in_mujoco(env: Any, world: int, bias: np.ndarray | None = None) -> mujoco.MjData:
  """One world in MuJoCo C, with `bias` added to the positions of JOINTS."""
  model = env.sim.mj_model
  data = mujoco.MjData(model)
  data.qpos[:] = env.sim.data.qpos[world].numpy()
  data.mocap_pos[:] = env.sim.data.mocap_pos[world].numpy()
  data.mocap_quat[:] = env.sim.data.mocap_quat[world].numpy()
  if bias is not None:
    data.qpos[: len(JOINTS)] += bias
  mujoco.mj_forward(model, data)
  return data


def frame_in_mujoco(env: Any, data: mujoco.MjData, kind: str, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
  """Position, orientation matrix and Jacobian (6, joints) of a frame."""
  model, jacobian = env.sim.mj_model, np.zeros((6, env.sim.mj_model.nv))
  call = {"body": mujoco.mj_jacBody, "site": mujoco.mj_jacSite, "geom": mujoco.mj_jacGeom}[kind]
  frame = getattr(data, kind)(f"robot/{name}")
  call(model, data, jacobian[:3], jacobian[3:], frame.id)
  return frame.xpos.copy(), frame.xmat.reshape(3, 3).copy(), jacobian[:, : len(JOINTS)]


def rotation_to(goal: np.ndarray, matrix: np.ndarray) -> np.ndarray:
  """Rotation vector from an orientation matrix to a quaternion, world frame."""
  now, inverse, way, vector = np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(3)
  mujoco.mju_mat2Quat(now, matrix.flatten())
  mujoco.mju_negQuat(inverse, now)
  mujoco.mju_mulQuat(way, goal, inverse)
  mujoco.mju_quat2Vel(vector, way, 1.0)
  return vector


@pytest.mark.parametrize(("kind", "name"), [("body", "wrist"), ("site", "tip"), ("geom", "palm")])
def test_the_jacobian_of_every_kind_of_frame_is_mujocos(make: Make, engine: str, kind: str, name: str) -> None:
  env, term = reaching(make, engine=engine, frame_type=kind, frame_name=name)
  tolerance = 1e-12 if engine == "native" else 2e-6
  pos, quat, jacobians = term._believed()
  for world in range(env.num_envs):
    xpos, xmat, jacobian = frame_in_mujoco(env, in_mujoco(env, world), kind, name)
    np.testing.assert_allclose(jacobians[world].numpy(), jacobian, atol=tolerance)
    np.testing.assert_allclose(pos[world].numpy(), xpos, atol=tolerance)
    assert np.abs(rotation_to(quat[world].double().numpy(), xmat)).max() < 10 * tolerance


@pytest.mark.parametrize(
  "weights", [(1.0, 1.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0), (0.0, 0.7, 3.0, 0.0), (1.0, 0.5, 2.0, 0.3)]
)
def test_a_step_is_the_damped_least_squares_solution(
  make: Make, engine: str, weights: tuple[float, float, float, float]
) -> None:
  wp, wo, wl, wq = weights
  posture = {name: 0.05 * i for i, name in enumerate(JOINTS)}
  env, term = reaching(
    make,
    engine=engine,
    damping=0.03,
    max_dq=1e3,
    position_weight=wp,
    orientation_weight=wo,
    joint_limit_weight=wl,
    posture_weight=wq,
    posture_target=posture if wq else None,
  )
  action = torch.randn(env.num_envs, term.action_dim, generator=torch.Generator().manual_seed(2))
  term.process_actions(action)
  dq = term.solve().numpy()
  low, high = env.scene["robot"].data.soft_joint_pos_limits[0, : len(JOINTS)].T.numpy()
  outside = 0
  for world in range(env.num_envs):
    data = in_mujoco(env, world)
    xpos, xmat, jacobian = frame_in_mujoco(env, data, "site", "tip")
    q = data.qpos[: len(JOINTS)]
    back = q.clip(low, high) - q
    outside += np.count_nonzero(back)
    weight = np.diag([wp**2] * 3 + [wo**2] * 3)
    error = np.concatenate([term.goal_pos_w[world].numpy() - xpos, np.zeros(3)])
    if wo:
      error[3:] = rotation_to(term.goal_quat_w[world].double().numpy(), xmat)
    matrix = jacobian.T @ weight @ jacobian + np.diag(wl**2 * (back != 0)) + (wq**2 + 0.03**2) * np.eye(len(JOINTS))
    right = jacobian.T @ weight @ error + wl**2 * back + wq**2 * (np.array(list(posture.values())) - q)
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(
      dq[world], expected, rtol=0, atol=(1e-10 if engine == "native" else 2e-3) * np.abs(expected).max()
    )
  assert outside


def test_solutions_of_badly_conditioned_systems_are_those_of_numpy() -> None:
  rng = np.random.default_rng(0)
  tall = rng.normal(size=(50, 3, 6))
  matrix = tall.transpose(0, 2, 1) @ tall + 1e-8 * np.eye(6)
  right = np.einsum("nkj,nk->nj", tall, rng.normal(size=(50, 3)))
  got = solve_definite(torch.from_numpy(matrix), torch.from_numpy(right)).numpy()
  np.testing.assert_allclose(got, np.linalg.solve(matrix, right[..., None])[..., 0], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("damping", [1e-6, 0.05])
def test_near_singular_poses_steps_are_finite_and_bounded(make: Make, damping: float) -> None:
  env, term = reaching(make, damping=damping, max_dq=0.3)
  robot = env.scene["robot"]
  # Stretched out, with the axes of shoulder, elbow and pitch in line: nothing turns the hand about its own z.
  robot.write_joint_state(torch.zeros(1, 8), torch.zeros(1, 8))
  term.process_actions(
    torch.tensor([[1.0, 0, 0, 0, 0, 0], [0, 0, 5.0, 0, 0, 9.0], [0, 1e-3, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]])
  )
  dq = term.solve()
  assert torch.isfinite(dq).all()
  assert dq.abs().max() <= 0.3
  assert dq[0].abs().max() > 0
  assert dq[3].abs().max() < 1e-15
  # |dq| <= |e| / (2 damping) for every Jacobian.
  assert torch.linalg.vector_norm(dq[2]) <= 1e-3 / (2 * damping)


def test_changes_are_along_the_axes_of_the_root(make: Make) -> None:
  env, term = reaching(make, delta_pos_scale=0.1, delta_ori_scale=0.2)
  action = torch.randn(env.num_envs, 6, generator=torch.Generator().manual_seed(2))
  pos, quat = term.frame_pose()
  term.process_actions(action)
  root = np.zeros(9)
  mujoco.mju_quat2Mat(root, np.array(ROOT["rot"]) / np.linalg.norm(ROOT["rot"]))
  root = root.reshape(3, 3)
  moved = (term.goal_pos_w - pos).numpy()
  np.testing.assert_allclose(moved, 0.1 * action[:, :3].double().numpy() @ root.T, atol=1e-9)
  for world in range(env.num_envs):
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat[world].numpy())
    turned = rotation_to(term.goal_quat_w[world].numpy(), matrix.reshape(3, 3))
    np.testing.assert_allclose(turned, 0.2 * root @ action[world, 3:].double().numpy(), atol=1e-7)


def test_changes_of_the_goal_add_up_to_max_lead_and_begin_again_with_the_episode(make: Make) -> None:
  _, term = reaching(make, relative_to="goal", delta_pos_scale=0.02, delta_ori_scale=0.2, max_lead=(0.05, 0.5))
  (pos, quat), action = term.frame_pose(), torch.tensor([[0.0, 0.0, 1.0, 0.0, 1.0, 0.0]]).repeat(4, 1)
  for lead, turn in ((0.02, 0.2), (0.04, 0.4), (0.05, 0.5), (0.05, 0.5)):
    term.process_actions(action)
    ahead = torch.linalg.vector_norm(term.goal_pos_w - pos, dim=-1)
    torch.testing.assert_close(ahead, torch.full_like(ahead, lead))
    turned = 2.0 * torch.acos((term.goal_quat_w * quat).sum(-1).abs())
    torch.testing.assert_close(turned, torch.full_like(turned, turn), atol=1e-6, rtol=0)
  term.reset(torch.tensor([True, False, False, False]))
  term.process_actions(torch.zeros(4, 6))
  assert torch.allclose(term.goal_pos_w[0], pos[0], atol=1e-12)
  assert torch.linalg.vector_norm(term.goal_pos_w[1] - pos[1]) > 0.049


def test_a_world_that_diverged_has_a_goal_again_after_its_reset(make: Make) -> None:
  env, term = reaching(make, relative_to="goal")
  robot, action = env.scene["robot"], torch.full((4, 6), 0.01)
  position = robot.data.joint_pos.clone()
  broken = position.clone()
  broken[1] = torch.nan
  for joints in (position, broken):
    robot.write_joint_state(joints, torch.zeros_like(joints))
    term.process_actions(action)
  assert term.goal_pos_w.isnan().any(1).tolist() == [False, True, False, False]
  robot.write_joint_state(position, torch.zeros_like(position))
  term.reset(torch.tensor([False, True, False, False]))
  term.process_actions(action)
  pos, quat = term.frame_pose()
  assert torch.linalg.vector_norm(term.goal_pos_w - pos, dim=-1).max() < 0.1
  assert (term.goal_quat_w * quat).sum(-1).abs().min() > 0.99


@pytest.mark.parametrize("relative_to", ["pose", "goal"])
def test_without_actions_an_arm_holds_its_goal_and_sinks_from_its_pose(make: Make, relative_to: str) -> None:
  cfg = arm_cfg(relative_to=relative_to)
  cfg.sim.gravity = (0.0, 0.0, -3.0)
  env = make(cfg)
  term = env.action_manager.get_term("hand")
  heights = []
  for _ in range(3):
    heights.append(term.frame_pose()[0][:, 2].clone())
    for _ in range(60):
      env.step(torch.zeros(4, 6))
  # Servos are springs: they give way until they carry the arm. Then it sinks no further, or it does.
  assert (heights[0] > heights[1]).all()
  later = heights[1] - heights[2]
  assert (later < 1e-3).all() if relative_to == "goal" else (later > 0.05).all()


def test_poses_are_in_the_frame_of_the_root_and_their_quaternion_need_not_be_unit(make: Make) -> None:
  env, term = reaching(make, use_relative_mode=False)
  assert term.action_dim == 7
  action = torch.tensor([[0.2, 0.1, 0.3, 2.0, 0.0, 0.0, 0.0]]).repeat(4, 1)
  action[1, 3:] = torch.tensor([0.0, 0.0, 0.0, -5.0])
  action[2, 3:] = 0.0
  term.process_actions(action)
  data = env.scene["robot"].data
  quat = data.root_link_quat_w.numpy()
  where = np.zeros(3)
  mujoco.mju_rotVecQuat(where, np.array([0.2, 0.1, 0.3]), quat[0])
  np.testing.assert_allclose(term.goal_pos_w[0].numpy(), where + data.root_link_pos_w[0].numpy(), atol=1e-7)
  np.testing.assert_allclose(term.goal_quat_w[0].numpy(), quat[0], atol=1e-9)
  half_turn = np.zeros(4)
  mujoco.mju_mulQuat(half_turn, quat[1], np.array([0.0, 0.0, 0.0, -1.0]))
  np.testing.assert_allclose(term.goal_quat_w[1].numpy(), half_turn, atol=1e-9)
  # No orientation was given: the hand keeps its own.
  assert torch.equal(term.goal_quat_w[2], term.frame_pose()[1][2])


def test_without_an_orientation_weight_there_are_three_columns(make: Make) -> None:
  _, term = reaching(make, orientation_weight=0.0)
  assert term.action_dim == 3


def test_a_pose_is_reached_and_held(make: Make) -> None:
  env, term = reaching(make, use_relative_mode=False)
  # A pose that the arm can take: the one it has at home.
  env.reset()
  data = env.scene["robot"].data
  action = torch.empty(4, 7)
  for world in range(4):
    mj = in_mujoco(env, world)
    pos, quat, inverse = np.zeros(3), np.zeros(4), (np.zeros(3), np.zeros(4))
    mujoco.mju_negPose(*inverse, data.root_link_pos_w[world].numpy(), data.root_link_quat_w[world].numpy())
    now = term.frame_pose()
    mujoco.mju_mulPose(pos, quat, *inverse, mj.site("robot/tip").xpos, now[1][world].numpy())
    action[world] = torch.from_numpy(np.concatenate([pos, quat]))
  scramble(env, 0.4)
  for _ in range(400):
    env.step(action)
  pos, quat = term.frame_pose()
  assert (pos - term.goal_pos_w).abs().max() < 1e-3
  assert (1.0 - (quat * term.goal_quat_w).sum(-1).abs()).max() < 1e-5


def test_targets_stay_within_the_clip_and_are_solved_before_each_substep(make: Make) -> None:
  env, term = reaching(make, clip={"yaw": (-0.2, 0.2), "elbow": (0.1, 0.5)})
  robot = env.scene["robot"]
  action = 3.0 * torch.randn(4, 6, generator=torch.Generator().manual_seed(5))
  env.action_manager.process_action(action)
  targets = []
  for _ in range(2):
    expected = robot.data.joint_pos[:, :6] + term.solve()
    expected[:, 0].clamp_(-0.2, 0.2)
    expected[:, 2].clamp_(0.1, 0.5)
    env.action_manager.apply_action()
    targets.append(robot.data.joint_pos_target[:, :6].clone())
    assert torch.equal(targets[-1], expected)
    env.scene.write_ctrl()
    env.sim.step()
  assert not torch.equal(*targets)
  assert {0.1, 0.5} & set(targets[0][:, 2].tolist())


def test_the_controller_believes_its_encoders(make: Make) -> None:
  env, term = reaching(make, use_relative_mode=False, max_dq=1e3)
  robot = env.scene["robot"]
  bias = 0.005 * torch.randn(4, 8, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
  worst = []
  for share in (1.0, 0.1):
    robot.data.encoder_bias.copy_(share * bias)
    pos, _ = term.frame_pose()
    believed = [in_mujoco(env, world, share * bias[world, :6].numpy()).site("robot/tip").xpos for world in range(4)]
    worst.append(np.abs(pos.numpy() - believed).max())
  # To first order of the bias, so that a tenth of it leaves a hundredth of the error.
  assert 1e-6 < worst[0] < 1e-3
  assert worst[1] < 0.02 * worst[0]
  env.action_manager.process_action(torch.tensor([[0.3, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]]).repeat(4, 1))
  env.action_manager.apply_action()
  read = robot.data.joint_pos_biased[:, :6] + term.solve()
  assert torch.allclose(robot.data.joint_pos_target[:, :6], read - robot.data.encoder_bias[:, :6], atol=1e-12)


def test_a_step_that_solves_never_waits_for_the_device(make: Make) -> None:
  env, _ = reaching(make, joint_limit_weight=1.0, posture_weight=0.1)
  action = torch.zeros(4, 6)
  env.step(action)
  with Watch() as watch:
    env.step(action)
  assert watch.count > 100
  assert watch.waits == []


@pytest.mark.parametrize(
  ("options", "message"),
  [
    ({"frame_name": "tap"}, "'tap' matches no site. Nearest: tip"),
    ({"frame_type": "body", "frame_name": ".*er"}, r"must match one body, matches \['upper', 'slider', 'finger'\]"),
    ({"frame_type": "bone"}, "frame_type 'bone' does not exist"),
    ({"actuators": ".*"}, "finger, thumb in actuators cannot move site 'tip'"),
    ({"actuators": "knee"}, "'knee' matches no actuated joint"),
    ({"damping": 0.0}, "damping must be at least 1e-06, got 0.0"),
    ({"damping": float("nan")}, "damping must be a number, got nan"),
    ({"max_dq": 0.0}, "max_dq must be positive"),
    ({"max_lead": (0.1, 0.0)}, "max_lead must be positive"),
    ({"relative_to": "target"}, "relative_to 'target' does not exist"),
    ({"posture_weight": -1.0}, "posture_weight must not be negative"),
    ({"posture_target": {".*": 0.0}}, "posture_target is given, but posture_weight is 0"),
    ({"posture_weight": 1.0, "posture_target": {"yaw": 0.0}}, "no pattern gives a value for joint shoulder"),
    ({"clip": {"yaw": (1.0, -1.0)}}, "clip must not fall"),
  ],
  ids=lambda value: "" if isinstance(value, str) else "-".join(value),
)
def test_a_mistake_is_named_at_build(make: Make, options: dict[str, Any], message: str) -> None:
  with pytest.raises(ConfigError, match=message):
    make(arm_cfg(**options))
