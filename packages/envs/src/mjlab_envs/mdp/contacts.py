"""Terms of contacts that should not be."""

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv


def contact_count(env: "ManagerBasedRlEnv", *, sensor: str, threshold: float = 10.0) -> torch.Tensor:
  """Number of the last substeps with any contact stronger than `threshold` [N], (num_envs,)."""
  return _strong(env, sensor, threshold).any(1).sum(-1, dtype=torch.float32)


def illegal_contact(env: "ManagerBasedRlEnv", *, sensor: str, threshold: float = 10.0) -> torch.Tensor:
  """Whether any contact in the last substeps was stronger than `threshold` [N], (num_envs,)."""
  return _strong(env, sensor, threshold).flatten(1).any(-1)


def _strong(env: "ManagerBasedRlEnv", sensor: str, threshold: float) -> torch.Tensor:
  """Which contacts were stronger than `threshold` [N] in which of the last substeps, (num_envs, contacts, substeps)."""
  return env.scene[sensor].data.force_history.square().sum(-1) > threshold**2
