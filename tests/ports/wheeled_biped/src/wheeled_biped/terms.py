"""Terms of balancing."""

from typing import TYPE_CHECKING

import torch
from mjlab_managers import ManagerTermBase, SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def tip_upright(env: "ManagerBasedRlEnv", *, std: float) -> torch.Tensor:
  """Return exp(-sin^2(tilt) / std^2) of the base, (num_envs,)."""
  gravity = env.scene["robot"].data.projected_gravity_b
  return torch.exp(-gravity[:, :2].square().sum(-1) / std**2)


def ground_speed(env: "ManagerBasedRlEnv", *, wheels: SceneEntityCfg, radius: float) -> torch.Tensor:
  """Return the squared mean rolling speed of wheels, (num_envs,) [m^2/s^2]."""
  speed = env.scene[wheels.name].data.joint_vel[:, wheels.joint_ids]
  return (radius * speed.mean(-1)).square()


class drift(ManagerTermBase):
  """Horizontal distance from the place where the episode began, (num_envs,) [m]."""

  env: "ManagerBasedRlEnv"

  def __init__(self, env: "ManagerBasedRlEnv") -> None:
    super().__init__(env)
    self.start = self.state((2,))
    self.has_start = self.state(dtype=torch.bool)

  def __call__(self) -> torch.Tensor:
    place = self.env.scene["robot"].data.root_link_pos_w[:, :2].float()
    self.start.copy_(torch.where(self.has_start[:, None], self.start, place))
    self.has_start.fill_(True)
    return torch.linalg.vector_norm(place - self.start, dim=-1)
