"""Rewards of a lift, its stages as metrics, and the end of a goal's time. `hand` selects one site.

All stages but `dropped` are 0 or 1. With `reduce="max"` they are 1 for an episode that reached the stage.
"""

from typing import TYPE_CHECKING, cast

import torch
from mjlab_managers import ManagerTermBase, SceneEntityCfg

from mjlab_manipulation.mdp.command import LiftCommand

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def lift(
  env: "ManagerBasedRlEnv", *, command: str, reaching_std: float, bringing_std: float, hand: SceneEntityCfg
) -> torch.Tensor:
  """Return r (1 + b), (num_envs,), for reaching the object and bringing it to its goal.

  r = exp(-|hand to object|^2 / reaching_std^2), b = exp(-|object to goal|^2 / bringing_std^2).
  """
  term = lift_command(env, command)
  reaching = torch.exp(-hand_distance(env, command=command, hand=hand).square() / reaching_std**2)
  return reaching * (1.0 + torch.exp(-term.distance.square() / bringing_std**2))


def lift_precise(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """Return exp(-|object to goal|^2 / std^2), (num_envs,)."""
  return torch.exp(-lift_command(env, command).distance.square() / std**2)


def joint_vel_hinge(env: "ManagerBasedRlEnv", *, max_vel: float, asset: SceneEntityCfg) -> torch.Tensor:
  """Return sum_j max(|qd_j| - max_vel, 0)^2 over the selected joints, (num_envs,) [rad^2/s^2]."""
  speed = env.scene[asset.name].data.joint_vel[:, asset.joint_vel_ids].abs()
  return (speed - max_vel).clamp(min=0.0).square().sum(-1)


def hand_distance(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """Return the distance of the hand from the centre of the object, (num_envs,) [m]."""
  return torch.linalg.vector_norm(lift_command(env, command).object_pos_w - hand_pos(env, hand), dim=-1)


def hand_pos(env: "ManagerBasedRlEnv", hand: SceneEntityCfg) -> torch.Tensor:
  """Return the position of the hand, world frame, (num_envs, 3) [m]."""
  return env.scene[hand.name].data.site_pos_w[:, hand.site_ids].squeeze(1)


def lift_command(env: "ManagerBasedRlEnv", name: str) -> LiftCommand:
  """Return the lift command of that name."""
  return cast("LiftCommand", env.command_manager.get_term(name))


def goal_over(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return True where the time for the goal has passed, (num_envs,). Use it as a time-out."""
  passed = env.episode_length_buf.double() * env.step_dt
  return passed >= lift_command(env, command).goal_time - 1e-6


def position_error(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the distance of the object from its goal, (num_envs,) [m]."""
  return lift_command(env, command).distance.float()


def object_height(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the height of the object's centre, (num_envs,) [m]."""
  return lift_command(env, command).object_height.float()


def reached(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg, within: float) -> torch.Tensor:
  """Return 1 where the hand is closer than `within` [m] to the object, (num_envs,)."""
  return (hand_distance(env, command=command, hand=hand) < within).float()


def touched(env: "ManagerBasedRlEnv", *, command: str, sensor: str) -> torch.Tensor:
  """Return 1 where any finger touches the object, (num_envs,)."""
  return _fingers(env, command, sensor).any(1).float()


def grasped(env: "ManagerBasedRlEnv", *, command: str, sensor: str) -> torch.Tensor:
  """Return 1 where all fingers touch the object, (num_envs,)."""
  return _fingers(env, command, sensor).all(1).float()


def lifted(env: "ManagerBasedRlEnv", *, command: str, height: float) -> torch.Tensor:
  """Return 1 where all of the object is higher than `height` [m], (num_envs,)."""
  return (lift_command(env, command).object_clearance > height).float()


def at_goal(env: "ManagerBasedRlEnv", *, command: str, within: float) -> torch.Tensor:
  """Return 1 where the object is closer than `within` [m] to its goal, (num_envs,)."""
  return (lift_command(env, command).distance < within).float()


def finger_force(env: "ManagerBasedRlEnv", *, command: str, sensor: str) -> torch.Tensor:
  """Return the greatest force of a finger on the object in the last substeps, (num_envs,) [N].

  `sensor` keeps a history, and the objects are its secondaries, in the command's order.
  """
  contact = env.scene[sensor]
  force = torch.linalg.vector_norm(contact.data.force_history, dim=-1).amax(-1)
  force = force.unflatten(1, contact.contact_shape)[..., 0]
  return lift_command(env, command).of_target(force.mT).amax(1).float()


class held(ManagerTermBase):
  """Success: 1 once the object has been within `within` [m] of its goal for `hold` [s] on end, (num_envs,)."""

  def __init__(self, env: "ManagerBasedRlEnv", *, command: str, within: float, hold: float) -> None:
    super().__init__(env)
    self._command, self._within = command, within
    self._steps, self._done = self.state(dtype=torch.int64), self.state(dtype=torch.bool)
    self._needed = max(1, round(float(hold) / env.step_dt))

  def __call__(self) -> torch.Tensor:
    self._steps.add_(1).mul_(lift_command(self.env, self._command).distance < self._within)
    self._done.logical_or_(self._steps >= self._needed)
    return self._done.float()


class time_to_success(held):
  """Time until `held`, (num_envs,) [s]; without success the time that the episode has lasted. For `reduce="last"`."""

  def __init__(self, env: "ManagerBasedRlEnv", *, command: str, within: float, hold: float) -> None:
    super().__init__(env, command=command, within=within, hold=hold)
    self._time = self.state()

  def __call__(self) -> torch.Tensor:
    self._time.add_(~self._done, alpha=self.env.step_dt)
    super().__call__()
    return self._time.clone()


class dropped(ManagerTermBase):
  """Number of times that the object's lowest point fell below `low` [m] after being above `high` [m], (num_envs,).

  For `reduce="last"`.
  """

  def __init__(self, env: "ManagerBasedRlEnv", *, command: str, low: float, high: float) -> None:
    super().__init__(env)
    self._command, self._low, self._high = command, low, high
    self._up, self._count = self.state(dtype=torch.bool), self.state()

  def __call__(self) -> torch.Tensor:
    height = lift_command(self.env, self._command).object_clearance
    fell = self._up & (height < self._low)
    self._count.add_(fell)
    self._up.logical_and_(~fell).logical_or_(height > self._high)
    return self._count.clone()


def _fingers(env: "ManagerBasedRlEnv", command: str, sensor: str) -> torch.Tensor:
  """Return True for each finger that touches the object, (num_envs, fingers).

  The primaries of `sensor` are the fingers. The sensor's secondaries are the objects, in the command's order.
  """
  contact = env.scene[sensor]
  found = contact.data.found.unflatten(1, contact.contact_shape)[..., 0]
  return lift_command(env, command).of_target(found.mT) > 0
