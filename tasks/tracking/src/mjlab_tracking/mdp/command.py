"""The motion command: which pose the robot is to be in, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, get_args

import torch
from mjlab_core import DebugDraw
from mjlab_core.masking import where_
from mjlab_core.rotations import (
  quat_apply,
  quat_apply_inverse,
  quat_conjugate,
  quat_from_euler_xyz,
  quat_mul,
  quat_yaw,
)
from mjlab_core.sampling import check_range, uniform
from mjlab_envs.mdp.events import axis_bounds
from mjlab_managers import CommandTerm, CommandTermCfg
from mjlab_scene.quantities import QuantityCache, cached_quantity

from mjlab_tracking.kinematics import Kinematics
from mjlab_tracking.library import load_library
from mjlab_tracking.mdp.ghost import Ghost
from mjlab_tracking.motion import MotionError
from mjlab_tracking.sampling import AdaptiveSamplingCfg, MotionSampler, SamplingMode

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

Range = tuple[float, float]


@dataclass(kw_only=True)
class MotionCommandCfg(CommandTermCfg):
  """Follow clips: each world has a clip and a frame, which advances by one in every step.

  After a reset to frame t the robot is in the pose of frame t, but for the perturbations, and the first target is frame
  t + 1. The clip's end is a matter of the termination `motion_end`.
  """

  motion: str
  """Name of a clip that ships, a motion file, or a folder of them."""
  anchor_body: str
  """Body by which robot and reference are laid over one another."""
  bodies: tuple[str, ...]
  """Bodies to follow, in the order of all quantities."""
  split: str | None = None
  """Of a folder, only clips of this split."""
  entity: str = "robot"
  sampling: SamplingMode = "adaptive"
  """Where episodes start: where the policy fails, anywhere, or at the beginning of clips, drawn or each in turn."""
  adaptive: AdaptiveSamplingCfg = field(default_factory=AdaptiveSamplingCfg)
  preview: tuple[int, ...] = ()
  """Further frames whose joints the command shows, in steps ahead of the present target; the last frame is repeated."""
  pose_range: dict[str, Range] = field(default_factory=dict)
  """Perturbation of the root at the start by axis, world frame [m, rad]."""
  velocity_range: dict[str, Range] = field(default_factory=dict)
  """Perturbation of the root's velocity at the start by axis, world frame [m/s, rad/s]."""
  joint_position_range: Range = (0.0, 0.0)
  """Perturbation of joint positions at the start [rad]; it leads no joint out of its soft limits."""
  resampling_time_range: Range | None = None
  debug_vis: bool = True

  def build(self, env: Any) -> "MotionCommand":
    return MotionCommand(self, env)


class MotionCommand(CommandTerm):
  """See `MotionCommandCfg`.

  What the reference is lies in one row of a table per world, fetched once a step. Quantities that need the robot's
  state too are computed when asked for, from the state that is.
  """

  cfg: MotionCommandCfg
  _children = ("sampler",)
  _constants = frozenset({"_pose_lo", "_pose_hi", "_vel_lo", "_vel_hi", "body_ids"})

  def __init__(self, cfg: MotionCommandCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    if problems := cfg.adaptive.problems():
      raise MotionError("; ".join(problems))
    if cfg.sampling not in get_args(SamplingMode):
      raise MotionError(f"sampling must be one of {', '.join(get_args(SamplingMode))}, got {cfg.sampling!r}")
    if cfg.anchor_body not in cfg.bodies:
      raise MotionError(f"anchor_body '{cfg.anchor_body}' is not among bodies: {', '.join(cfg.bodies)}")
    if any(step < 1 for step in cfg.preview):
      raise MotionError(f"preview counts steps ahead, from 1 on, got {cfg.preview}")
    check_range("joint_position_range", *cfg.joint_position_range)
    if cfg.entity not in env.scene.entities:
      raise MotionError(f"entity '{cfg.entity}' does not exist; the scene has: {', '.join(env.scene.entities)}")
    self.robot = env.scene[cfg.entity]
    kinematics = Kinematics(env.sim.mj_model, self.robot.prefix, self.device)
    if kinematics.joint_names != self.robot.joint_names:
      raise MotionError(f"entity '{cfg.entity}' has joints outside of its floating tree")
    # The root's state is needed for starting, whether it is followed or not.
    self._root = kinematics.root_body
    self._ghost = Ghost(kinematics)
    extra = () if self._root in cfg.bodies else (self._root,)
    self.library = load_library(
      cfg.motion, kinematics, (*cfg.bodies, *extra), rate=1.0 / env.step_dt, split=cfg.split, dtype=env.sim.dtype
    )
    """The clips, at the rate of control."""
    n, device = self.num_envs, self.device
    self.sampler = MotionSampler(self.library, cfg.adaptive, cfg.sampling, n)
    self.clip = torch.zeros(n, dtype=torch.int64, device=device)
    """Clip of each world, int64 (num_envs,)."""
    self.frame = torch.zeros(n, dtype=torch.int64, device=device)
    """Frame of its clip that is the target of the present step, int64 (num_envs,)."""
    self._row = self.library.table[:1].repeat(n, 1)
    self._joints = 2 * len(self.library.joint_names)
    self._command = torch.zeros(n, self._joints * (1 + len(cfg.preview)), device=device)
    self._pose_lo, self._pose_hi = axis_bounds(cfg.pose_range, "pose_range", env)
    self._vel_lo, self._vel_hi = axis_bounds(cfg.velocity_range, "velocity_range", env)
    names = self.robot.body_names
    self.body_ids = torch.tensor([names.index(body) for body in cfg.bodies], dtype=torch.int64, device=device)
    """Columns of the followed bodies among those of the entity, int64 (bodies,)."""
    self.anchor = cfg.bodies.index(cfg.anchor_body)
    """Number of the anchor among the followed bodies."""
    self._num_bodies = len(cfg.bodies)
    self.cache = QuantityCache(env.sim)
    self._fetch()

  # The reference

  @property
  def command(self) -> torch.Tensor:
    """Joint positions and velocities of the target, then those of each of k frames of `preview`.

    (num_envs, 2 joints (1 + k)) [rad, rad/s], absolute, in the order of the entity's joints.
    """
    return self._command

  @property
  def num_frames(self) -> torch.Tensor:
    """Length of each world's clip in frames, int64 (num_envs,)."""
    return self.library.lengths[self.clip]

  @property
  def joint_pos(self) -> torch.Tensor:
    """Joint positions of the reference, (num_envs, joints) [rad]."""
    return self._row[:, self.library.columns["joint_pos"]]

  @property
  def joint_vel(self) -> torch.Tensor:
    """Joint velocities of the reference, (num_envs, joints) [rad/s]."""
    return self._row[:, self.library.columns["joint_vel"]]

  @property
  def body_pos_w(self) -> torch.Tensor:
    """Positions of the followed bodies in the reference, world frame, (num_envs, bodies, 3) [m]."""
    return self._placed[:, : self._num_bodies]

  @property
  def body_quat_w(self) -> torch.Tensor:
    """Their orientations, (num_envs, bodies, 4)."""
    return self._of_bodies("body_quat")[:, : self._num_bodies]

  @property
  def body_lin_vel_w(self) -> torch.Tensor:
    """Their linear velocities at their origins, world frame, (num_envs, bodies, 3) [m/s]."""
    return self._of_bodies("lin_vel")[:, : self._num_bodies]

  @property
  def body_ang_vel_w(self) -> torch.Tensor:
    """Their angular velocities, world frame, (num_envs, bodies, 3) [rad/s]."""
    return self._of_bodies("ang_vel")[:, : self._num_bodies]

  @property
  def anchor_pos_w(self) -> torch.Tensor:
    """Position of the anchor in the reference, world frame, (num_envs, 3) [m]."""
    return self._placed[:, self.anchor]

  @property
  def anchor_quat_w(self) -> torch.Tensor:
    """Its orientation, (num_envs, 4)."""
    return self._of_bodies("body_quat")[:, self.anchor]

  @cached_quantity
  def _placed(self) -> torch.Tensor:
    """Positions of all kept bodies where the world is, (num_envs, bodies, 3) [m]."""
    return self._of_bodies("body_pos") + self.env.scene.env_origins[:, None]

  def _of_bodies(self, name: str) -> torch.Tensor:
    return self._row[:, self.library.columns[name]].unflatten(1, (len(self.library.body_names), -1))

  # The robot

  @cached_quantity
  def robot_body_pos_w(self) -> torch.Tensor:
    """Positions of the followed bodies, world frame, (num_envs, bodies, 3) [m]."""
    return self.robot.data.body_link_pos_w.index_select(1, self.body_ids)

  @cached_quantity
  def robot_body_quat_w(self) -> torch.Tensor:
    """Their orientations, (num_envs, bodies, 4)."""
    return self.robot.data.body_link_quat_w.index_select(1, self.body_ids)

  @cached_quantity
  def robot_body_lin_vel_w(self) -> torch.Tensor:
    """Their linear velocities at their origins, world frame, (num_envs, bodies, 3) [m/s]."""
    return self.robot.data.body_link_lin_vel_w.index_select(1, self.body_ids)

  @cached_quantity
  def robot_body_ang_vel_w(self) -> torch.Tensor:
    """Their angular velocities, world frame, (num_envs, bodies, 3) [rad/s]."""
    return self.robot.data.body_link_ang_vel_w.index_select(1, self.body_ids)

  @property
  def robot_anchor_pos_w(self) -> torch.Tensor:
    """Position of the robot's anchor, world frame, (num_envs, 3) [m]."""
    return self.robot_body_pos_w[:, self.anchor]

  @property
  def robot_anchor_quat_w(self) -> torch.Tensor:
    """Its orientation, (num_envs, 4)."""
    return self.robot_body_quat_w[:, self.anchor]

  # The reference laid over the robot: turned about the vertical and shifted on the ground until the anchors meet.

  @cached_quantity
  def _turn(self) -> torch.Tensor:
    return quat_yaw(quat_mul(self.robot_anchor_quat_w, quat_conjugate(self.anchor_quat_w)))[:, None]

  @cached_quantity
  def body_pos_relative_w(self) -> torch.Tensor:
    """Positions of the followed bodies in the reference laid over the robot as it is now, (num_envs, bodies, 3) [m].

    Horizontal position and heading are the robot's, height is the reference's.
    """
    anchor = self.anchor_pos_w
    held = torch.cat((self.robot_anchor_pos_w[:, :2], anchor[:, 2:]), -1)
    return held[:, None] + quat_apply(self._turn, self.body_pos_w - anchor[:, None])

  @cached_quantity
  def body_quat_relative_w(self) -> torch.Tensor:
    """Their orientations, (num_envs, bodies, 4)."""
    return quat_mul(self._turn, self.body_quat_w)

  # What the command manager asks

  def resample(self, mask: torch.Tensor) -> None:
    clip, start = self.sampler.draw(self.env.rng)
    where_(self.clip, mask, clip)
    where_(self.frame, mask, start)
    self._fetch()
    self._write_state(mask)
    # The first target is what comes after the pose that it starts in.
    self.frame.add_(mask).clamp_(max=self.num_frames - 1)
    self._fetch()

  def update(self) -> None:
    moved = ~self.env.command_manager.fresh
    self.sampler.count_step(self.clip, self.frame, moved)
    torch.minimum(self.frame + moved, self.num_frames - 1, out=self.frame)
    self._follow_hand()
    self._fetch()

  @property
  def axes(self) -> list[tuple[str, float, float]]:
    """What can be given by hand: the time of the target within the longest clip [s]."""
    return [("time [s]", 0.0, (int(self.library.lengths.max()) - 1) / self.library.rate)]

  def steer(self, world: int, values: Sequence[float] | None) -> None:
    super().steer(world, values)
    # At once, so that the reference follows the hand while nothing is stepped.
    self._follow_hand()
    self._fetch()

  def _follow_hand(self) -> None:
    """Holds the target where it is given by hand, within the world's clip."""
    if self.by_hand is not None:
      held, time = self.by_hand
      where_(self.frame, held, torch.minimum((time[:, 0] * self.library.rate).round().long(), self.num_frames - 1))

  def debug_draw(self, draw: DebugDraw) -> None:
    """The reference as a ghost of the robot, where it is in the world."""
    worlds = torch.tensor(draw.worlds, device=self.device)
    root = self.library.body_names.index(self._root)
    self._ghost.draw(
      draw, self._placed[worlds, root], self._of_bodies("body_quat")[worlds, root], self.joint_pos[worlds]
    )

  def reset(self, mask: torch.Tensor) -> None:
    played = mask & (self.env.episode_length_buf > 0)
    self.sampler.count_ends(self.clip, self.frame, played, self.env.termination_manager.terminated)

  def log_values(self) -> dict[str, torch.Tensor]:
    return self.sampler.log()

  def load_progress(self, state: Any) -> None:
    saved = state.get("sampler", {})
    mine = self.sampler.state_dict()
    # Books of other clips say nothing about these.
    if all(name in saved and saved[name].shape == value.shape for name, value in mine.items()):
      self.sampler.load_state_dict(saved)

  def _fetch(self) -> None:
    """Brings the rows of the present frames."""
    library = self.library
    first = library.offsets[self.clip]
    torch.index_select(library.table, 0, first + self.frame, out=self._row)
    self._command[:, : self._joints] = self._row[:, : self._joints]
    for i, ahead in enumerate(self.cfg.preview, start=1):
      at = first + torch.minimum(self.frame + ahead, self.num_frames - 1)
      self._command[:, i * self._joints : (i + 1) * self._joints] = library.table[:, : self._joints][at]
    # The state of the simulation may be the same, the reference is another.
    self.cache = QuantityCache(self.env.sim)

  def _write_state(self, mask: torch.Tensor) -> None:
    """Puts the robots of masked worlds into the pose of the present frame, perturbed."""
    cfg, robot = self.cfg, self.robot
    draw = {"generator": self.env.rng, "device": self.device, "dtype": self.env.sim.dtype}
    offset = uniform(self._pose_lo, self._pose_hi, (self.num_envs, 6), **draw)
    twist = uniform(self._vel_lo, self._vel_hi, (self.num_envs, 6), **draw)
    root = self.library.body_names.index(self._root)
    pos = self._placed[:, root] + offset[:, :3]
    quat = quat_mul(quat_from_euler_xyz(*offset[:, 3:].unbind(-1)), self._of_bodies("body_quat")[:, root])
    velocity = torch.cat((self._of_bodies("lin_vel")[:, root], self._of_bodies("ang_vel")[:, root]), -1) + twist
    robot.write_root_pose(torch.cat((pos, quat), -1), mask)
    # As the simulation has it: linear in the world, angular in the link; so nothing is asked of the state just written.
    linear = quat_apply_inverse(quat, velocity[:, :3])
    angular = quat_apply_inverse(quat, velocity[:, 3:])
    robot.write_root_velocity_b(torch.cat((linear, angular), -1), mask)
    # A clip beyond the soft limits is started where it is, but nobody is perturbed out of them.
    limits, wanted = robot.data.soft_joint_pos_limits, self.joint_pos
    low, high = torch.minimum(limits[..., 0], wanted), torch.maximum(limits[..., 1], wanted)
    joints = (wanted + uniform(*cfg.joint_position_range, wanted.shape, **draw)).clamp(low, high)
    robot.write_joint_state(joints, self.joint_vel, mask)
