"""What a cartpole policy sees."""

from typing import TYPE_CHECKING

import torch
from mjlab_managers import SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def joint_angle_cos_sin(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg) -> torch.Tensor:
  """Cosine and sine of the selected joint's angle, (num_envs, 2)."""
  angle = env.scene[asset.name].data.joint_pos[:, asset.joint_ids]
  return torch.cat([torch.cos(angle), torch.sin(angle)], -1)
