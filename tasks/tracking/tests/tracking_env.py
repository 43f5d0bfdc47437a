"""A small tracking environment of the G1 without noise, pushes and randomisation, with clips below a second."""

from pathlib import Path
from typing import Any

import torch
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_motions.clips import shipped_clips
from mjlab_motions.editing import crop
from mjlab_motions.motion_file import load_motion, save_motion
from mjlab_tracking.g1 import g1_flat_env
from mjlab_tracking.mdp import MotionCommand, MotionCommandCfg


def clips(folder: Path) -> Path:
  """Fill a folder with two short clips: 31 frames of a squat, then 41 of marching."""
  march = crop(load_motion(shipped_clips()["march_in_place"]), 2.0, 2.8)
  squat = crop(load_motion(shipped_clips()["squat_and_wave"]), 1.0, 1.6)
  save_motion(squat.changed("", name="a_squat"), folder / "a_squat.npz")
  save_motion(march.changed("", name="b_march"), folder / "b_march.npz")
  return folder


def still(motion: str | Path, num_envs: int = 4, *, failures: bool = True, **of_command: Any) -> ManagerBasedRlEnvCfg:
  """Return the environment, with or without terminations of failures, and with changed fields of the command."""
  cfg = g1_flat_env()
  cfg.scene.num_envs = num_envs
  cfg.seed = 0
  cfg.events = {}
  actor: Any = cfg.observations["actor"]
  actor.corrupt = False
  command(cfg).motion = str(motion)
  command(cfg).pose_range, command(cfg).velocity_range, command(cfg).joint_position_range = {}, {}, (0.0, 0.0)
  for name, value in of_command.items():
    setattr(command(cfg), name, value)
  if not failures:
    cfg.terminations |= dict.fromkeys(("anchor_pos", "anchor_ori", "ee_body_pos"))
  return cfg


def command(cfg: ManagerBasedRlEnvCfg) -> MotionCommandCfg:
  term: Any = cfg.commands["motion"]
  return term


def make(cfg: ManagerBasedRlEnvCfg) -> tuple[ManagerBasedRlEnv, MotionCommand]:
  env = ManagerBasedRlEnv(cfg, device="cpu")
  env.reset()
  term: Any = env.command_manager.get_term("motion")
  return env, term


def root_pose(env: ManagerBasedRlEnv) -> torch.Tensor:
  """Return a copy of the root poses, (num_envs, 7)."""
  data = env.scene["robot"].data
  return torch.cat((data.root_link_pos_w, data.root_link_quat_w), -1)


def zeros(env: ManagerBasedRlEnv) -> torch.Tensor:
  return torch.zeros(env.num_envs, env.action_manager.total_action_dim)
