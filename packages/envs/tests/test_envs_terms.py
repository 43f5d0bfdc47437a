"""Each generic term against NumPy, on states that are all different."""

import inspect
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from envs_hopper import HOPPER, Ended, Make, actions, end, hopper_cfg
from mjlab_core.errors import ConfigError
from mjlab_dr import body_com_offset, geom_friction, randomize_field
from mjlab_envs import ManagerBasedRlEnv, mdp
from mjlab_managers import (
  EventTermCfg,
  MetricsTermCfg,
  ObservationGroupCfg,
  ObservationTermCfg,
  RewardTermCfg,
  SceneEntityCfg,
  TerminationTermCfg,
  UniformNoiseCfg,
)
from mjlab_sensors import (
  CameraSensorCfg,
  ContactMatch,
  ContactSensorCfg,
  FrameMatch,
  GridPatternCfg,
  ImuSensorCfg,
  ObjRef,
  RayCastSensorCfg,
)
from scipy.spatial.transform import Rotation

KNEE = SceneEntityCfg("robot", joint_names=("knee",))
HIP = SceneEntityCfg("robot", joint_names=("hip",), actuator_names=("hip",))


@pytest.fixture
def env(make: Make) -> Any:
  """Worlds that have tumbled for a while."""
  env = make(terminations={"ended": TerminationTermCfg(Ended)})
  rng = np.random.default_rng(3)
  turned = Rotation.from_rotvec(rng.normal(0.0, 1.0, (4, 3))).as_quat()[:, [3, 0, 1, 2]]
  env.sim.data.qpos[:, 2] += 1.0
  env.sim.data.qpos[:, 3:7] = torch.tensor(turned)
  env.sim.data.qpos[:, 7:] = torch.tensor(rng.uniform(-1.4, 0.9, (4, 2)))
  env.sim.data.qvel.copy_(torch.tensor(rng.normal(0.0, 1.0, (4, 8))))
  for step in range(3):
    env.step(actions(env, step))
  return env


def numbers(env: ManagerBasedRlEnv, name: str) -> np.ndarray:
  return getattr(env.sim.data, name).double().numpy()


def rotation(env: ManagerBasedRlEnv) -> Rotation:
  return Rotation.from_quat(numbers(env, "qpos")[:, [4, 5, 6, 3]])


def observed(env: ManagerBasedRlEnv, func: Callable, **params: Any) -> np.ndarray:
  """What a term returns, its parameters resolved as a manager does."""
  params = {
    key: value.resolve(env.scene, env.device) if isinstance(value, SceneEntityCfg) else value
    for key, value in params.items()
  }
  params.setdefault("asset", SceneEntityCfg("robot").resolve(env.scene, env.device))
  possible = inspect.signature(func).parameters
  return func(env, **{key: value for key, value in params.items() if key in possible}).double().numpy()


def test_velocities_and_gravity_are_in_the_root_frame(env: Any) -> None:
  r, qvel = rotation(env), numbers(env, "qvel")
  np.testing.assert_allclose(observed(env, mdp.base_lin_vel), r.inv().apply(qvel[:, :3]), atol=1e-6)
  np.testing.assert_allclose(observed(env, mdp.base_ang_vel), qvel[:, 3:6], atol=1e-6)
  gravity = r.inv().apply([0.0, 0.0, -1.0])
  np.testing.assert_allclose(observed(env, mdp.projected_gravity), gravity, atol=1e-6)
  np.testing.assert_allclose(observed(env, mdp.flat_orientation_l2), (gravity[:, :2] ** 2).sum(1), atol=1e-6)


def test_a_height_scan_is_the_height_of_its_frame_and_says_what_it_misses(make: Make) -> None:
  cfg = hopper_cfg()
  # The outer rays of each frame pass by the robot.
  cfg.scene.sensors["scan"] = RayCastSensorCfg(
    frames=FrameMatch(type="body", pattern=("shank", "trunk"), entity="robot", preserve_order=True),
    pattern=GridPatternCfg(size=(2.0, 0.0), resolution=1.0),
    alignment="yaw",
    max_distance=3.0,
    start_height=1.0,
    geom_groups=(0,),
  )
  # The ground is higher than the world's origin.
  box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [50.0, 50.0, 0.05], "pos": [0.0, 0.0, 0.05]}
  cfg.scene.spec_fn = lambda spec: spec.worldbody.add_geom(**box)
  cfg.observations["critic"].terms["scan"] = ObservationTermCfg(mdp.height_scan, params={"sensor": "scan"})
  env = make(cfg)
  assert env.reset()[0]["critic"].shape == (4, 9 + 6)
  env.sim.data.qpos[3, 2] += 10.0
  height = numbers(env, "xpos")[:, [env.sim.mj_model.body(f"robot/{name}").id for name in ("shank", "trunk")], 2]
  expected = np.repeat(height - 0.1, 2, axis=1)
  expected[3] = 3.0
  outer = [0, 2, 3, 5]
  np.testing.assert_allclose(observed(env, mdp.height_scan, sensor="scan")[:, outer], expected, atol=1e-6)
  expected = np.concatenate((expected[:3] - 0.2, np.full((1, 4), -1.0)))
  scan = observed(env, mdp.height_scan, sensor="scan", offset=0.2, miss_value=-1.0)
  np.testing.assert_allclose(scan[:, outer], expected, atol=1e-6)


def test_a_contact_sensor_keeps_the_forces_of_all_substeps_of_a_step(make: Make) -> None:
  for decimation in (2, 3):
    cfg = hopper_cfg()
    cfg.decimation = decimation
    cfg.scene.sensors["touch"] = ContactSensorCfg(
      primary=ContactMatch(mode="subtree", pattern="trunk", entity="robot"), history_length="decimation"
    )
    assert make(cfg).scene["touch"].data.force_history.shape == (4, 1, decimation, 3)


def camera_cfg(update_period: int = 0, **terms: Any) -> Any:
  """The hopper with a camera that looks at it from its right, and what is observed of that."""
  cfg = hopper_cfg()
  cfg.scene.sensors["side"] = CameraSensorCfg(
    body="robot/trunk",
    pos=(0.0, -1.0, -0.1),
    quat=(0.7071, 0.7071, 0.0, 0.0),
    width=12,
    height=8,
    data_types=("rgb", "depth"),
    update_period=update_period,
  )
  cfg.observations["camera"] = ObservationGroupCfg(
    terms={
      name: ObservationTermCfg(func, params={"sensor": "side", **params}) for name, (func, params) in terms.items()
    },
    concatenate_terms=False,
  )
  return cfg


@pytest.mark.warp
def test_images_are_numbers_that_a_policy_can_use(make: Make) -> None:
  env = make(
    camera_cfg(
      color=(mdp.camera_rgb, {}),
      depth=(mdp.camera_depth, {"max_depth": 4.0}),
      marked=(mdp.camera_depth, {"max_depth": 4.0, "miss_value": 9.0}),
    )
  )
  images = env.reset()[0]["camera"]
  seen = env.scene["side"].data
  assert {name: tuple(image.shape[1:]) for name, image in images.items()} == {
    "color": (3, 8, 12),
    **dict.fromkeys(("depth", "marked"), (1, 8, 12)),
  }
  assert all(image.dtype == torch.float32 for image in images.values())
  torch.testing.assert_close(images["color"] * 255.0, seen.rgb.float())
  missed = seen.depth < 0.0
  assert missed.any()
  assert (seen.depth > 4.0).any()
  torch.testing.assert_close(images["depth"], torch.where(missed, 4.0, seen.depth.clamp(max=4.0)))
  assert (images["marked"][missed] == 9.0).all()
  assert torch.equal(images["marked"][~missed], images["depth"][~missed])


@pytest.mark.warp
def test_an_image_can_be_late_and_noisy_and_is_new_in_a_new_episode(make: Make) -> None:
  cfg = camera_cfg(depth=(mdp.camera_depth, {"max_depth": 4.0}), late=(mdp.camera_depth, {"max_depth": 4.0}))
  terms = cfg.observations["camera"].terms
  terms["late"].delay_min_lag = terms["late"].delay_max_lag = 2
  terms["noisy"] = ObservationTermCfg(
    mdp.camera_rgb, params={"sensor": "side"}, noise=UniformNoiseCfg(n_min=-0.1, n_max=0.1)
  )
  cfg.observations["camera"].corrupt = True
  cfg.terminations["ended"] = TerminationTermCfg(Ended)
  env = make(cfg)
  images = [env.reset()[0]["camera"]]
  for step in range(5):
    end(env, *([1] if step == 3 else []))
    images.append(env.step(actions(env, step))[0]["camera"])
  now, before = images[3]["depth"], images[1]["depth"]
  assert not torch.equal(now, before)
  assert torch.equal(images[3]["late"], before)
  assert torch.equal(images[4]["late"][1], images[4]["depth"][1])
  assert torch.equal(images[4]["late"][0], images[2]["depth"][0])
  error = images[5]["noisy"] - env.scene["side"].data.rgb_float
  assert 0.05 < error.abs().max() <= 0.1 + 1e-6
  assert error.unique().numel() > 500


@pytest.mark.warp
def test_a_camera_with_a_separate_rate_starts_again_with_the_episode(make: Make) -> None:
  cfg = camera_cfg(update_period=12, depth=(mdp.camera_depth, {"max_depth": 4.0}))
  cfg.terminations = {"ended": TerminationTermCfg(Ended)}
  env = make(cfg)
  period = 12 // env.cfg.decimation
  held, new = env.get_observations()["camera"]["depth"], []
  for step in range(2 * period + 1):
    end(env, *([1] if step == period else []))
    seen = env.step(actions(env, step))[0]["camera"]["depth"]
    new.append([not torch.equal(seen[world], held[world]) for world in (0, 1)])
    held = seen
  on, off = period - 1, [False, False]
  expected = [off] * on + [[True, True], [False, True]] + [off] * (on - 1) + [[True, False], [False, True]]
  assert new == expected


@pytest.mark.warp
def test_an_image_that_is_not_drawn_is_refused_by_name(make: Make) -> None:
  cfg = camera_cfg(color=(mdp.camera_rgb, {}))
  cfg.scene.sensors["side"].data_types = ("depth",)
  with pytest.raises(ConfigError, match="camera 'side' draws depth only; add 'rgb' to its data_types"):
    make(cfg)


def test_pictures_show_the_sensors_that_are_to_be_drawn(make: Make) -> None:
  cfg = hopper_cfg()
  for name in ("shown", "hidden"):
    cfg.scene.sensors[name] = RayCastSensorCfg(
      frames=FrameMatch(type="body", pattern="trunk", entity="robot"), debug_vis=name == "shown"
    )
  env = make(cfg)
  assert {"sensor shown", "sensor hidden", "sensor robot/gyro"} <= set(env.drawers())
  assert [name for name in env.default_drawers() if name.startswith("sensor")] == ["sensor shown"]


def calibrate(env: Any, mask: torch.Tensor, *, sensor: str, most: float) -> None:
  """An event that gives the gyro of masked worlds another bias."""
  bias = torch.empty(env.num_envs, 3, device=env.device).uniform_(-most, most, generator=env.rng)
  env.scene[sensor].set_bias(mask, gyro=bias)


def test_the_bias_of_an_imu_is_randomised_by_events_and_kept_with_the_state(make: Make) -> None:
  def imu() -> Any:
    cfg = hopper_cfg()
    cfg.scene.sensors["imu"] = ImuSensorCfg(
      site=ObjRef(type="site", name="imu", entity="robot"), accelerometer_bias=0.3, gyro_walk=0.1
    )
    cfg.events["calibrate"] = EventTermCfg(calibrate, mode="reset", params={"sensor": "imu", "most": 0.5})
    return make(cfg)

  env, twin = imu(), imu()
  env.reset()
  bias = env.scene["imu"].gyro_bias.clone()
  assert (bias.abs() <= 0.5).all()
  assert bias.unique().numel() == bias.numel()
  env.reset(env_ids=[1])
  moved = (env.scene["imu"].gyro_bias != bias).any(1)
  assert moved.tolist() == [False, True, False, False]
  # Both draw alike from where the state was kept.
  twin.load_state_dict(env.state_dict())
  for environment in (env, twin):
    environment.step(torch.zeros(4, environment.action_manager.total_action_dim))
  for field, value in vars(env.scene["imu"].data).items():
    torch.testing.assert_close(getattr(twin.scene["imu"].data, field), value)


def test_joints_are_relative_to_the_default_pose(env: Any) -> None:
  q, v = numbers(env, "qpos")[:, 7:], numbers(env, "qvel")[:, 6:]
  np.testing.assert_allclose(observed(env, mdp.joint_pos_rel), q - [0.2, -0.4], atol=1e-6)
  np.testing.assert_allclose(observed(env, mdp.joint_pos_rel, asset=KNEE), q[:, 1:] + 0.4, atol=1e-6)
  np.testing.assert_allclose(observed(env, mdp.joint_vel_rel, asset=HIP), v[:, :1], atol=1e-6)
  env.scene["robot"].data.encoder_bias[:, 1] = torch.tensor([0.1, 0.2, 0.3, 0.4])
  np.testing.assert_allclose(
    observed(env, mdp.joint_pos_rel, biased=True), q - [0.2, -0.4] + np.outer([0.1, 0.2, 0.3, 0.4], [0, 1]), atol=1e-6
  )
  np.testing.assert_allclose(observed(env, mdp.joint_pos_rel), q - [0.2, -0.4], atol=1e-6)


def test_last_action_command_and_sensor_are_what_they_say(env: Any) -> None:
  assert torch.equal(mdp.last_action(env), actions(env, 2))
  assert torch.equal(mdp.last_action(env, term="legs"), actions(env, 2))
  assert torch.equal(mdp.generated_commands(env, command="speed"), env.command_manager.get_command("speed"))
  np.testing.assert_allclose(observed(env, mdp.builtin_sensor, sensor="robot/gyro"), numbers(env, "qvel")[:, 3:6])


def test_joint_penalties_are_sums_of_squares(env: Any) -> None:
  v, a, f = numbers(env, "qvel")[:, 6:], numbers(env, "qacc")[:, 6:], numbers(env, "actuator_force")
  np.testing.assert_allclose(observed(env, mdp.joint_vel_l2), (v**2).sum(1), rtol=1e-6)
  np.testing.assert_allclose(observed(env, mdp.joint_vel_l2, asset=KNEE), v[:, 1] ** 2, rtol=1e-6)
  np.testing.assert_allclose(observed(env, mdp.joint_acc_l2), (a**2).sum(1), rtol=1e-6)
  np.testing.assert_allclose(observed(env, mdp.joint_torques_l2), (f**2).sum(1), rtol=1e-6)
  np.testing.assert_allclose(observed(env, mdp.joint_torques_l2, asset=HIP), f[:, 0] ** 2, rtol=1e-6)
  assert (a != 0).all()


def test_joints_beyond_their_soft_limits_are_penalised_by_the_distance(env: Any) -> None:
  q = torch.tensor([[0.95, 0.0], [-1.0, 0.5], [0.0, -1.45], [0.5, 0.0]], dtype=torch.float64)
  env.sim.data.qpos[:, 7:] = q
  # Ranges (-1, 1) and (-1.5, 0.5), narrowed to 90 % about their middles.
  np.testing.assert_allclose(observed(env, mdp.joint_pos_limits), [0.05, 0.2, 0.05, 0.0], atol=1e-9)


def test_speeds_beyond_the_limits_of_the_actuators_are_penalised_by_the_excess(make: Callable[..., Any]) -> None:
  cfg = hopper_cfg()
  articulation = cfg.scene.entities["robot"].articulation
  assert articulation is not None
  articulation.actuators[0].velocity_limit = {"knee": 2.0}
  env = make(cfg)
  assert env.scene["robot"].data.joint_vel_limits.tolist() == [[np.inf, 2.0]]
  env.sim.data.qvel[:, 6:] = torch.tensor([[9.0, 1.0], [0.0, 1.5], [0.0, -3.0], [-9.0, 2.5]], dtype=torch.float64)
  np.testing.assert_allclose(observed(env, mdp.joint_vel_limits), [0.0, 0.0, 1.0, 0.5], atol=1e-9)
  np.testing.assert_allclose(observed(env, mdp.joint_vel_limits, soft_ratio=0.5), [0.0, 0.5, 2.0, 1.5], atol=1e-9)


def test_action_penalties_are_differences_in_time(env: Any) -> None:
  a, b, c = (actions(env, step).double().numpy() for step in (2, 1, 0))
  np.testing.assert_allclose(observed(env, mdp.action_rate_l2), ((a - b) ** 2).sum(1), rtol=1e-5)
  np.testing.assert_allclose(observed(env, mdp.action_acc_l2), ((a - 2 * b + c) ** 2).sum(1), rtol=1e-5)
  np.testing.assert_allclose(observed(env, mdp.mean_action_acc), np.abs(a - 2 * b + c).mean(1), rtol=1e-5)


@pytest.mark.parametrize("std", [0.4, {"hip": 0.3, "kn.*": 0.6}])
def test_posture_is_a_bell_around_the_default_pose(make: Make, std: Any) -> None:
  params = {"std": std, "asset": SceneEntityCfg("robot", joint_names=(".*",))}
  env = make(rewards={"posture": RewardTermCfg(mdp.posture, weight=1.0, params=params)}, scale_rewards_by_dt=False)
  _, reward, *_ = env.step(actions(env, 0))
  widths = np.array([std, std] if isinstance(std, float) else list(std.values()))
  expected = np.exp(-(((numbers(env, "qpos")[:, 7:] - [0.2, -0.4]) / widths) ** 2).mean(1))
  np.testing.assert_allclose(reward.numpy(), expected, rtol=1e-5)


def test_alive_and_terminated_know_failure_from_time(make: Make) -> None:
  rewards = {"alive": RewardTermCfg(mdp.is_alive, weight=1.0), "dead": RewardTermCfg(mdp.is_terminated, weight=-5.0)}
  terminations = {"time_out": TerminationTermCfg(mdp.time_out, time_out=True), "ended": TerminationTermCfg(Ended)}
  env = make(rewards=rewards, terminations=terminations, scale_rewards_by_dt=False)
  for step in range(19):
    env.step(actions(env, step))
  end(env, 1)
  _, reward, terminated, truncated, _ = env.step(actions(env, 19))
  assert reward.tolist() == [1.0, -5.0, 1.0, 1.0]
  assert terminated.tolist() == [False, True, False, False]
  assert truncated.all()


def test_leaning_and_sinking_end_an_episode(env: Any) -> None:
  angle = np.array([0.3, 0.69, 0.71, 2.0])
  axis = np.stack([np.cos([0.1, 1.0, 2.0, 3.0]), np.sin([0.1, 1.0, 2.0, 3.0]), np.zeros(4)], 1)
  quat = Rotation.from_rotvec(angle[:, None] * axis).as_quat()[:, [3, 0, 1, 2]]
  env.sim.data.qpos[:, 3:7] = torch.tensor(quat)
  env.sim.data.qpos[:, 2] = torch.tensor([0.3, 0.5, 0.1, 0.9])
  assert observed(env, mdp.bad_orientation, limit_angle=0.7).tolist() == [0, 0, 1, 1]
  env.scene.env_origins[:, 2] = 0.2
  assert observed(env, mdp.root_height_below_minimum, minimum_height=0.2).tolist() == [1, 0, 1, 0]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["qpos", "qvel", "qacc"])
def test_worlds_that_are_not_finite_are_detected(env: ManagerBasedRlEnv, field: str, value: float) -> None:
  assert not mdp.nan_detection(env).any()
  getattr(env.sim.data, field)[2, 3] = value
  assert mdp.nan_detection(env).tolist() == [False, False, True, False]


# Events


def reset_by(make: Make, num_envs: int, func: Any, **params: Any) -> Any:
  return make(hopper_cfg(num_envs=num_envs, events={"event": EventTermCfg(func, mode="reset", params=params)}))


def test_roots_are_spread_uniformly_about_the_default_state(make: Make) -> None:
  pose = {"x": (-0.5, 0.5), "z": (0.1, 0.2), "yaw": (-3.14, 3.14)}
  env = reset_by(
    make, 400, mdp.reset_root_state_uniform, pose_range=pose, velocity_range={"y": (1.0, 2.0), "roll": (-1.0, 0.0)}
  )
  offset = numbers(env, "qpos")[:, :3] - env.scene.env_origins.numpy() - [0.0, 0.0, 0.62]
  assert (np.abs(offset[:, 0]) <= 0.5).all()
  assert abs(offset[:, 0].mean()) < 0.05
  assert offset[:, 0].std() == pytest.approx(1.0 / np.sqrt(12.0), rel=0.1)
  np.testing.assert_allclose(offset[:, 1], 0.0, atol=1e-12)
  assert 0.1 <= offset[:, 2].min() < offset[:, 2].max() <= 0.2
  roll, pitch, yaw = rotation(env).as_euler("xyz").T
  np.testing.assert_allclose([roll, pitch], 0.0, atol=1e-9)
  assert yaw.std() == pytest.approx(2 * 3.14 / np.sqrt(12.0), rel=0.1)
  velocity = numbers(env, "qvel")[:, :6]
  assert 1.0 <= velocity[:, 1].min() < velocity[:, 1].max() <= 2.0
  spin = rotation(env).apply(velocity[:, 3:])
  assert (spin[:, 0] <= 1e-9).all()
  np.testing.assert_allclose(spin[:, 1:], 0.0, atol=1e-9)
  np.testing.assert_allclose(velocity[:, [0, 2]], 0.0, atol=1e-12)


def test_the_drawn_turn_of_a_root_is_about_its_own_axes(make: Make) -> None:
  params = {"pose_range": {"roll": (0.5, 0.5)}}
  cfg = hopper_cfg(events={"event": EventTermCfg(mdp.reset_root_state_uniform, mode="reset", params=params)})
  cfg.scene.entities["robot"].init_state.rot = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
  turn = Rotation.from_euler("z", 90, degrees=True).inv() * rotation(make(cfg))
  np.testing.assert_allclose(turn.as_rotvec(), [[0.5, 0.0, 0.0]] * 4, atol=1e-9)


def test_joints_are_spread_about_the_default_pose_inside_their_limits(make: Make) -> None:
  params = {"position_range": (-1.0, 1.0), "velocity_range": (-2.0, 2.0)}
  term = EventTermCfg(mdp.reset_joints_by_offset, mode="reset", params=params)
  cfg = hopper_cfg(num_envs=200, events={"event": term})
  cfg.scene.entities["robot"].init_state.joint_vel = {".*": 9.0}
  env = make(cfg)
  q, v = numbers(env, "qpos")[:, 7:], numbers(env, "qvel")[:, 6:]
  assert (q.min(0) >= [-0.8 - 1e-9, -1.4 - 1e-9]).all()
  np.testing.assert_allclose(q.max(0), [0.9, 0.4], atol=1e-9)
  assert v.mean() == pytest.approx(9.0, abs=0.3)
  assert v.std() == pytest.approx(4.0 / np.sqrt(12.0), rel=0.1)


def test_a_push_adds_a_twist_in_the_world_frame_where_the_mask_is(env: Any) -> None:
  ranges = {"x": (1.0, 1.0), "z": (-0.5, -0.5), "pitch": (0.7, 0.7)}
  push = mdp.push_by_setting_velocity(env, velocity_range=ranges)
  before, r = numbers(env, "qvel").copy(), rotation(env)
  push(torch.tensor([True, False, True, False]))
  after = numbers(env, "qvel")
  assert np.array_equal(after[[1, 3]], before[[1, 3]])
  np.testing.assert_allclose((after - before)[[0, 2], :3], [[1.0, 0.0, -0.5]] * 2, atol=1e-12)
  spin = r.apply(after[:, 3:6]) - r.apply(before[:, 3:6])
  np.testing.assert_allclose(spin[[0, 2]], [[0.0, 0.7, 0.0]] * 2, atol=1e-9)
  assert np.array_equal(after[:, 6:], before[:, 6:])


def test_a_push_of_what_does_not_float_is_refused_at_build(make: Make) -> None:
  cfg = hopper_cfg()
  fixed = HOPPER.replace("<freejoint/>", "")
  cfg.scene.entities["robot"].spec_fn = lambda: mujoco.MjSpec.from_string(fixed)
  with pytest.raises(ConfigError, match=r"term 'push'.*entity 'robot': its base does not float"):
    make(cfg)


def randomiser(randomizer: Any, mode: Any = "startup") -> EventTermCfg:
  return EventTermCfg(mdp.randomize, mode=mode, params={"randomizer": randomizer})


def test_randomised_fields_differ_per_world_and_constants_follow_once(make: Make, engine: str, monkeypatch) -> None:
  cfg = hopper_cfg(engine=engine)
  cfg.events["friction"] = randomiser(geom_friction("foot", (0.3, 1.2)), "reset")
  cfg.events["trunk"] = randomiser(body_com_offset("trunk", {"x": (-0.05, 0.05)}), "reset")
  cfg.events["thigh"] = randomiser(body_com_offset("thigh", {"z": (-0.05, 0.05)}), "reset")
  env = make(cfg)
  assert env.sim.is_expanded("geom_friction")
  assert env.sim.is_expanded("body_invweight0")
  calls: list[Any] = []
  recompute = env.sim.recompute_constants
  monkeypatch.setattr(env.sim, "recompute_constants", lambda mask=None: (calls.append(mask), recompute(mask)))
  env.reset()
  assert len(calls) == 1
  names = env.sim.mj_model
  foot, trunk = names.geom("robot/foot").id, names.body("robot/trunk").id
  friction = env.sim.model.geom_friction[:, foot, 0].clone()
  assert friction.unique().numel() == 4
  assert ((friction >= 0.3) & (friction <= 1.2)).all()
  com = env.sim.model.body_ipos[:, trunk, 0].clone()
  assert com.unique().numel() == 4
  env.reset(env_ids=[2])
  assert torch.equal(env.sim.model.geom_friction[[0, 1, 3], foot, 0], friction[[0, 1, 3]])
  assert env.sim.model.geom_friction[2, foot, 0] != friction[2]
  # Always from the compiled value: nothing drifts.
  for _ in range(30):
    env.reset()
  default = env.sim.default_field("body_ipos")[0, trunk, 0]
  assert (env.sim.model.body_ipos[:, trunk, 0] - default).abs().max() <= 0.05 + 1e-6


def test_options_and_elements_of_every_kind_are_found_by_their_local_names(make: Make) -> None:
  cfg = hopper_cfg()
  extra = HOPPER.replace(
    "</mujoco>", '<contact><pair name="heel" geom1="foot" geom2="thigh" friction="1 1 .1 .1 .1"/></contact></mujoco>'
  )
  cfg.scene.entities["robot"].spec_fn = lambda: mujoco.MjSpec.from_string(extra)
  cfg.events["gravity"] = randomiser(randomize_field("opt.gravity", ".*", {"z": (-10.0, -9.0)}))
  cfg.events["heel"] = randomiser(randomize_field("pair_friction", "heel", {"sliding1": (0.3, 0.6)}))
  env = make(cfg)
  assert env.sim.model.opt.gravity[:, 2].unique().numel() == 4
  friction = env.sim.model.pair_friction[:, 0]
  assert ((friction[:, 0] >= 0.3) & (friction[:, 0] <= 0.6)).all()
  assert (friction[:, 1] == 1.0).all()


def test_observation_groups_that_are_not_concatenated_are_dicts(make: Make) -> None:
  terms: dict[str, ObservationTermCfg | None] = {
    "spin": ObservationTermCfg(mdp.base_ang_vel),
    "joints": ObservationTermCfg(mdp.joint_pos_rel),
  }
  env = make(
    observations={"parts": ObservationGroupCfg(terms=terms, concatenate_terms=False)},
    metrics={"jerk": MetricsTermCfg(mdp.mean_action_acc, reduce="max")},
  )
  obs, _ = env.reset()
  parts = obs["parts"]
  assert isinstance(parts, dict)
  assert {name: tuple(value.shape) for name, value in parts.items()} == {"spin": (4, 3), "joints": (4, 2)}
