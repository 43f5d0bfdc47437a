"""Observations of cartpole tasks."""

from typing import TYPE_CHECKING

import torch
from mjlab_envs.mdp.readings import joint_positions, selected
from mjlab_managers import SceneEntityCfg, TermSource, sourced

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def _angle_source(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg) -> TermSource:
  reading = joint_positions(env, asset.name)
  angle = selected(asset.joint_ids, torch.zeros(1, len(reading.columns)))
  return TermSource(readings=(reading,), compute=lambda q: torch.cat([torch.cos(angle(q)), torch.sin(angle(q))], -1))


@sourced(_angle_source)
def joint_angle_cos_sin(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg) -> torch.Tensor:
  """Return cosine and sine of the selected joint's angle, (num_envs, 2)."""
  angle = env.scene[asset.name].data.joint_pos[:, asset.joint_ids]
  return torch.cat([torch.cos(angle), torch.sin(angle)], -1)
