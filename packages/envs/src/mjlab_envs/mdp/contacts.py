"""Terms about unwanted contacts."""

from typing import TYPE_CHECKING

import torch
from mjlab_core import require

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv


def contact_count(env: "ManagerBasedRlEnv", *, sensor: str, threshold: float | None = 10.0) -> torch.Tensor:
  """Return the number of the last substeps with any contact stronger than `threshold` [N], (num_envs,).

  Without a threshold any contact counts, of the last substep alone, and the sensor needs no history.
  """
  if threshold is None:
    return _touches(env, sensor).float()
  return _strong(env, sensor, threshold).any(1).sum(-1, dtype=torch.float32)


def illegal_contact(env: "ManagerBasedRlEnv", *, sensor: str, threshold: float | None = 10.0) -> torch.Tensor:
  """Return True where any contact in the last substeps was stronger than `threshold` [N], (num_envs,).

  Without a threshold any contact counts, of the last substep alone, and the sensor needs no history.
  """
  if threshold is None:
    return _touches(env, sensor)
  return _strong(env, sensor, threshold).flatten(1).any(-1)


def _touches(env: "ManagerBasedRlEnv", sensor: str) -> torch.Tensor:
  """Return True where there is any contact, (num_envs,)."""
  uncounted = f"contact sensor '{sensor}' does not count contacts; add 'found' to its fields"
  return (require(env.scene[sensor].data.found, torch.Tensor, uncounted) > 0).any(-1)


def _strong(env: "ManagerBasedRlEnv", sensor: str, threshold: float) -> torch.Tensor:
  """Return True for contacts stronger than `threshold` [N], by substep, (num_envs, contacts, substeps).

  Raises:
    ConfigError: the sensor keeps no history of forces.
  """
  without = "has no history; set history_length=1 or more in its config, or threshold=None for any contact"
  history = require(env.scene[sensor].data.force_history, torch.Tensor, f"contact sensor '{sensor}' {without}")
  return history.square().sum(-1) > threshold**2
