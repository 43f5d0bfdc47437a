"""Quality of a clip for a robot that stands on the ground: limits, speeds, ground, feet."""

import dataclasses
import math
import os
from pathlib import Path
from typing import Literal

import torch
from mjlab_core.io.figures import figure
from mjlab_core.io.tables import table

from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion

Severity = Literal["ok", "warning", "error"]
TOUCHING = 0.01
"""Height below which a point touches the ground [m]."""
SKATE_WINDOW = 0.5
"""Time over which sliding is averaged [s]."""
FALLING = 0.5
"""Downward acceleration of the centre of mass, as a share of gravity, from which it counts as falling freely [1]."""
GRAVITY = 9.81


@dataclasses.dataclass(frozen=True, kw_only=True)
class Limit:
  """Values from which a check warns, scores 1, and fails."""

  warning: float
  poor: float
  """Value with a score of 1."""
  unit: str
  about: str
  error: float = math.inf
  """Value from which a simulation cannot start in such a frame: MuJoCo with steps of 5 ms diverges for a Unitree G1."""


LIMITS = {
  "joint_limit": Limit(warning=0.0, poor=0.05, unit="rad", about="joint beyond its range"),
  "joint_speed": Limit(warning=20.0, poor=40.0, error=80.0, unit="rad/s", about="speed of the fastest joint"),
  "root_speed": Limit(warning=5.0, poor=10.0, error=100.0, unit="m/s", about="speed of the root"),
  "root_turning": Limit(warning=12.0, poor=25.0, error=50.0, unit="rad/s", about="angular speed of the root"),
  "penetration": Limit(warning=0.01, poor=0.05, unit="m", about="lowest point below the ground"),
  "floating": Limit(warning=0.02, poor=0.10, unit="m", about="lowest point in the air without falling freely"),
  "foot_skate": Limit(warning=0.2, poor=0.5, unit="m/s", about="sliding of the feet that carry the robot"),
}
"""All checks. Motors of humanoids reach 20 to 40 rad/s."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Finding:
  """Outcome of one check."""

  check: str
  severity: Severity
  """`warning`: training may work, look at it. `error`: a simulation cannot start in such a frame."""
  worst: float
  """Largest value over the clip, in the check's unit."""
  score: float
  """`worst` as a multiple of the value that is poor: 0 is faultless, 1 is poor."""
  time: float
  """Time of the largest value [s]."""
  where: str
  """Joint or body of the largest value, if there is one."""
  share: float
  """Share of frames above the warning."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class QualityReport:
  """All checks of a clip. `series` holds the value of each check in each frame, (frames,)."""

  motion: Motion
  findings: tuple[Finding, ...]
  series: dict[str, torch.Tensor]

  @property
  def severity(self) -> Severity:
    """Worst severity of all findings."""
    found = {finding.severity for finding in self.findings}
    return "error" if "error" in found else "warning" if "warning" in found else "ok"

  @property
  def score(self) -> float:
    """Largest score of all findings: 0 is faultless, 1 is poor."""
    return max(finding.score for finding in self.findings)

  def table(self) -> str:
    """Return the findings as text, one line each."""
    head, rows = ("check", "worst", "warns / poor", "score", "at", "frames above", "where", ""), []
    for finding in self.findings:
      limit = LIMITS[finding.check]
      rows.append(
        (
          finding.check,
          f"{finding.worst:.3f}",
          f"{limit.warning:g} / {limit.poor:g} {limit.unit}",
          f"{finding.score:.2f}",
          f"{finding.time:.2f} s",
          f"{100 * finding.share:.1f} %",
          finding.where,
          finding.severity,
        )
      )
    motion = self.motion
    size = f"{motion.num_frames} frames at {motion.rate:g} Hz, {motion.duration:.2f} s"
    return "\n".join([f"{motion.name}: {size}: {self.severity}, score {self.score:.2f}", table(head, rows)])


def check_quality(motion: Motion, robot: Kinematics) -> QualityReport:
  """Check a clip with the robot that is to perform it.

  - `joint_limit`: distance of a joint beyond its range; `joint_speed`, `root_speed`, `root_turning`: by central
    differences.
  - `penetration`: depth of the lowest point of all collision shapes below z = 0.
  - `floating`: height of the same point, in frames in which the centre of mass does not fall freely (by at least half
    of gravity), so that a jump is not a fault.
  - `foot_skate`: horizontal speed of the slowest point that touches the ground (lower than 1 cm), in the same frames,
    because one of the points that carry the robot must stand still. It is the mean over half a second, because steps
    have moments in which neither foot stands still.

  Raises:
    MjlabError: The motion does not fit the robot.
  """
  rate = motion.rate
  q, joint_vel, pos, quat, linear, angular = robot.states(motion)
  points, rows = robot.lowest_points(pos, quat)
  falling = _falls_freely(robot.center_of_mass(pos, quat)[:, 2], rate)
  height, deepest = points[..., 2].min(1)
  arms = points - pos[:, rows]
  sliding = torch.linalg.vector_norm((linear[:, rows] + torch.linalg.cross(angular[:, rows], arms))[..., :2], dim=-1)
  beyond, fastest = _beyond_range(q, robot).max(1), joint_vel.abs().max(1)
  bodies, joints = tuple(robot.body_names[row] for row in rows), robot.joint_names
  # Values of each check, the index of the joint or body, and the names of these.
  series: dict[str, tuple[torch.Tensor, torch.Tensor | None, tuple[str, ...]]] = {
    "joint_limit": (beyond.values, beyond.indices, joints),
    "joint_speed": (fastest.values, fastest.indices, joints),
    "root_speed": (torch.linalg.vector_norm(linear[:, 0], dim=-1), None, (motion.root_body,)),
    "root_turning": (torch.linalg.vector_norm(angular[:, 0], dim=-1), None, (motion.root_body,)),
    "penetration": ((-height).clamp(min=0.0), deepest, bodies),
    "floating": (torch.where(falling, 0.0, height.clamp(min=0.0)), deepest, bodies),
    "foot_skate": (_skate(sliding, (points[..., 2] < TOUCHING) & ~falling[:, None], rate), None, ()),
  }
  findings = tuple(_finding(check, *values, motion) for check, values in series.items())
  return QualityReport(motion=motion, findings=findings, series={name: values[0] for name, values in series.items()})


def _beyond_range(q: torch.Tensor, robot: Kinematics) -> torch.Tensor:
  """Return the distance of joints beyond their ranges, (frames, joints)."""
  ranges = torch.as_tensor(robot.model.jnt_range[robot.joint_ids])
  limited = torch.as_tensor(robot.model.jnt_limited[robot.joint_ids]).bool()
  return torch.maximum(ranges[:, 0] - q, q - ranges[:, 1]).clamp(min=0.0) * limited


def _skate(sliding: torch.Tensor, standing: torch.Tensor, rate: float) -> torch.Tensor:
  """Return the mean speed of the slowest point that stands, (frames,), of speeds and marks (frames, points)."""
  slowest = torch.where(standing, sliding, math.inf).amin(1)
  return _running_mean(torch.where(torch.isinf(slowest), 0.0, slowest), round(0.5 * SKATE_WINDOW * rate))


def _falls_freely(height: torch.Tensor, rate: float) -> torch.Tensor:
  """Return the frames in which a centre of mass at `height`, (frames,) [m], falls, and their neighbours."""
  acceleration = height.diff(n=2) * rate**2
  falls = torch.nn.functional.pad(acceleration < -FALLING * GRAVITY, (1, 1))
  falls[1:] |= falls[:-1].clone()
  falls[:-1] |= falls[1:].clone()
  return falls


def _running_mean(values: torch.Tensor, reach: int) -> torch.Tensor:
  """Return the mean of the neighbours up to `reach` frames away, as many as exist, (frames,)."""
  reach = min(reach, len(values) - 1)
  pooled = torch.nn.functional.avg_pool1d(values[None], 2 * reach + 1, 1, reach, count_include_pad=False)
  return pooled[0]


def _finding(
  check: str, values: torch.Tensor, which: torch.Tensor | None, names: tuple[str, ...], motion: Motion
) -> Finding:
  limit = LIMITS[check]
  frame = int(values.argmax())
  worst = float(values[frame])
  return Finding(
    check=check,
    severity="error" if worst > limit.error else "warning" if worst > limit.warning else "ok",
    worst=worst,
    score=worst / limit.poor,
    time=frame / motion.rate,
    where=names[0 if which is None else int(which[frame])] if names and worst > 0.0 else "",
    share=float((values > limit.warning).double().mean()),
  )


def plot_quality(report: QualityReport, path: str | os.PathLike[str]) -> None:
  """Draw every check over time, with its limits, as a PNG.

  Raises:
    ModuleNotFoundError: matplotlib is not installed; the message says how to get it.
  """
  colors = {"ok": "tab:green", "warning": "tab:orange", "error": "tab:red"}
  motion = report.motion
  time = (torch.arange(motion.num_frames) / motion.rate).numpy()
  with figure(Path(path), (10, 1.5 * len(report.findings) + 0.6), package="mjlab-motions", dpi=80) as drawn:
    axes = drawn.subplots(len(report.findings), 1, sharex=True)
    for axis, finding in zip(axes, report.findings, strict=True):
      limit, values = LIMITS[finding.check], report.series[finding.check].numpy()
      axis.plot(time, values, color=colors[finding.severity], linewidth=1.0)
      top = max(1.15 * float(values.max()), 1.3 * limit.warning, 0.25 * limit.poor)
      axis.set_ylim(0.0, top)
      for level, style in ((limit.warning, ":"), (limit.poor, "--")):
        if 0.0 < level <= top:
          axis.axhline(level, color="0.4", linestyle=style, linewidth=0.8)
      axis.set_ylabel(f"{finding.check}\n[{limit.unit}]", fontsize=8)
      axis.tick_params(labelsize=7)
      where = f", {finding.where}" if finding.where else ""
      worst = f"score {finding.score:.2f}, worst {finding.worst:.3g} {limit.unit} at {finding.time:.2f} s{where}"
      axis.set_title(f"{limit.about}: {finding.severity}, {worst}", fontsize=8, loc="left", pad=2)
    axes[-1].set_xlabel("time [s]", fontsize=8)
    drawn.suptitle(f"{motion.name} ({motion.rate:g} Hz, {motion.duration:.1f} s)", fontsize=10)
