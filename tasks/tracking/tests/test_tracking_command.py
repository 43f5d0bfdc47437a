"""The motion command: starts, frames, ends of clips, and the reference relative to the robot."""

import copy
import dataclasses
from pathlib import Path

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_core.rotations import quat_apply, quat_from_euler_xyz, quat_mul, quat_yaw
from mjlab_envs import ManagerBasedRlEnv
from mjlab_managers import TerminationTermCfg
from mjlab_motions.clips import shipped_clips
from mjlab_motions.motion_file import load_motion, save_motion
from mjlab_motions.timeline import resample
from mjlab_rl import RslRlVecEnvWrapper
from mjlab_tracking import TrackingEvaluation
from mjlab_tracking.g1 import BODIES, END_EFFECTORS
from mjlab_tracking.mdp import MotionCommand, bad_anchor_height
from tracking_env import clips, command, make, root_pose, still, zeros


def frames(term: MotionCommand, clip: torch.Tensor, frame: torch.Tensor, column: str) -> torch.Tensor:
  library = term.library
  return library.table[library.offsets[clip] + frame][:, library.columns[column]]


def test_an_episode_starts_in_the_pose_of_a_frame_with_the_next_as_target(folder: Path) -> None:
  env, term = make(still(folder, num_envs=16))
  start = term.frame - 1
  assert (start >= 0).all()
  assert start.unique().numel() > 4
  data = env.scene["robot"].data
  torch.testing.assert_close(data.joint_pos, frames(term, term.clip, start, "joint_pos"))
  torch.testing.assert_close(data.joint_vel, frames(term, term.clip, start, "joint_vel"))
  pos = frames(term, term.clip, start, "body_pos").unflatten(1, (-1, 3)) + env.scene.env_origins[:, None]
  torch.testing.assert_close(term.robot_body_pos_w, pos, atol=1e-6, rtol=0)
  for column, found in (("lin_vel", term.robot_body_lin_vel_w), ("ang_vel", term.robot_body_ang_vel_w)):
    expected = frames(term, term.clip, start, column).unflatten(1, (-1, 3))
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)
  torch.testing.assert_close(term.joint_pos, frames(term, term.clip, start + 1, "joint_pos"))
  assert torch.equal(term.command, torch.cat((term.joint_pos, term.joint_vel), 1).float())


def test_only_the_requested_split_of_a_folder_is_followed_and_evaluated(tmp_path: Path) -> None:
  (clips(tmp_path) / "library.json").write_text('{"b_march.npz": {"split": "test"}}')
  cfg = still(tmp_path, split="test")
  _, term = make(cfg)
  assert term.library.clip_names == ("b_march",)
  judge = TrackingEvaluation(end_effectors=END_EFFECTORS, repeats=3)
  assert judge.configure(cfg).scene.num_envs == 3


def test_a_start_exceeds_soft_limits_no_more_than_its_clip(tmp_path: Path) -> None:
  motion = load_motion(shipped_clips()["squat_and_wave"])
  joints = motion.joint_pos.clone()
  beyond, near = (motion.joint_names.index(f"{side}_elbow_joint") for side in ("left", "right"))
  joints[:, beyond], joints[:, near] = 2.0, 1.9  # of 2.0944, softly 1.937
  save_motion(motion.changed("", joint_pos=joints), tmp_path / "bent.npz")
  env, _ = make(still(tmp_path / "bent.npz", num_envs=16, joint_position_range=(-0.1, 0.1)))
  data = env.scene["robot"].data
  for joint, limit in ((beyond, 2.0), (near, float(data.soft_joint_pos_limits[0, near, 1]))):
    bent = data.joint_pos[:, joint]
    assert (bent > 1.8 - 1e-6).all()
    assert bent.max() == pytest.approx(limit, abs=1e-6)
    assert bent.min() < limit - 0.01


def test_the_target_advances_by_one_frame_in_every_step_and_by_none_in_a_manual_reset(folder: Path) -> None:
  env, term = make(still(folder, failures=False, sampling="start"))
  assert term.frame.tolist() == [1] * 4
  for step in range(5):
    env.step(zeros(env))
    assert term.frame.tolist() == [step + 2] * 4
  env.reset(env_ids=[1])
  assert term.frame.tolist() == [6, 1, 6, 6]


def test_the_end_of_a_clip_is_a_truncation_and_only_flagged_robots_are_moved(folder: Path) -> None:
  # Without failures the robot falls, so that a silent restart shows as a leap.
  env, term = make(still(folder, failures=False, sampling="start"))
  lengths = term.num_frames.clone()
  truncations = torch.zeros(4, dtype=torch.int64)
  for step in range(1, 60):
    before = env.scene["robot"].data.joint_pos.clone()
    last = term.frame == term.num_frames - 1
    _, _, terminated, truncated, _ = env.step(zeros(env))
    assert not terminated.any()
    assert torch.equal(truncated, last)
    leapt = (env.scene["robot"].data.joint_pos - before).abs().amax(1) > 0.5
    assert not (leapt & ~truncated).any(), step
    assert torch.equal(env.episode_length_buf == 0, truncated)
    truncations += truncated
    # The targets of an episode from the first frame are all later frames.
    assert all(step == length - 1 for length, ended in zip(lengths, truncated, strict=True) if ended and step < 41)
  assert (truncations >= 1).all()


def test_a_clip_of_another_rate_keeps_its_duration(tmp_path: Path) -> None:
  motion = resample(load_motion(shipped_clips()["squat_and_wave"]), 30.0)
  save_motion(motion, tmp_path / "thirty.npz")
  env, term = make(still(tmp_path / "thirty.npz", failures=False))
  assert term.num_frames[0] == int(motion.duration / env.step_dt + 1e-6) + 1


def test_the_reference_is_laid_over_the_present_robot(folder: Path) -> None:
  env, term = make(still(folder))
  # As if it had run ahead by 6 cm and turned, within a step.
  pose = root_pose(env)
  half = torch.full((4,), 0.5, dtype=pose.dtype)
  turn = quat_from_euler_xyz(0 * half, 0 * half, half)
  moved = torch.cat((pose[:, :3] + torch.tensor([0.06, 0.0, 0.1]), quat_mul(turn, pose[:, 3:])), -1)
  env.scene["robot"].write_root_pose(moved)
  index = BODIES.index("torso_link")
  relative = term.body_pos_relative_w
  torch.testing.assert_close(relative[:, index, :2], term.robot_anchor_pos_w[:, :2], atol=1e-9, rtol=0)
  # Heights are those of the reference.
  torch.testing.assert_close(relative[..., 2], term.body_pos_w[..., 2], atol=1e-9, rtol=0)
  # By the definition, for each body.
  dq = quat_yaw(quat_mul(term.robot_anchor_quat_w, term.anchor_quat_w * torch.tensor([1.0, -1.0, -1.0, -1.0])))
  for body in range(len(BODIES)):
    arm = quat_apply(dq, term.body_pos_w[:, body] - term.anchor_pos_w)
    held = torch.cat((term.robot_anchor_pos_w[:, :2], term.anchor_pos_w[:, 2:]), -1)
    torch.testing.assert_close(relative[:, body], held + arm, atol=1e-9, rtol=0)
    torch.testing.assert_close(term.body_quat_relative_w[:, body], quat_mul(dq, term.body_quat_w[:, body]))
  # The same holds for the state and the frame of the next step.
  env.step(zeros(env))
  gap = term.body_pos_relative_w[:, index, :2] - term.robot_anchor_pos_w[:, :2]
  assert gap.abs().max() < 1e-9


@pytest.mark.parametrize("bodies", [("torso_link", "left_knee_link"), ("left_knee_link", "torso_link", "pelvis")])
def test_the_start_of_the_root_does_not_depend_on_the_followed_bodies(folder: Path, bodies: tuple[str, ...]) -> None:
  cfg = still(folder, bodies=bodies)
  cfg.terminations["ee_body_pos"] = None
  env, term = make(cfg)
  expected, reference = make(still(folder))
  torch.testing.assert_close(env.sim.data.qpos, expected.sim.data.qpos)
  ids = [BODIES.index(body) for body in bodies]
  torch.testing.assert_close(term.body_pos_w, reference.body_pos_w[:, ids])
  assert term.body_quat_w.shape == (4, len(bodies), 4)


def test_a_preview_shows_the_frames_ahead_and_holds_the_last(folder: Path) -> None:
  env, term = make(still(folder, failures=False, preview=(1, 10), sampling="start"))
  assert sum(width for (width,) in env.observation_manager.group_obs_term_dim["actor"]) == 160 + 2 * 58
  for _ in range(28):
    env.step(zeros(env))
  for i, ahead in enumerate((0, 1, 10)):
    at = torch.minimum(term.frame + ahead, term.num_frames - 1)
    shown = term.command[:, 58 * i : 58 * (i + 1)]
    expected = torch.cat((frames(term, term.clip, at, "joint_pos"), frames(term, term.clip, at, "joint_vel")), 1)
    torch.testing.assert_close(shown, expected.float())


def test_failures_and_ends_are_counted(folder: Path) -> None:
  env, term = make(still(folder))
  seen = torch.zeros(2)
  for _ in range(80):
    _, _, terminated, truncated, _ = env.step(5.0 * torch.randn(4, 29, generator=torch.Generator().manual_seed(1)))
    seen += torch.tensor([terminated.sum(), (terminated | truncated).sum()])
    assert (term.sampler.failures >= 0).all()
  books = term.sampler
  # Undo the running means: with so small a memory they are sums, nearly.
  total = (
    books.clip_failures.sum() * env.num_envs / books.cfg.memory,
    books.clip_ends.sum() * env.num_envs / books.cfg.memory,
  )
  assert seen[0] > 0
  assert total[0].item() == pytest.approx(seen[0].item(), rel=0.1)
  assert total[1].item() == pytest.approx(seen[1].item(), rel=0.1)
  assert "Metrics/motion/a_squat/success" in env.drain_log()


def test_a_manual_reset_after_a_failure_counts_it_once(folder: Path) -> None:
  cfg = still(folder)
  cfg.auto_reset = False
  env, term = make(cfg)
  env.scene["robot"].write_root_pose(torch.tensor([[0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0]]))
  _, _, terminated, _, _ = env.step(zeros(env))
  assert terminated.all()
  for _ in range(3):
    env.reset()
  failures = term.sampler.state_dict()["_new"]
  bins, clips_ = term.library.num_bins, term.library.num_clips
  assert failures[bins : 2 * bins].sum() == 4.0
  assert failures[2 * bins : 2 * bins + clips_].sum() == 4.0


def test_sampling_progress_is_loaded_with_another_number_of_worlds(folder: Path) -> None:
  env, term = make(still(folder))
  for _ in range(40):
    env.step(5.0 * torch.randn(4, 29, generator=torch.Generator().manual_seed(1)))
  more, other = make(still(folder, num_envs=6))
  assert not torch.equal(other.sampler.probabilities(), term.sampler.probabilities())
  more.load_progress(env.state_dict())
  assert torch.equal(other.sampler.probabilities(), term.sampler.probabilities())
  # Counts of other clips are not loaded.
  single, alone = make(still(shipped_clips()["march_in_place"]))
  before = alone.sampler.probabilities()
  single.load_progress(env.state_dict())
  assert torch.equal(alone.sampler.probabilities(), before)


def names(state: dict, prefix: str = "") -> set[str]:
  found: set[str] = set()
  for name, value in state.items():
    found |= names(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name}
  return found


def test_saved_names_do_not_depend_on_the_number_of_worlds(folder: Path) -> None:
  saved = [make(still(folder, num_envs=count))[0].state_dict()["commands"] for count in (1, 2, 9, 14)]
  assert len({frozenset(names(state)) for state in saved}) == 1


def test_uniform_starts_of_a_world_do_not_depend_on_other_resets(folder: Path) -> None:
  cfg = still(folder, num_envs=3, sampling="uniform", joint_position_range=(-0.1, 0.1))
  envs = [make(copy.deepcopy(cfg))[0] for _ in range(2)]
  envs[0].reset(env_ids=[0, 1])
  envs[1].reset(env_ids=[1, 2])
  assert torch.equal(envs[0].sim.data.qpos[1], envs[1].sim.data.qpos[1])
  assert not torch.equal(envs[0].sim.data.qpos[0], envs[1].sim.data.qpos[0])


@pytest.mark.parametrize(
  ("change", "message"),
  [
    ({"motion": "squat_and_wawe"}, "motion 'squat_and_wawe' does not exist. Nearest: squat_and_wave"),
    ({"anchor_body": "head"}, "anchor_body 'head' does not exist"),
    ({"bodies": ("torso_link", "left_nee_link")}, "body 'left_nee_link' does not exist. Nearest: left_knee_link"),
    ({"sampling": "adaptve"}, "sampling 'adaptve' does not exist. Nearest: adaptive"),
    ({"preview": (0,)}, "preview must be at least 1, got (0,)"),
    ({"pose_range": {"jaw": (0.0, 1.0)}}, "axis 'jaw' does not exist"),
    ({"joint_position_range": (0.1, -0.1)}, "joint_position_range must not fall"),
    ({"entity": "robbot"}, "entity 'robbot' does not exist. Nearest: robot"),
  ],
)
def test_a_mistake_is_named_at_build(change: dict, message: str) -> None:
  cfg = still("squat_and_wave", num_envs=1)
  cfg.commands["motion"] = dataclasses.replace(command(cfg), **change)
  with pytest.raises(ConfigError) as caught:
    ManagerBasedRlEnv(cfg, device="cpu")
  assert message in str(caught.value)


def test_the_end_of_a_clip_is_a_time_out_for_the_learner_and_a_failure_is_not(folder: Path) -> None:
  cfg = still(folder / "a_squat.npz", failures=False, sampling="start")
  cfg.terminations["fallen"] = TerminationTermCfg(bad_anchor_height, params={"command": "motion", "threshold": 0.5})
  env, term = make(cfg)
  wrapped = RslRlVecEnvWrapper(env)
  while int(term.frame[0]) < int(term.num_frames[0]) - 1:
    _, _, dones, extras = wrapped.step(zeros(env))
    assert not dones.any()
  # All come to the end of their clip; one fails in the same step.
  pose = root_pose(env)
  pose[2, 2] += 1.0
  env.scene["robot"].write_root_pose(pose)
  _, _, dones, extras = wrapped.step(zeros(env))
  assert dones.tolist() == [1, 1, 1, 1]
  assert extras["time_outs"].tolist() == [True, True, False, True]
