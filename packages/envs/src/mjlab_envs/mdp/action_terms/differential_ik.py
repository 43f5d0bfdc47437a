"""Differential inverse kinematics: the policy sets the goal of a frame, damped least squares the joint positions."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import torch
from mjlab_core import (
  Limits,
  MjlabError,
  NonNegative,
  as_index,
  fill_,
  match_names,
  normalize,
  quat_apply,
  quat_box_minus,
  quat_box_plus,
  quat_mul,
  select,
)

from mjlab_envs.mdp.action_terms.driven_targets import DrivenTargets, DrivenTargetsCfg

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv

FrameType = Literal["body", "site", "geom"]

AboveZero = Annotated[float, Limits(gt=0, finite=False)]


class DifferentialIKAction(DrivenTargets):
  """See `DifferentialIKActionCfg`.

  Raises:
    MjlabError: no frame or several match, a driven joint does not move the frame, or a number is out of its range.
  """

  cfg: "DifferentialIKActionCfg"

  def __init__(self, cfg: "DifferentialIKActionCfg", env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._sim = env.sim
    self._frame, self._body = self._find_frame(cfg)
    self._tree = int(env.sim.mj_model.body_rootid[self._body])
    self._dofs = as_index(self._moving_dofs(cfg), env.device)
    self._posture = self._posture_target(cfg)
    self._adds_up = cfg.relative_to == "goal"
    self.goal_pos_w = self.state((3,), dtype=env.sim.dtype)
    """Goal of the frame, world frame, (num_envs, 3) [m]."""
    self.goal_quat_w = self.state((4,), dtype=env.sim.dtype)
    """Goal of the frame's orientation in the world, (num_envs, 4)."""
    self._has_goal = self.state((1,), dtype=torch.bool)

  def _find_frame(self, cfg: "DifferentialIKActionCfg") -> tuple[int, int]:
    """Return the ids of the frame and of its body in the model."""
    ix, model = self._entity.indexing, self._sim.mj_model
    found, names = match_names(cfg.frame_name, ix.names[cfg.frame_type], what=cfg.frame_type, owner=self._owner)
    if len(found) > 1:
      raise MjlabError(f"{self._owner}: frame_name '{cfg.frame_name}' must match one {cfg.frame_type}, matches {names}")
    frame = int(ix.ids[cfg.frame_type][found[0]])
    return frame, frame if cfg.frame_type == "body" else int(getattr(model, f"{cfg.frame_type}_bodyid")[frame])

  def _moving_dofs(self, cfg: "DifferentialIKActionCfg") -> list[int]:
    """Return the degrees of freedom of the driven joints; each joint must move the frame."""
    model, chain = self._sim.mj_model, [self._body]
    while chain[-1]:
      chain.append(int(model.body_parentid[chain[-1]]))
    columns = self._entity.indexing.qvel_of_joint
    dofs = {name: columns[joint][0] for name, joint in zip(self.target_names, self._ids, strict=True)}
    if idle := [name for name, dof in dofs.items() if model.dof_bodyid[dof] not in chain]:
      raise MjlabError(f"{self._owner}: {', '.join(idle)} in actuators cannot move {cfg.frame_type} '{cfg.frame_name}'")
    return list(dofs.values())

  def _posture_target(self, cfg: "DifferentialIKActionCfg") -> torch.Tensor:
    if cfg.posture_target is None:
      return self._entity.data.default_joint_pos[:, self._q].clone()
    if not cfg.posture_weight:
      raise MjlabError("posture_target is given, but posture_weight is 0")
    return self._per_target(cfg.posture_target, "posture_target")

  @property
  def action_dim(self) -> int:
    if not self.cfg.orientation_weight:
      return 3
    return 6 if self.cfg.use_relative_mode else 7

  def process_actions(self, actions: torch.Tensor) -> None:
    cfg, actions = self.cfg, actions.to(self.goal_pos_w.dtype)
    root, (pos, quat) = self._entity.data.root_link_quat_w, self.frame_pose()
    move, turn = quat_apply(root, actions[:, :3]), actions[:, 3:]
    if not cfg.use_relative_mode:
      self.goal_pos_w.copy_(self._entity.data.root_link_pos_w + move)
      if cfg.orientation_weight:
        # Zero, the action before the first step, is not an orientation.
        given = torch.linalg.vector_norm(turn, dim=-1, keepdim=True) > 1e-6
        self.goal_quat_w.copy_(torch.where(given, quat_mul(root, normalize(turn)), quat))
      return
    lead = cfg.delta_pos_scale * move
    if self._adds_up:
      # Chosen, not multiplied: the goal of a world that diverged is NaN.
      ahead = torch.where(self._has_goal, self.goal_pos_w - pos, 0.0)
      lead = _limited(lead + ahead, cfg.max_lead[0])
    self.goal_pos_w.copy_(pos + lead)
    if cfg.orientation_weight:
      lead = cfg.delta_ori_scale * quat_apply(root, turn)
      if self._adds_up:
        goal = quat_box_plus(torch.where(self._has_goal, self.goal_quat_w, quat), lead)
        lead = _limited(quat_box_minus(goal, quat), cfg.max_lead[1])
      self.goal_quat_w.copy_(normalize(quat_box_plus(quat, lead)))
    self._has_goal.fill_(True)

  def reset(self, mask: torch.Tensor) -> None:
    fill_(self._has_goal, mask, False)

  def apply_actions(self) -> None:
    self.set_targets(self.clipped(self.measured_positions() + self.solve()))

  def frame_pose(self) -> tuple[torch.Tensor, torch.Tensor]:
    """Return position (num_envs, 3) [m] and orientation (num_envs, 4) of the frame in the world, by the encoders."""
    return self._believed()[:2]

  def _believed(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the pose of the frame by the encoders, and its Jacobian for the driven joints, (num_envs, 6, joints).

    The Jacobian has linear rows first, along world axes, as `mj_jac`. MuJoCo's motion axes are given about the centre
    of mass of the kinematic tree.
    """
    pos, quat = self._pose()
    axes = select(self._sim.data.cdof, self._dofs)
    spin, slide = axes[..., :3], axes[..., 3:]
    arm = (pos - self._sim.data.subtree_com[:, self._tree]).unsqueeze(1)
    jacobian = torch.cat((slide + torch.linalg.cross(spin, arm.expand_as(spin)), spin), dim=-1).mT
    shift = (jacobian @ self._entity.data.encoder_bias[:, self._q].unsqueeze(-1)).squeeze(-1)
    return pos + shift[:, :3], quat_box_plus(quat, shift[:, 3:]), jacobian

  def _pose(self) -> tuple[torch.Tensor, torch.Tensor]:
    kind, data, frame = self.cfg.frame_type, self._sim.data, self._frame
    quat = data.xquat[:, self._body]
    if kind == "body":
      return data.xpos[:, frame], quat
    in_body = getattr(self._sim.model, f"{kind}_quat")[:, frame]
    return getattr(data, f"{kind}_xpos")[:, frame], quat_mul(quat, in_body)

  def solve(self) -> torch.Tensor:
    """Return dq towards the goal from the present state, (num_envs, joints) [rad, m]."""
    cfg = self.cfg
    pos, quat, jacobian = self._believed()
    rows, errors = [cfg.position_weight * jacobian[:, :3]], [cfg.position_weight * (self.goal_pos_w - pos)]
    if cfg.orientation_weight:
      rows.append(cfg.orientation_weight * jacobian[:, 3:])
      errors.append(cfg.orientation_weight * quat_box_minus(self.goal_quat_w, quat))
    # In double precision the sum of squares and damping stays definite for every damping above 1e-6.
    task, error = torch.cat(rows, dim=1).double(), torch.cat(errors, dim=1).double()
    normal = task.mT @ task
    right = (task.mT @ error.unsqueeze(-1)).squeeze(-1)
    q = self.measured_positions().double()
    diagonal = torch.full_like(right, cfg.damping**2 + cfg.posture_weight**2)
    if cfg.joint_limit_weight:
      limits = self._entity.data.soft_joint_pos_limits[:, self._q].double()
      back = q.clamp(limits[..., 0], limits[..., 1]) - q
      diagonal = diagonal + cfg.joint_limit_weight**2 * (back != 0.0)
      right = right + cfg.joint_limit_weight**2 * back
    if cfg.posture_weight:
      right = right + cfg.posture_weight**2 * (self._posture.double() - q)
    dq = solve_definite(normal + torch.diag_embed(diagonal), right)
    return dq.clamp(-cfg.max_dq, cfg.max_dq).to(self.goal_pos_w.dtype)


@dataclass(kw_only=True)
class DifferentialIKActionCfg(DrivenTargetsCfg):
  """Action that moves a frame of the robot by position targets of the joints that carry it.

  The goal of the frame is fixed once for each environment step. Before every physics substep, dq of

    (wp^2 Jp'Jp + wo^2 Jr'Jr + wl^2 diag(v) + wq^2 I + damping^2 I) dq
      = wp^2 Jp'ep + wo^2 Jr'er + wl^2 v r + wq^2 (p - q)

  is limited to `max_dq` joint by joint, and q + dq becomes the target, within `clip`. Jp and Jr are the frame's
  Jacobians, ep and er the way to the goal, v marks joints outside their soft limits, r is the way back inside, p the
  posture. A controller behind biased encoders computes the same: q is their reading, and the frame is where
  this reading puts it, to first order of the bias.

  Columns: the change of position (3) and the rotation vector of the change of orientation (3), both along the axes of
  the entity's root; or, in absolute mode, position (3) and quaternion (4) in the root's frame. Without an orientation
  weight only the first three.
  """

  frame_name: str
  """Pattern of the frame; it must match exactly one."""
  frame_type: FrameType = "body"
  use_relative_mode: bool = True
  """True: actions are changes; False: actions are poses."""
  relative_to: Literal["pose", "goal"] = "pose"
  """Base of changes: the frame's pose, which lets an arm sink under its weight, or the goal of the previous step."""
  max_lead: tuple[AboveZero, AboveZero] = (0.1, 0.5)
  """Greatest distance of the goal from the frame with relative_to="goal" [m, rad]."""
  delta_pos_scale: float = 1.0
  """Metres per unit of action, relative mode."""
  delta_ori_scale: float = 1.0
  """Radians per unit of action, relative mode."""
  damping: Annotated[float, Limits(ge=1e-6)] = 0.05
  """Damping factor; larger values keep dq small near singular poses and slow the frame down; at least 1e-6."""
  max_dq: AboveZero = 0.5
  """Largest dq of a joint [rad, m]."""
  position_weight: NonNegative = 1.0
  orientation_weight: NonNegative = 1.0
  joint_limit_weight: NonNegative = 0.0
  posture_weight: NonNegative = 0.0
  posture_target: dict[str, float] | None = None
  """Posture by joint pattern [rad, m], for each driven joint; None takes the default pose."""

  action = DifferentialIKAction


def solve_definite(matrix: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
  """Return the solution x of matrix x = right, (n, k), for symmetric positive definite matrices (n, k, k), k small.

  Uses Gauss-Jordan elimination; definite matrices need no pivoting. A column takes a few operations on all
  worlds; torch's solvers launch libraries, and some of them wait for the device.
  """
  table = torch.cat((matrix, right.unsqueeze(-1)), dim=-1)
  for k in range(matrix.shape[-1]):
    row = table[:, k] / table[:, k, k : k + 1]
    factor = table[:, :, k].clone()
    factor[:, k] -= 1.0
    table.baddbmm_(factor.unsqueeze(-1), row.unsqueeze(1), alpha=-1.0)
  return table[..., -1]


def _limited(vector: torch.Tensor, length: float) -> torch.Tensor:
  """Return `vector`, (num_envs, 3), shortened to `length` where it is longer."""
  return vector * (length / torch.linalg.vector_norm(vector, dim=-1, keepdim=True).clamp(min=1e-9)).clamp(max=1.0)
