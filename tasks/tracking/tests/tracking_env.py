"""The G1's tracking environment, small and still: no noise, pushes or randomisation, clips of a second or two."""

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
  """A folder of two short clips: 41 frames of marching, 31 of the squat, which is called to be first."""
  march = crop(load_motion(shipped_clips()["march_in_place"]), 2.0, 2.8)
  squat = crop(load_motion(shipped_clips()["squat_and_wave"]), 1.0, 1.6)
  save_motion(squat.changed("", name="a_squat"), folder / "a_squat.npz")
  save_motion(march.changed("", name="b_march"), folder / "b_march.npz")
  return folder


def still(motion: str | Path, num_envs: int = 4) -> ManagerBasedRlEnvCfg:
  cfg = g1_flat_env()
  cfg.scene.num_envs = num_envs
  cfg.seed = 0
  cfg.events = {}
  actor: Any = cfg.observations["actor"]
  actor.corrupt = False
  command(cfg).motion = str(motion)
  command(cfg).pose_range, command(cfg).velocity_range, command(cfg).joint_position_range = {}, {}, (0.0, 0.0)
  return cfg


def command(cfg: ManagerBasedRlEnvCfg) -> MotionCommandCfg:
  term: Any = cfg.commands["motion"]
  return term


def without_failures(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  for name in ("anchor_pos", "anchor_ori", "ee_body_pos"):
    cfg.terminations[name] = None
  return cfg


def make(cfg: ManagerBasedRlEnvCfg) -> tuple[ManagerBasedRlEnv, MotionCommand]:
  env = ManagerBasedRlEnv(cfg, device="cpu")
  env.reset()
  term: Any = env.command_manager.get_term("motion")
  return env, term


def zeros(env: ManagerBasedRlEnv) -> torch.Tensor:
  return torch.zeros(env.num_envs, env.action_manager.total_action_dim)
