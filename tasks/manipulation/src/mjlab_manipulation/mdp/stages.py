"""How far a lift has come: its stages as metrics, and the end of the time there is for a goal.

All stages but `dropped` are 0 or 1, and with `reduce="max"` say whether an episode got there.
"""

from typing import TYPE_CHECKING

import torch
from mjlab_core.masking import fill_
from mjlab_managers import ManagerTermBase, MetricsTermCfg, SceneEntityCfg

from mjlab_manipulation.mdp.rewards import hand_distance, lift_command

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def goal_over(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Whether the time for this goal has passed, (num_envs,) bool; a time-out: nothing went wrong."""
  passed = env.episode_length_buf.double() * env.step_dt
  return passed >= lift_command(env, command).goal_time - 1e-6


def position_error(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """From the object to its goal, (num_envs,) [m]."""
  return lift_command(env, command).distance.float()


def object_height(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Height of the object's centre, (num_envs,) [m]."""
  return lift_command(env, command).object_height.float()


def reached(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg, within: float) -> torch.Tensor:
  """1 where the hand is closer than `within` [m] to the object, (num_envs,)."""
  return (hand_distance(env, command=command, hand=hand) < within).float()


def touched(env: "ManagerBasedRlEnv", *, command: str, sensor: str) -> torch.Tensor:
  """1 where any finger touches the object, (num_envs,)."""
  return _fingers(env, command, sensor).any(1).float()


def grasped(env: "ManagerBasedRlEnv", *, command: str, sensor: str) -> torch.Tensor:
  """1 where all fingers touch the object, (num_envs,)."""
  return _fingers(env, command, sensor).all(1).float()


def lifted(env: "ManagerBasedRlEnv", *, command: str, height: float) -> torch.Tensor:
  """1 where all of the object is higher than `height` [m], (num_envs,)."""
  return (lift_command(env, command).object_clearance > height).float()


def at_goal(env: "ManagerBasedRlEnv", *, command: str, within: float) -> torch.Tensor:
  """1 where the object is closer than `within` [m] to its goal, (num_envs,)."""
  return (lift_command(env, command).distance < within).float()


def finger_force(env: "ManagerBasedRlEnv", *, command: str, sensor: str) -> torch.Tensor:
  """Greatest force of a finger on the object in the last substeps, (num_envs,) [N].

  `sensor` keeps a history, and the objects are its secondaries, in the command's order.
  """
  contact = env.scene[sensor]
  force = torch.linalg.vector_norm(contact.data.force_history, dim=-1).amax(-1)
  force = force.unflatten(1, contact.contact_shape)[..., 0]
  return lift_command(env, command).of_target(force.mT).amax(1).float()


class held(ManagerTermBase):
  """Success: 1 once the object has been within `within` [m] of its goal for `hold` [s] on end, (num_envs,)."""

  def __init__(self, cfg: MetricsTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    for name in ("within", "hold"):
      if not cfg.params[name] > 0.0:
        raise ValueError(f"{name} must be positive, got {cfg.params[name]}")
    self._steps = torch.zeros(env.num_envs, dtype=torch.int64, device=env.device)
    self._done = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
    self._needed = max(1, round(cfg.params["hold"] / env.step_dt))

  def __call__(self, env: "ManagerBasedRlEnv", *, command: str, within: float, hold: float) -> torch.Tensor:
    del hold  # Resolved at build.
    self._steps.add_(1).mul_(lift_command(env, command).distance < within)
    self._done.logical_or_(self._steps >= self._needed)
    return self._done.float()

  def reset(self, mask: torch.Tensor) -> None:
    fill_(self._steps, mask, 0)
    fill_(self._done, mask, False)


class time_to_success(held):
  """Time until `held`, (num_envs,) [s]; without success the time that the episode has lasted. For `reduce="last"`."""

  def __init__(self, cfg: MetricsTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._time = torch.zeros(env.num_envs, device=env.device)

  def __call__(self, env: "ManagerBasedRlEnv", *, command: str, within: float, hold: float) -> torch.Tensor:
    self._time.add_(~self._done, alpha=env.step_dt)
    super().__call__(env, command=command, within=within, hold=hold)
    return self._time.clone()

  def reset(self, mask: torch.Tensor) -> None:
    super().reset(mask)
    fill_(self._time, mask, 0.0)


class dropped(ManagerTermBase):
  """How often the object's lowest point fell below `low` [m] after being above `high` [m], (num_envs,).

  For `reduce="last"`.
  """

  def __init__(self, cfg: MetricsTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    if cfg.params["low"] >= cfg.params["high"]:
      raise ValueError(f"low must be below high, got {cfg.params['low']} and {cfg.params['high']}")
    self._up = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
    self._count = torch.zeros(env.num_envs, device=env.device)

  def __call__(self, env: "ManagerBasedRlEnv", *, command: str, low: float, high: float) -> torch.Tensor:
    height = lift_command(env, command).object_clearance
    fell = self._up & (height < low)
    self._count.add_(fell)
    self._up.logical_and_(~fell).logical_or_(height > high)
    return self._count.clone()

  def reset(self, mask: torch.Tensor) -> None:
    fill_(self._up, mask, False)
    fill_(self._count, mask, 0.0)


def _fingers(env: "ManagerBasedRlEnv", command: str, sensor: str) -> torch.Tensor:
  """Which fingers, the primaries of `sensor`, touch the object, (num_envs, fingers) bool.

  The sensor's secondaries are the objects, in the command's order.
  """
  contact = env.scene[sensor]
  found = contact.data.found.unflatten(1, contact.contact_shape)[..., 0]
  return lift_command(env, command).of_target(found.mT) > 0
