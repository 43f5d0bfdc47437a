"""Stages of a lift as metrics, and the end of a goal's time.

All stages but `dropped` are 0 or 1. With `reduce="max"` they are 1 for an episode that reached the stage.
"""

from typing import TYPE_CHECKING

import torch
from mjlab_core.errors import MjlabError
from mjlab_managers import ManagerTermBase, SceneEntityCfg

from mjlab_manipulation.mdp.rewards import hand_distance, lift_command

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


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
    for name, value in (("within", within), ("hold", hold)):
      if not value > 0.0:
        raise MjlabError(f"{name} must be positive, got {value}")
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
    if low >= high:
      raise MjlabError(f"low must be below high, got {low} and {high}")
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
