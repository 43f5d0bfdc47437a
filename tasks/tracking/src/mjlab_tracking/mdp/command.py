"""Motion command: poses that the robot is to follow, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import torch
from mjlab_core import (
  Ascending,
  DebugDraw,
  Limits,
  MjlabError,
  PositiveCount,
  check_fields,
  check_name,
  quat_apply,
  quat_apply_inverse,
  quat_conjugate,
  quat_from_euler_xyz,
  quat_mul,
  quat_yaw,
  uniform,
  where_,
)
from mjlab_envs.mdp.events import axis_bounds
from mjlab_managers import CommandTerm, CommandTermCfg, Reading, TermSource
from mjlab_motions.ghost import Ghost
from mjlab_motions.kinematics import Kinematics, derived_arrays
from mjlab_motions.library import load_library
from mjlab_motions.motion import Motion
from mjlab_motions.sampling import AdaptiveSamplingCfg, MotionSampler, SamplingMode
from mjlab_scene.quantities import QuantityCache, cached_quantity

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

Range = tuple[float, float]


@dataclass(kw_only=True)
class MotionCommandCfg(CommandTermCfg):
  """Motion command: each world follows a clip, one frame in every step.

  After a reset to frame t the robot is in the pose of frame t, perturbed, and the first target is frame t + 1. The
  termination `motion_end` ends the episode with the clip.
  """

  motion: str
  """Name of a clip that ships, a motion file, or a folder of them."""
  anchor_body: str
  """Body at which the reference is laid over the robot."""
  bodies: tuple[str, ...]
  """Bodies to follow, in the order of all quantities."""
  split: str | None = None
  """Split of a folder whose clips are used; None: all clips."""
  entity: str = "robot"
  sampling: SamplingMode = "adaptive"
  """Distribution of starts: frequent failures, all moments, or first frames, of random clips or of each in turn."""
  adaptive: AdaptiveSamplingCfg = field(default_factory=AdaptiveSamplingCfg)
  preview: tuple[PositiveCount, ...] = ()
  """Further frames whose joints the command shows, in steps ahead of the present target; the last frame is repeated."""
  pose_range: dict[str, Range] = field(default_factory=dict)
  """Perturbation of the root at the start by axis, world frame [m, rad]."""
  velocity_range: dict[str, Range] = field(default_factory=dict)
  """Perturbation of the root's velocity at the start by axis, world frame [m/s, rad/s]."""
  joint_position_range: Annotated[Range, Limits(), Ascending()] = (0.0, 0.0)
  """Perturbation of joint positions at the start [rad]; it moves no joint beyond its soft limits."""
  resampling_time_range: Range | None = None
  debug_vis: bool = True

  def build(self, env: Any) -> "MotionCommand":
    return MotionCommand(self, env)


class MotionCommand(CommandTerm):
  """Motion command of `MotionCommandCfg`.

  Each step fetches one row of the library's table per world. Quantities that also need the robot's state are computed
  on demand from the present state.
  """

  cfg: MotionCommandCfg

  def __init__(self, cfg: MotionCommandCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    check_fields(cfg, "MotionCommandCfg")
    check_fields(cfg.adaptive, "AdaptiveSamplingCfg")
    check_name("anchor_body", cfg.anchor_body, cfg.bodies, "bodies")
    self.robot = env.scene[check_name("entity", cfg.entity, env.scene.entities, "the scene")]
    kinematics = Kinematics(env.sim.mj_model, self.robot.prefix, self.device)
    if kinematics.joint_names != self.robot.joint_names:
      raise MjlabError(f"entity '{cfg.entity}' has joints outside of its floating tree")
    self._ghost = Ghost(kinematics)
    # A start needs the root's state, also if the root is not followed.
    bodies = tuple(dict.fromkeys((*cfg.bodies, kinematics.root_body)))
    self._root = bodies.index(kinematics.root_body)
    self.library = load_library(
      cfg.motion, kinematics, bodies, rate=1.0 / env.step_dt, split=cfg.split, dtype=env.sim.dtype
    )
    """The clips, at the rate of control."""
    n, device = self.num_envs, self.device
    self.sampler = MotionSampler(self.library, cfg.adaptive, cfg.sampling, n)
    self.clip = self.state(dtype=torch.int64)
    """Clip of each world, int64 (num_envs,)."""
    self.frame = self.state(dtype=torch.int64)
    """Frame of its clip that is the target of the present step, int64 (num_envs,)."""
    self._row = self.state_of(self.library.table[:1].repeat(n, 1))
    self._joints = 2 * len(self.library.joint_names)
    self._command = self.state((self._joints * (1 + len(cfg.preview)),))
    self._pose_lo, self._pose_hi = axis_bounds(cfg.pose_range, "pose_range", env)
    self._vel_lo, self._vel_hi = axis_bounds(cfg.velocity_range, "velocity_range", env)
    names = self.robot.body_names
    self.body_ids = torch.tensor([names.index(body) for body in cfg.bodies], dtype=torch.int64, device=device)
    """Columns of the followed bodies among those of the entity, int64 (bodies,)."""
    self.anchor = cfg.bodies.index(cfg.anchor_body)
    """Index of the anchor among the followed bodies."""
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

  def source(self) -> TermSource:
    joints = tuple(self.library.joint_names)
    readings = [
      Reading(name="motion/joint_position", read=lambda: self.joint_pos, unit="rad, m", columns=joints),
      Reading(name="motion/joint_velocity", read=lambda: self.joint_vel, unit="rad/s, m/s", columns=joints),
    ]
    if self.cfg.preview:
      readings.append(Reading(name="motion/preview", read=lambda: self._command[:, self._joints :]))
    return TermSource(readings=tuple(readings), compute=lambda *parts: torch.cat(parts, dim=-1))

  def clip_arrays(self) -> dict[str, np.ndarray]:
    """Return the clip that the first world follows: joints, and the anchor in the world, frame by frame."""
    clip = self._first_clip()
    arrays = {
      "joint_position": clip["joint_pos"],
      "joint_velocity": clip["joint_vel"],
      "anchor_position": clip["body_pos"][:, self.anchor] + self.env.scene.env_origins[:1].cpu(),
      "anchor_orientation": clip["body_quat"][:, self.anchor],
    }
    return {name: value.numpy().astype(np.float64) for name, value in arrays.items()}

  def reference_arrays(self) -> dict[str, np.ndarray]:
    """Return the clip that the first world follows with all bodies, under the keys that BeyondMimic and mjlab read."""
    robot = Kinematics(self.env.sim.mj_model, self.robot.prefix)
    clip = {name: value.double() for name, value in self._first_clip().items()}
    motion = Motion(
      name=self.library.clip_names[int(self.clip[0])],
      rate=self.library.rate,
      root_body=robot.root_body,
      joint_names=robot.joint_names,
      root_pos=clip["body_pos"][:, self._root],
      root_quat=clip["body_quat"][:, self._root],
      joint_pos=clip["joint_pos"],
    )
    return {"joint_pos": motion.joint_pos.numpy().astype(np.float32), **derived_arrays(motion, robot)}

  def _first_clip(self) -> dict[str, torch.Tensor]:
    """Return all quantities of the clip that the first world follows, frame by frame, on the CPU."""
    library, clip = self.library, int(self.clip[0])
    rows = library.table[int(library.offsets[clip]) :][: int(library.lengths[clip])].cpu()
    return {name: library.part(rows, name) for name in library.columns}

  @property
  def num_frames(self) -> torch.Tensor:
    """Length of each world's clip in frames, int64 (num_envs,)."""
    return self.library.lengths[self.clip]

  @property
  def joint_pos(self) -> torch.Tensor:
    """Joint positions of the reference, (num_envs, joints) [rad]."""
    return self._part("joint_pos")

  @property
  def joint_vel(self) -> torch.Tensor:
    """Joint velocities of the reference, (num_envs, joints) [rad/s]."""
    return self._part("joint_vel")

  @property
  def body_pos_w(self) -> torch.Tensor:
    """Positions of the followed bodies in the reference, world frame, (num_envs, bodies, 3) [m]."""
    return self._placed[:, : self._num_bodies]

  @property
  def body_quat_w(self) -> torch.Tensor:
    """Orientations of the same bodies, (num_envs, bodies, 4)."""
    return self._part("body_quat")[:, : self._num_bodies]

  @property
  def body_lin_vel_w(self) -> torch.Tensor:
    """Linear velocities of their origins, world frame, (num_envs, bodies, 3) [m/s]."""
    return self._part("lin_vel")[:, : self._num_bodies]

  @property
  def body_ang_vel_w(self) -> torch.Tensor:
    """Angular velocities of the same bodies, world frame, (num_envs, bodies, 3) [rad/s]."""
    return self._part("ang_vel")[:, : self._num_bodies]

  @property
  def anchor_pos_w(self) -> torch.Tensor:
    """Position of the anchor in the reference, world frame, (num_envs, 3) [m]."""
    return self._placed[:, self.anchor]

  @property
  def anchor_quat_w(self) -> torch.Tensor:
    """Orientation of the anchor, (num_envs, 4)."""
    return self._part("body_quat")[:, self.anchor]

  @cached_quantity
  def _placed(self) -> torch.Tensor:
    """Positions of the followed bodies and the root, world frame, (num_envs, bodies, 3) [m]."""
    return self._part("body_pos") + self.env.scene.env_origins[:, None]

  def _part(self, name: str) -> torch.Tensor:
    return self.library.part(self._row, name)

  def of_bodies(self, values: torch.Tensor, bodies: Sequence[str]) -> torch.Tensor:
    """Return the columns of `bodies` in a quantity of the followed bodies, (N, bodies, ...).

    Raises:
      UnknownNameError: A body is not followed.
    """
    followed = self.cfg.bodies
    columns = [followed.index(check_name("body", body, followed, "followed bodies")) for body in bodies]
    return torch.stack([values[:, column] for column in columns], 1)

  # The robot

  @cached_quantity
  def robot_body_pos_w(self) -> torch.Tensor:
    """Positions of the followed bodies, world frame, (num_envs, bodies, 3) [m]."""
    return self.robot.data.body_link_pos_w.index_select(1, self.body_ids)

  @cached_quantity
  def robot_body_quat_w(self) -> torch.Tensor:
    """Orientations of the same bodies, (num_envs, bodies, 4)."""
    return self.robot.data.body_link_quat_w.index_select(1, self.body_ids)

  @cached_quantity
  def robot_body_lin_vel_w(self) -> torch.Tensor:
    """Linear velocities of their origins, world frame, (num_envs, bodies, 3) [m/s]."""
    return self.robot.data.body_link_lin_vel_w.index_select(1, self.body_ids)

  @cached_quantity
  def robot_body_ang_vel_w(self) -> torch.Tensor:
    """Angular velocities of the same bodies, world frame, (num_envs, bodies, 3) [rad/s]."""
    return self.robot.data.body_link_ang_vel_w.index_select(1, self.body_ids)

  @property
  def robot_anchor_pos_w(self) -> torch.Tensor:
    """Position of the robot's anchor, world frame, (num_envs, 3) [m]."""
    return self.robot_body_pos_w[:, self.anchor]

  @property
  def robot_anchor_quat_w(self) -> torch.Tensor:
    """Orientation of the anchor, (num_envs, 4)."""
    return self.robot_body_quat_w[:, self.anchor]

  # The reference laid over the robot: turned about the vertical and shifted on the ground until the anchors meet

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
    """Orientations of the same bodies, (num_envs, bodies, 4)."""
    return quat_mul(self._turn, self.body_quat_w)

  # Interface of the command manager

  def resample(self, mask: torch.Tensor) -> None:
    clip, start = self.sampler.draw(self.env.rng)
    where_(self.clip, mask, clip)
    where_(self.frame, mask, start)
    self._fetch()
    self._write_state(mask)
    # The first target follows the pose of the start.
    self.frame.add_(mask).clamp_(max=self.num_frames - 1)
    self._fetch()

  def update(self) -> None:
    moved = ~self.env.command_manager.fresh
    self.sampler.count_step(self.clip, self.frame, moved)
    torch.minimum(self.frame + moved, self.num_frames - 1, out=self.frame)
    self._follow_viewer()
    self._fetch()

  @property
  def axes(self) -> list[tuple[str, float, float]]:
    """Value that a viewer can set: the time of the target within the longest clip [s]."""
    return [("time [s]", 0.0, (int(self.library.lengths.max()) - 1) / self.library.rate)]

  def steer(self, world: int, values: Sequence[float] | None) -> None:
    super().steer(world, values)
    # Here too, because a viewer may be paused.
    self._follow_viewer()
    self._fetch()

  def _follow_viewer(self) -> None:
    """Hold the target at the time that a viewer has set, within the world's clip."""
    if self.by_hand is not None:
      held, time = self.by_hand
      where_(self.frame, held, torch.minimum((time[:, 0] * self.library.rate).round().long(), self.num_frames - 1))

  def debug_draw(self, draw: DebugDraw) -> None:
    """Draw the reference as a ghost of the robot."""
    worlds = torch.tensor(draw.worlds, device=self.device)
    quat = self._part("body_quat")[worlds, self._root]
    self._ghost.draw(draw, self._placed[worlds, self._root], quat, self.joint_pos[worlds])

  def reset(self, mask: torch.Tensor) -> None:
    played = mask & (self.env.episode_length_buf > 0)
    self.sampler.count_ends(self.clip, self.frame, played, self.env.termination_manager.terminated)

  def log_values(self) -> dict[str, torch.Tensor]:
    return self.sampler.log()

  def load_progress(self, state: Any) -> None:
    saved = state.get("sampler", {})
    mine = self.sampler.state_dict()
    # Counts of other clips do not apply.
    if all(name in saved and saved[name].shape == value.shape for name, value in mine.items()):
      self.sampler.load_state_dict(saved)

  def _fetch(self) -> None:
    """Fetch the rows of the present frames."""
    library = self.library
    first = library.offsets[self.clip]
    torch.index_select(library.table, 0, first + self.frame, out=self._row)
    self._command[:, : self._joints] = self._row[:, : self._joints]
    for i, ahead in enumerate(self.cfg.preview, start=1):
      at = first + torch.minimum(self.frame + ahead, self.num_frames - 1)
      self._command[:, i * self._joints : (i + 1) * self._joints] = library.table[:, : self._joints][at]
    # The reference changes also without a change of the simulation.
    self.cache = QuantityCache(self.env.sim)

  def _write_state(self, mask: torch.Tensor) -> None:
    """Write the pose of the present frame, perturbed, to the robots of masked worlds."""
    cfg, robot = self.cfg, self.robot
    draw = {"generator": self.env.rng, "device": self.device, "dtype": self.env.sim.dtype}
    offset = uniform(self._pose_lo, self._pose_hi, (self.num_envs, 6), **draw)
    twist = uniform(self._vel_lo, self._vel_hi, (self.num_envs, 6), **draw)
    pos = self._placed[:, self._root] + offset[:, :3]
    quat = quat_mul(quat_from_euler_xyz(*offset[:, 3:].unbind(-1)), self._part("body_quat")[:, self._root])
    linear = self._part("lin_vel")[:, self._root] + twist[:, :3]
    angular = self._part("ang_vel")[:, self._root] + twist[:, 3:]
    robot.write_root_pose(torch.cat((pos, quat), -1), mask)
    # In the link's frame, so that the state just written need not be read.
    local = torch.cat((quat_apply_inverse(quat, linear), quat_apply_inverse(quat, angular)), -1)
    robot.write_root_velocity_b(local, mask)
    # A clip beyond the soft limits starts as it is; perturbations do not leave the limits.
    limits, wanted = robot.data.soft_joint_pos_limits, self.joint_pos
    low, high = torch.minimum(limits[..., 0], wanted), torch.maximum(limits[..., 1], wanted)
    joints = (wanted + uniform(*cfg.joint_position_range, wanted.shape, **draw)).clamp(low, high)
    robot.write_joint_state(joints, self.joint_vel, mask)
