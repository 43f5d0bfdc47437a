"""When a tracking episode ends: the clip is over, or the robot is too far from it."""

from typing import TYPE_CHECKING

import torch
from mjlab_core.rotations import quat_apply_inverse
from mjlab_managers import ManagerTermBase, TerminationTermCfg

from mjlab_tracking.mdp.observations import motion

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def motion_end(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Whether the target of this step was the last frame of the clip, (num_envs,). A time-out, not a failure."""
  term = motion(env, command)
  return term.frame >= term.num_frames - 1


def bad_anchor_height(env: "ManagerBasedRlEnv", *, command: str, threshold: float) -> torch.Tensor:
  """Whether the anchors' heights differ by more than `threshold` [m], (num_envs,)."""
  term = motion(env, command)
  return (term.anchor_pos_w - term.robot_anchor_pos_w)[:, 2].abs() > threshold


def bad_anchor_drift(env: "ManagerBasedRlEnv", *, command: str, threshold: float) -> torch.Tensor:
  """Whether the anchors are further apart than `threshold` [m] on the ground, (num_envs,)."""
  term = motion(env, command)
  return torch.linalg.vector_norm((term.anchor_pos_w - term.robot_anchor_pos_w)[:, :2], dim=-1) > threshold


class bad_anchor_ori(ManagerTermBase):
  """Whether the z components of gravity seen in both anchors differ by more than `threshold`, (num_envs,)."""

  _constants = frozenset({"_down"})

  def __init__(self, cfg: TerminationTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._down = torch.tensor([[0.0, 0.0, -1.0]], device=env.device, dtype=env.sim.dtype)

  def __call__(self, env: "ManagerBasedRlEnv", *, command: str, threshold: float) -> torch.Tensor:
    term = motion(env, command)
    down = self._down.expand(env.num_envs, 3)
    wanted = quat_apply_inverse(term.anchor_quat_w, down)[:, 2]
    return (wanted - quat_apply_inverse(term.robot_anchor_quat_w, down)[:, 2]).abs() > threshold


class bad_body_height(ManagerTermBase):
  """Whether any of `bodies` is off by more than `threshold` [m] in height from the reference, (num_envs,)."""

  _constants = frozenset({"_columns"})

  def __init__(self, cfg: TerminationTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    followed = motion(env, cfg.params["command"]).cfg.bodies
    bodies = cfg.params["bodies"]
    if unknown := [body for body in bodies if body not in followed]:
      raise ValueError(f"bodies: '{unknown[0]}' is not followed; these are: {', '.join(followed)}")
    self._columns = torch.tensor([followed.index(body) for body in bodies], device=env.device)

  def __call__(
    self, env: "ManagerBasedRlEnv", *, command: str, threshold: float, bodies: tuple[str, ...]
  ) -> torch.Tensor:
    del bodies  # Resolved at build.
    term = motion(env, command)
    error = (term.body_pos_relative_w - term.robot_body_pos_w).index_select(1, self._columns)
    return (error[..., 2].abs() > threshold).any(-1)
