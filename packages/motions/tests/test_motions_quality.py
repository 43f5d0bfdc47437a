"""The quality report: its checks find each deliberate fault with its size."""

import math
from pathlib import Path

import pytest
import torch
from mjlab_motions.editing import to_ground
from mjlab_motions.motion import Motion
from mjlab_motions.quality import Finding, check_quality, plot_quality
from motions_robot import constant, robot


def standing(seconds: float = 2.0) -> Motion:
  return to_ground(constant(seconds), robot())


def found(motion: Motion) -> dict[str, Finding]:
  return {finding.check: finding for finding in check_quality(motion, robot()).findings}


def faults(motion: Motion) -> set[str]:
  return {name for name, finding in found(motion).items() if finding.severity != "ok"}


def lifted(motion: Motion, height: torch.Tensor) -> Motion:
  """Raise the root by `height`, (frames,) [m]."""
  up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
  return motion.changed("lifted", root_pos=motion.root_pos + height[:, None] * up)


def test_standing_still_on_the_ground_is_faultless() -> None:
  report = check_quality(standing(), robot())
  assert report.severity == "ok"
  assert all(finding.worst == pytest.approx(0.0, abs=1e-9) for finding in report.findings)


def test_a_joint_beyond_its_range_is_found_with_its_name_and_time() -> None:
  motion = standing()
  joints = motion.joint_pos.clone()
  column = motion.joint_names.index("right_hip_roll")
  joints[70:, column] = math.radians(60.0) + 0.03
  finding = found(motion.changed("", joint_pos=joints))["joint_limit"]
  assert (finding.severity, finding.where, finding.time) == ("warning", "right_hip_roll", 1.4)
  assert finding.worst == pytest.approx(0.03)
  assert finding.share == pytest.approx(31 / 101)


def test_a_jump_of_one_joint_is_a_spike_of_its_speed() -> None:
  motion = standing()
  joints = motion.joint_pos.clone()
  joints[50, motion.joint_names.index("left_knee")] += 1.0
  finding = found(motion.changed("", joint_pos=joints))["joint_speed"]
  # 1 rad over the two frames of a central difference at 50 Hz.
  assert finding.worst == pytest.approx(25.0)
  assert (finding.severity, finding.where) == ("warning", "left_knee")


def test_digging_and_floating_are_measured_from_the_lowest_point() -> None:
  motion = standing()
  assert found(lifted(motion, torch.full((101,), -0.03)))["penetration"].worst == pytest.approx(0.03)
  assert faults(lifted(motion, torch.full((101,), -0.03))) == {"penetration"}
  floating = found(lifted(motion, torch.full((101,), 0.2)))["floating"]
  assert (floating.worst, floating.severity, floating.score) == (pytest.approx(0.2), "warning", pytest.approx(2.0))


def test_a_jump_is_not_floating() -> None:
  motion = standing()
  t = torch.arange(101, dtype=torch.float64) / 50.0
  # Up at 2.5 m/s and back half a second later.
  parabola = (2.5 * (t - 0.5) - 0.5 * 9.81 * (t - 0.5) ** 2).clamp(min=0.0)
  assert parabola.max() > 0.3
  assert "floating" not in faults(lifted(motion, parabola))
  slowed = 0.3 * torch.sin(math.pi * t / 2.0)
  assert "floating" in faults(lifted(motion, slowed))


def test_sliding_over_the_ground_is_skating_and_stepping_is_not() -> None:
  motion = standing()
  t = torch.arange(101, dtype=torch.float64) / 50.0
  slid = motion.changed("", root_pos=motion.root_pos + 0.4 * t[:, None] * torch.tensor([1.0, 0.0, 0.0]))
  assert found(slid)["foot_skate"].worst == pytest.approx(0.4)
  assert faults(slid) == {"foot_skate"}
  # One leg swings to and fro; the other stands.
  joints = motion.joint_pos.clone()
  joints[:, motion.joint_names.index("left_knee")] = 0.5 * (1.0 - torch.cos(6.0 * t))
  assert found(motion.changed("", joint_pos=joints))["foot_skate"].severity == "ok"


def test_the_report_is_a_table_and_a_picture(tmp_path: Path) -> None:
  report = check_quality(lifted(standing(), torch.full((101,), -0.03)), robot())
  lines = report.table().splitlines()
  assert lines[0] == "still: 101 frames at 50 Hz, 2.00 s: warning, score 0.60"
  assert any(line.startswith("penetration") and "0.030" in line and line.endswith("warning") for line in lines)
  assert len(lines) == 2 + len(report.findings)
  plot_quality(report, tmp_path / "quality.png")
  assert (tmp_path / "quality.png").read_bytes().startswith(b"\x89PNG")
