"""Velocity command: forward, sideways and turning speed."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import torch
from mjlab_core import (
  Ascending,
  Config,
  DebugDraw,
  Limits,
  check_fields,
  fill_,
  heading,
  quat_apply,
  quat_apply_inverse,
  quat_yaw,
  where_,
  wrap_to_pi,
)
from mjlab_managers import CommandTerm, CommandTermCfg, Reading, TermSource

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

Range = Annotated[tuple[float, float], Limits(), Ascending()]
Share = Annotated[float, Limits(ge=0, le=1)]

# Arrows in viewers
ARROW_HEIGHT = 0.25  # above the root [m]
ARROW_SCALE = 0.4  # [m per m/s]


@dataclass(kw_only=True)
class VelocityRanges(Config):
  """Ranges of commands, in the root's frame."""

  lin_vel_x: Range = (-1.0, 1.0)
  """Forward [m/s]."""
  lin_vel_y: Range = (-1.0, 1.0)
  """To the left [m/s]."""
  ang_vel_z: Range = (-0.5, 0.5)
  """Turning to the left [rad/s]."""
  heading: Range = (-math.pi, math.pi)
  """Heading target of worlds that hold a heading, world frame [rad]."""


@dataclass(kw_only=True)
class UniformVelocityCommandCfg(CommandTermCfg):
  """Velocities drawn uniformly; some worlds stand, some go straight ahead, some hold a heading.

  The three kinds are drawn independently at each draw. A world that goes straight ahead does not hold a heading.
  """

  entity: str = "robot"
  resampling_time_range: Range | None = (3.0, 8.0)
  debug_vis: bool = True
  ranges: VelocityRanges = field(default_factory=VelocityRanges)
  standing_fraction: Share = 0.1
  """Share of draws with a command of zero."""
  heading_fraction: Share = 0.3
  """Share of draws that turn towards a heading target instead of at a drawn rate."""
  forward_fraction: Share = 0.2
  """Share of draws that go straight ahead."""
  min_forward_speed: float = 0.3
  """Least speed of draws that go straight ahead [m/s]."""
  world_fraction: Share = 0.0
  """Share of draws with a velocity along the axes of the world."""
  initial_velocity_fraction: Share = 0.0
  """Share of episodes that begin with the robot at the drawn velocity."""
  heading_stiffness: float = 0.5
  """Turning rate per heading error [1/s]."""

  def build(self, env: Any) -> "UniformVelocityCommand":
    return UniformVelocityCommand(self, env)


class UniformVelocityCommand(CommandTerm):
  """Velocity command of `UniformVelocityCommandCfg`. It reads state only, so its update needs no forward kinematics."""

  cfg: UniformVelocityCommandCfg

  def __init__(self, cfg: UniformVelocityCommandCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    check_fields(cfg, "UniformVelocityCommandCfg")
    check_fields(cfg.ranges, "ranges")
    ranges = [cfg.ranges.lin_vel_x, cfg.ranges.lin_vel_y, cfg.ranges.ang_vel_z, cfg.ranges.heading]
    self._robot = env.scene[cfg.entity]
    n, device = self.num_envs, self.device
    self.ranges = self.state_of(torch.tensor(ranges, device=device), shared=True)
    """Lower and upper bound of forward, sideways and turning speed and heading, (4, 2); curricula write here."""
    self._drawn, self._command = self.state((3,)), self.state((3,))
    self._speed, self._heading_target = self.state(), self.state()
    self._stands, self._holds_heading = self.state(dtype=torch.bool), self.state(dtype=torch.bool)
    if cfg.world_fraction > 0.0:
      self._in_world = self.state(dtype=torch.bool)
    self._steps = self.state()
    self._shares = torch.tensor([[cfg.standing_fraction, cfg.heading_fraction, cfg.forward_fraction]], device=device)
    self.metrics["error_vel_xy"] = torch.zeros(n, device=device)
    self.metrics["error_vel_yaw"] = torch.zeros(n, device=device)

  @property
  def command(self) -> torch.Tensor:
    """Forward, sideways and turning speed in the root's frame, (num_envs, 3) [m/s, m/s, rad/s]."""
    return self._command

  @property
  def speed(self) -> torch.Tensor:
    """|v_xy| + |w_z| of the command, (num_envs,)."""
    return self._speed

  def resample(self, mask: torch.Tensor) -> None:
    lo, hi = self.ranges[:, 0], self.ranges[:, 1]
    u = torch.rand(self.num_envs, 7, generator=self.env.rng, device=self.device)
    drawn = torch.addcmul(lo, u[:, :4], hi - lo)
    stands, holds, forward = (u[:, 4:] < self._shares).unbind(1)
    ahead = torch.zeros_like(drawn[:, :3])
    ahead[:, 0] = drawn[:, 0].abs().clamp(min=self.cfg.min_forward_speed)
    where_(self._drawn, mask, torch.where(forward[:, None], ahead, drawn[:, :3]))
    where_(self._heading_target, mask, drawn[:, 3])
    where_(self._stands, mask, stands)
    where_(self._holds_heading, mask, holds & ~forward)
    if self.cfg.world_fraction > 0.0:
      where_(self._in_world, mask, self._chance(self.cfg.world_fraction))
    if self.cfg.initial_velocity_fraction > 0.0:
      starts = mask & (self.command_counter == 1) & self._chance(self.cfg.initial_velocity_fraction)
      self._follow()
      planar, turning = self._command.split((2, 1), -1)
      at_rest = torch.zeros_like(self._command)
      self._robot.write_root_velocity_b(torch.cat((planar, at_rest, turning), -1), starts)

  def _chance(self, share: float) -> torch.Tensor:
    """Return True in this share of worlds, drawn at random, (num_envs,)."""
    return torch.rand(self.num_envs, generator=self.env.rng, device=self.device) < share

  def update(self) -> None:
    self._follow()
    command = self._command
    if self.by_hand is not None:
      where_(command, *self.by_hand)
    torch.add(torch.linalg.vector_norm(command[:, :2], dim=-1), command[:, 2].abs(), out=self._speed)

  def _follow(self) -> None:
    """Write the drawn values into the command, in the present frame of the root."""
    error = wrap_to_pi(self._heading_target - heading(self._robot.data.root_link_quat_w))
    turn = (self.cfg.heading_stiffness * error).clamp(self.ranges[2, 0], self.ranges[2, 1])
    command = self._command
    command.copy_(self._drawn)
    if self.cfg.world_fraction > 0.0:
      planar = torch.nn.functional.pad(self._drawn[:, :2], (0, 1)).to(self.env.sim.dtype)
      turned = quat_apply_inverse(quat_yaw(self._robot.data.root_link_quat_w), planar)
      where_(command[:, :2], self._in_world, turned[:, :2])
    where_(command[:, 2], self._holds_heading, turn.to(command.dtype))
    fill_(command, self._stands, 0.0)

  def source(self) -> TermSource:
    columns = tuple(name for name, *_ in self.axes)
    frame = self._robot.root_body_name
    reading = Reading(name="command/velocity", read=lambda: self._command, unit="m/s", frame=frame, columns=columns)
    return TermSource(readings=(reading,))

  @property
  def axes(self) -> list[tuple[str, float, float]]:
    """Name, least and greatest value of each component of the command."""
    ranges = self.ranges.tolist()
    names = ("forward [m/s]", "left [m/s]", "turn left [rad/s]")
    return [(name, *limits) for name, limits in zip(names, ranges, strict=False)]

  def debug_draw(self, draw: DebugDraw) -> None:
    """Draw the commanded velocity (green) and the actual one (blue) as arrows above each robot, 0.4 m per m/s."""
    worlds = torch.tensor(draw.worlds, device=self.device)
    data = self._robot.data
    start = data.root_link_pos_w[worlds].clone()
    start[:, 2] += ARROW_HEIGHT
    turn = quat_yaw(data.root_link_quat_w[worlds])
    wanted = torch.nn.functional.pad(self._command[worlds, :2], (0, 1)).to(start.dtype)
    actual = torch.nn.functional.pad(data.root_link_lin_vel_w[worlds, :2], (0, 1))
    draw.arrows(start, start + ARROW_SCALE * quat_apply(turn, wanted), (0.2, 0.7, 0.3, 1.0), 0.012)
    draw.arrows(start, start + ARROW_SCALE * actual, (0.2, 0.4, 0.9, 1.0), 0.012)

  def update_metrics(self) -> None:
    """Update means over the episode of |v_xy error| [m/s] and |w_z error| [rad/s], without the reset step."""
    data = self._robot.data
    velocity = quat_apply_inverse(data.root_link_quat_w, data.root_link_lin_vel_w)
    counts = ~self.env.command_manager.fresh
    self._steps += counts
    weight = counts / self._steps.clamp(min=1.0)
    error_xy = torch.linalg.vector_norm(self._command[:, :2] - velocity[:, :2], dim=-1)
    error_yaw = (self._command[:, 2] - data.root_link_ang_vel_b[:, 2]).abs()
    for name, error in (("error_vel_xy", error_xy), ("error_vel_yaw", error_yaw)):
      self.metrics[name].lerp_(error.to(weight.dtype), weight)

  def reset(self, mask: torch.Tensor) -> None:
    fill_(self._steps, mask, 0.0)
