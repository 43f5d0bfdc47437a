"""The two tasks of the G1: their settings, terms against closed forms, and steps without a wait for the device."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_envs import ManagerBasedRlEnv
from mjlab_managers import RewardTermCfg, TerminationTermCfg
from mjlab_rl import RslRlOnPolicyRunnerCfg
from mjlab_sensors import ContactMatch, ContactSensorCfg
from mjlab_tracking import g1_flat, g1_flat_no_state_estimation
from mjlab_tracking.g1 import BODIES, END_EFFECTORS, g1_flat_env
from mjlab_tracking.mdp import QUANTITIES, MotionCommand, bad_anchor_drift, motion_contact, motion_error
from torch.utils._python_dispatch import TorchDispatchMode
from tracking_env import command, make, root_pose, still, zeros

ACTOR = {
  "command": 58,
  "motion_anchor_pos_b": 3,
  "motion_anchor_ori_b": 6,
  "base_lin_vel": 3,
  "base_ang_vel": 3,
  "joint_pos": 29,
  "joint_vel": 29,
  "actions": 29,
}
WEIGHTS = {
  "motion_global_root_pos": (0.5, 0.3),
  "motion_global_root_ori": (0.5, 0.4),
  "motion_body_pos": (1.0, 0.3),
  "motion_body_ori": (1.0, 0.4),
  "motion_body_lin_vel": (1.0, 1.0),
  "motion_body_ang_vel": (1.0, 3.14),
  "action_rate_l2": (-0.1, None),
  "joint_limit": (-10.0, None),
  "self_collisions": (-10.0, None),
}


@pytest.fixture(scope="module")
def played(folder: Path) -> Iterator[tuple[ManagerBasedRlEnv, MotionCommand]]:
  """An environment some way from its reference, away from any reset."""
  env, term = make(still(folder, failures=False, sampling="start"))
  generator = torch.Generator().manual_seed(2)
  for _ in range(8):
    env.step(0.3 * torch.randn(4, 29, generator=generator))
  yield env, term
  env.close()


def test_observations_have_the_terms_and_widths_of_the_reference() -> None:
  with ManagerBasedRlEnv(still_task(g1_flat_env()), device="cpu") as env:
    terms = env.observation_manager.active_terms
    assert terms["actor"] == list(ACTOR)
    assert terms["critic"] == [*list(ACTOR)[:3], "body_pos", "body_ori", *list(ACTOR)[3:]]
    assert widths_of(env) == {"actor": 160, "critic": 286}
    widths = env.observation_manager.group_obs_term_dim["actor"]
    assert [width for (width,) in widths] == list(ACTOR.values())
  blind = g1_flat_no_state_estimation().env
  with ManagerBasedRlEnv(still_task(blind), device="cpu") as env:
    assert widths_of(env) == {"actor": 154, "critic": 286}


def widths_of(env: ManagerBasedRlEnv) -> dict[str, int]:
  return {group: sum(w for (w,) in shapes) for group, shapes in env.observation_manager.group_obs_term_dim.items()}


def still_task(cfg: Any) -> Any:
  cfg.scene.num_envs = 2
  return cfg


def test_numbers_are_those_of_the_reference() -> None:
  task = g1_flat()
  cfg = task.env
  assert {name: (term.weight, term.params.get("std")) for name, term in cfg.rewards.items() if term} == WEIGHTS
  assert (cfg.decimation, cfg.sim.timestep, cfg.episode_length_s) == (4, 0.005, 10.0)
  assert {name: term.params.get("threshold") for name, term in cfg.terminations.items() if term} == {
    "time_out": None,
    "motion_end": None,
    "anchor_pos": 0.25,
    "anchor_ori": 0.8,
    "ee_body_pos": 0.25,
  }
  assert [name for name, term in cfg.terminations.items() if term and term.time_out] == ["time_out", "motion_end"]
  assert len(BODIES) == 14
  assert command(cfg).sampling == "adaptive"
  assert isinstance(task.agent, RslRlOnPolicyRunnerCfg)
  assert task.agent.algorithm.entropy_coef == 0.005
  assert task.agent.save_interval == 500
  # Not just the first contact.
  sensor: Any = cfg.scene.sensors["self_collision"]
  assert sensor.reduce == "maxforce"
  # All substeps of a step, however many there are.
  assert sensor.history_length == "decimation"


def test_solver_events_and_learner_are_those_of_the_reference() -> None:
  task = g1_flat()
  sim, events, twist = task.env.sim, task.env.events, command(task.env).velocity_range
  assert (sim.iterations, sim.ls_iterations, sim.cone, sim.impratio) == (10, 20, "pyramidal", 1.0)
  push: Any = events["push_robot"]
  assert (push.mode, push.interval_range_s, push.params["velocity_range"]) == ("interval", (1.0, 3.0), twist)
  assert set(events) == {"push_robot", "base_com", "encoder_bias", "foot_friction"}
  task.env.scene.num_envs, task.env.seed = 256, 1
  with ManagerBasedRlEnv(task.env, device="cpu") as env:
    model, compiled = env.sim.model, env.sim.mj_model
    names = [compiled.geom(geom).name for geom in range(compiled.ngeom)]
    feet = [geom for geom, name in enumerate(names) if "_foot" in name and name.endswith("_collision")]
    assert len(feet) == 14
    friction = model.geom_friction[:, feet].numpy()
    # All feet of a world alike, sliding only.
    assert np.ptp(friction, axis=1).max() == 0.0
    assert np.ptp(friction[..., 1:], axis=(0, 1)).max() == 0.0
    torso = compiled.body("robot/torso_link").id
    drawn = {
      "friction": (friction[:, 0, 0], 0.3, 1.2),
      "bias": (env.scene["robot"].data.encoder_bias.numpy().ravel(), -0.01, 0.01),
    }
    for axis, reach in enumerate((0.025, 0.05, 0.05)):
      offset = model.body_ipos[:, torso, axis].numpy() - compiled.body_ipos[torso, axis]
      drawn[f"com {axis}"] = (offset, -reach, reach)
    others = [body for body in range(compiled.nbody) if body != torso]
    assert np.ptp(model.body_ipos[:, others].numpy(), axis=0).max() == 0.0
    for name, (values, low, high) in drawn.items():
      assert low <= values.min() < low + 0.05 * (high - low), name
      assert high - 0.05 * (high - low) < values.max() <= high, name
  assert isinstance(task.agent, RslRlOnPolicyRunnerCfg)
  agent, ppo = task.agent, task.agent.algorithm
  assert (agent.num_steps_per_env, agent.max_iterations, agent.experiment_name) == (24, 30_000, "g1_tracking")
  assert (ppo.num_learning_epochs, ppo.num_mini_batches, ppo.learning_rate, ppo.schedule) == (5, 4, 1e-3, "adaptive")
  assert (ppo.clip_param, ppo.use_clipped_value_loss, ppo.value_loss_coef) == (0.2, True, 1.0)
  assert (ppo.gamma, ppo.lam, ppo.desired_kl, ppo.max_grad_norm) == (0.99, 0.95, 0.01, 1.0)
  for network in (agent.actor, agent.critic):
    assert (network.hidden_dims, network.activation, network.obs_normalization) == ((512, 256, 128), "elu", True)


def test_watching_starts_at_the_beginning_unperturbed_and_stops_at_the_end() -> None:
  task: Any = g1_flat()
  cfg = task.play(task.env)
  assert command(cfg).sampling == "start"
  assert command(cfg).pose_range == command(cfg).velocity_range == {}
  assert command(cfg).joint_position_range == (0.0, 0.0)
  assert cfg.episode_length_s == 1e9
  assert cfg.events["push_robot"] is None
  assert cfg.terminations["motion_end"] is not None


def rotation(quat: torch.Tensor) -> np.ndarray:
  matrix = np.empty(9)
  mujoco.mju_quat2Mat(matrix, quat.double().numpy())
  return matrix.reshape(3, 3)


def angle(a: torch.Tensor, b: torch.Tensor) -> float:
  return math.acos(min(1.0, (np.trace(rotation(a).T @ rotation(b)) - 1.0) / 2.0))


def test_errors_are_their_closed_forms(played: tuple[ManagerBasedRlEnv, MotionCommand]) -> None:
  env, term = played
  for world in range(4):
    bodies = range(len(BODIES))
    distance = [(term.body_pos_relative_w - term.robot_body_pos_w)[world, b].norm().item() for b in bodies]
    turned = [angle(term.body_quat_relative_w[world, b], term.robot_body_quat_w[world, b]) for b in bodies]
    speed = [(term.body_lin_vel_w - term.robot_body_lin_vel_w)[world, b].norm().item() for b in bodies]
    spin = [(term.body_ang_vel_w - term.robot_body_ang_vel_w)[world, b].norm().item() for b in bodies]
    away = (term.anchor_pos_w - term.robot_anchor_pos_w)[world].norm().item()
    tilted = angle(term.anchor_quat_w[world], term.robot_anchor_quat_w[world])
    means = {"body_pos": distance, "body_rot": turned, "body_lin_vel": speed, "body_ang_vel": spin}
    torso = BODIES.index("torso_link")
    singles = {"anchor_pos": away, "anchor_rot": tilted, "anchor_lin_vel": speed[torso], "anchor_ang_vel": spin[torso]}
    expected = singles | {name: float(np.mean(values)) for name, values in means.items()}
    for quantity in QUANTITIES[:8]:
      found = motion_error(env, command="motion", quantity=quantity)[world].item()
      assert found == pytest.approx(expected[quantity], rel=1e-5), quantity


def test_terminations_are_true_from_their_thresholds_on(folder: Path) -> None:
  env, term = make(still(folder))
  robot = env.scene["robot"]
  pose = root_pose(env)

  def ended(name: str) -> list[bool]:
    return env.termination_manager.term(name)().tolist()

  for name in ("anchor_pos", "anchor_ori", "ee_body_pos"):
    assert ended(name) == [False] * 4
  risen = pose.clone()
  risen[:, 2] += torch.tensor([0.24, 0.26, -0.24, -0.26])
  robot.write_root_pose(risen)
  assert ended("anchor_pos") == [False, True, False, True]
  # Heights are not laid over one another, so hands and feet are off by as much.
  assert ended("ee_body_pos")[1::2] == [True, True]
  tilted = pose.clone()
  for world, tilt in enumerate((0.0, 1.2, 1.6, math.pi)):
    turn = torch.tensor([math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0], dtype=pose.dtype)
    mujoco.mju_mulQuat(result := np.empty(4), turn.numpy(), pose[world, 3:].numpy())
    tilted[world, 3:] = torch.from_numpy(result)
  robot.write_root_pose(tilted)
  wanted = [
    abs(rotation(term.anchor_quat_w[w])[2, 2] - rotation(term.robot_anchor_quat_w[w])[2, 2]) > 0.8 for w in range(4)
  ]
  assert ended("anchor_ori") == wanted
  assert any(wanted)
  assert not all(wanted)
  away = pose.clone()
  away[:, 0] += torch.tensor([0.0, 0.4, 0.6, 2.0])
  robot.write_root_pose(away)
  assert bad_anchor_drift(env, command="motion", threshold=0.5).tolist() == [False, False, True, True]
  # Neither of the reference's own conditions looks at drift.
  assert ended("ee_body_pos") == ended("anchor_pos") == [False] * 4
  assert set(END_EFFECTORS) <= set(BODIES)


def test_contacts_are_rewarded_where_the_reference_has_them(folder: Path) -> None:
  cfg = still(folder, failures=False, sampling="start")
  feet = ("left_ankle_roll_link", "right_ankle_roll_link")
  cfg.scene.sensors["feet"] = ContactSensorCfg(
    primary=ContactMatch(mode="subtree", pattern=feet, entity="robot", preserve_order=True),
    secondary=ContactMatch(mode="body", pattern="terrain"),
    fields=("found",),
  )
  cfg.rewards["contact"] = RewardTermCfg(
    motion_contact, weight=0.5, params={"command": "motion", "sensor": "feet", "bodies": feet}
  )
  cfg.terminations["drift"] = TerminationTermCfg(bad_anchor_drift, params={"command": "motion", "threshold": 0.5})
  env, term = make(cfg)
  for _ in range(2):
    env.step(zeros(env))
  reward = env.reward_manager.term("contact")
  squat = term.clip == 0
  assert squat.any()
  # In the squat both feet stand, and so do the robot's.
  assert reward()[squat].tolist() == [1.0] * int(squat.sum())
  # The ground of a world may be higher than that of the clip.
  env.scene.env_origins[:, 2] = 0.5
  env.scene["robot"].write_root_pose(root_pose(env) + torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
  env.step(zeros(env))
  assert reward()[squat].tolist() == [0.0] * int(squat.sum())


class Waits(TorchDispatchMode):
  """Notes operations that wait for a device."""

  def __init__(self) -> None:
    super().__init__()
    self.found: list[str] = []
    self.count = 0

  def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
    name = func.overloadpacket.__name__
    if name in ("_local_scalar_dense", "nonzero", "item", "is_nonzero", "masked_select", "equal", "unique"):
      self.found.append(name)
    self.count += not func.is_view
    return func(*args, **(kwargs or {}))


def test_a_step_never_waits_for_the_device() -> None:
  cfg = g1_flat_env()
  cfg.scene.num_envs = 3
  command(cfg).preview = (1, 5)
  env, _ = make(cfg)
  for _ in range(3):
    env.step(zeros(env))
  with Waits() as waits:
    env.step(torch.ones(3, 29))
  assert waits.found == []
  assert waits.count < 900


def test_the_operations_of_a_step_do_not_depend_on_the_library(folder: Path) -> None:
  counts = []
  for motion in ("squat_and_wave", folder):
    env, _ = make(still(motion))
    for _ in range(3):
      env.step(zeros(env))
    with Waits() as waits:
      env.step(zeros(env))
    counts.append(waits.count)
  assert counts[0] == counts[1]
