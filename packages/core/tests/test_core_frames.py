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
