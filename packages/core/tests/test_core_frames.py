"""Frames against homogeneous matrices."""

import mjlab_core as core
import torch


def pose(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
  rng = core.make_generator("cpu", seed)
  pos = torch.randn(6, 3, generator=rng, dtype=torch.float64)
  return pos, core.random_quat(6, generator=rng, dtype=torch.float64)


def homogeneous(pos: torch.Tensor, quat: torch.Tensor) -> torch.Tensor:
  T = torch.eye(4, dtype=torch.float64).repeat(6, 1, 1)
  T[:, :3, :3], T[:, :3, 3] = core.matrix_from_quat(quat), pos
  return T


def test_combining_frames_multiplies_their_matrices() -> None:
  ab, bc = pose(0), pose(1)
  torch.testing.assert_close(homogeneous(*core.combine_frames(*ab, *bc)), homogeneous(*ab) @ homogeneous(*bc))


def test_subtracting_undoes_combining() -> None:
  wa, ab = pose(0), pose(1)
  torch.testing.assert_close(core.subtract_frames(*wa, *core.combine_frames(*wa, *ab)), ab)


def test_points_move_with_their_frame() -> None:
  pos, quat = pose(2)
  points = torch.randn(6, 5, 3, dtype=torch.float64)
  ones = torch.ones(6, 5, 1, dtype=torch.float64)
  expected = (homogeneous(pos, quat) @ torch.cat((points, ones), -1).mT).mT[..., :3]
  torch.testing.assert_close(core.transform_points(points, pos, quat), expected)
  assert core.transform_points(points[0], pos, quat).shape == (6, 5, 3)


def test_velocity_at_a_point_is_the_derivative_of_its_path() -> None:
  rng = core.make_generator("cpu", 4)
  v, w, r = torch.randn(3, 6, 3, generator=rng, dtype=torch.float64)
  dt = 1e-6
  moved = v * dt + core.quat_apply(core.quat_from_rotvec(w * dt), r)
  torch.testing.assert_close(core.velocity_at(v, w, r), (moved - r) / dt, atol=1e-5, rtol=1e-5)
