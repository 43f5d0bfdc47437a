"""The velocity command: what forward, sideways and turning speed the robot is to walk at."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch
from mjlab_core import DebugDraw
from mjlab_core.frames import heading
from mjlab_core.masking import fill_, where_
from mjlab_core.rotations import quat_apply, quat_apply_inverse, quat_yaw, wrap_to_pi
from mjlab_core.sampling import check_range
from mjlab_managers import CommandTerm, CommandTermCfg

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

Range = tuple[float, float]

# Arrows in viewers
ARROW_HEIGHT = 0.25  # above the root [m]
ARROW_SCALE = 0.4  # [m per m/s]


@dataclass(kw_only=True)
class VelocityRanges:
  """Ranges that commands are drawn from, in the root's frame."""

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
  standing_fraction: float = 0.1
  """Share of draws whose command is zero."""
  heading_fraction: float = 0.3
  """Share of draws that turn towards a heading target instead of at a drawn rate."""
  forward_fraction: float = 0.2
  """Share of draws that go straight ahead."""
  min_forward_speed: float = 0.3
  """Least speed of those [m/s]."""
  heading_stiffness: float = 0.5
  """Turning rate per heading error [1/s]."""

  def build(self, env: Any) -> "UniformVelocityCommand":
    return UniformVelocityCommand(self, env)


class UniformVelocityCommand(CommandTerm):
  """See `UniformVelocityCommandCfg`. Works on state alone, so that following it costs no forward pass."""

  _constants = frozenset({"_shares"})
  _extra_state = ("ranges",)
  cfg: UniformVelocityCommandCfg

  def __init__(self, cfg: UniformVelocityCommandCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    for name in ("standing_fraction", "heading_fraction", "forward_fraction"):
      if not 0.0 <= getattr(cfg, name) <= 1.0:
        raise ValueError(f"{name} must be in [0, 1], got {getattr(cfg, name)}")
    ranges = []
    for name in ("lin_vel_x", "lin_vel_y", "ang_vel_z", "heading"):
      check_range(f"ranges.{name}", *getattr(cfg.ranges, name))
      ranges.append(getattr(cfg.ranges, name))
    self._robot = env.scene[cfg.entity]
    n, device = self.num_envs, self.device
    self.ranges = torch.tensor(ranges, device=device)
    """Lower and upper bound of forward, sideways and turning speed and heading, (4, 2); curricula write here."""
    self._drawn = torch.zeros(n, 3, device=device)
    self._command = torch.zeros(n, 3, device=device)
    self._speed = torch.zeros(n, device=device)
    self._heading_target = torch.zeros(n, device=device)
    self._stands = torch.zeros(n, dtype=torch.bool, device=device)
    self._holds_heading = torch.zeros(n, dtype=torch.bool, device=device)
    self._steps = torch.zeros(n, device=device)
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

  def update(self) -> None:
    error = wrap_to_pi(self._heading_target - heading(self._robot.data.root_link_quat_w))
    turn = (self.cfg.heading_stiffness * error).clamp(self.ranges[2, 0], self.ranges[2, 1])
    command = self._command
    command.copy_(self._drawn)
    where_(command[:, 2], self._holds_heading, turn.to(command.dtype))
    fill_(command, self._stands, 0.0)
    if self.by_hand is not None:
      where_(command, *self.by_hand)
    torch.add(torch.linalg.vector_norm(command[:, :2], dim=-1), command[:, 2].abs(), out=self._speed)

  @property
  def axes(self) -> list[tuple[str, float, float]]:
    """Name, least and greatest value of each component of the command."""
    ranges = self.ranges.tolist()
    names = ("forward [m/s]", "left [m/s]", "turn left [rad/s]")
    return [(name, *limits) for name, limits in zip(names, ranges, strict=False)]

  def debug_draw(self, draw: DebugDraw) -> None:
    """Above each robot an arrow for the velocity it is to have, green, and one for that it has, blue; 0.4 m per m/s."""
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
    """Running means over the episode of |v_xy error| [m/s] and |w_z error| [rad/s]; the reset step does not count."""
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
