"""Observation and reward of both cartpole tasks."""

import math
from typing import TYPE_CHECKING

import torch
from mjlab_envs.mdp.readings import joints, selected
from mjlab_managers import ManagerTermBase, SceneEntityCfg, TermSource, sourced

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_AT_MARGIN = 0.1
_GAUSSIAN = math.sqrt(-2.0 * math.log(_AT_MARGIN))


def _angle_source(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg) -> TermSource:
  reading = joints(env, asset.name, "position")
  angle = selected(asset.joint_pos_ids, torch.zeros(1, len(reading.columns)))
  return TermSource(readings=(reading,), compute=lambda q: torch.cat([torch.cos(angle(q)), torch.sin(angle(q))], -1))


@sourced(_angle_source)
def joint_angle_cos_sin(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg) -> torch.Tensor:
  """Return cosine and sine of the selected joint's angle, (num_envs, 2)."""
  angle = env.scene[asset.name].data.joint_pos[:, asset.joint_pos_ids]
  return torch.cat([torch.cos(angle), torch.sin(angle)], -1)


def gaussian(x: torch.Tensor, margin: float) -> torch.Tensor:
  """Return exp(-x^2 / 2) scaled to be 1 at 0 and 0.1 at `margin`."""
  return torch.exp(-0.5 * (x * (_GAUSSIAN / margin)).square())


def quadratic(x: torch.Tensor, margin: float) -> torch.Tensor:
  """Return max(0, 1 - 0.9 (x / margin)^2): 1 at 0 and 0.1 at `margin`."""
  return (1.0 - (1.0 - _AT_MARGIN) * (x / margin).square()).clamp(min=0.0)


class smooth_balance(ManagerTermBase):
  """Product of pole upright, cart centred, small action and slow pole, each in [0, 1], (num_envs,).

  ((cos + 1)/2) ((1 + G(x; 2))/2) ((4 + Q(a; 1))/5) ((1 + G(w; 5))/2), the smooth reward of the DeepMind control
  suite's cartpole (Tassa et al. 2018, arXiv:1801.00690).
  """

  env: "ManagerBasedRlEnv"

  def __init__(self, env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg) -> None:
    super().__init__(env)
    self._entity = env.scene[asset.name]
    joints = self._entity.joint_names
    self._slider, self._hinge = joints.index("slider"), joints.index("hinge")

  def __call__(self) -> torch.Tensor:
    data = self._entity.data
    upright = (torch.cos(data.joint_pos[:, self._hinge]) + 1.0) / 2.0
    centred = (1.0 + gaussian(data.joint_pos[:, self._slider], 2.0)) / 2.0
    small = (4.0 + quadratic(self.env.action_manager.action[:, 0], 1.0)) / 5.0
    slow = (1.0 + gaussian(data.joint_vel[:, self._hinge], 5.0)) / 2.0
    return upright * centred * small * slow
