"""Rotations against SciPy and the group axioms, over shapes and dtypes."""

import math

import mjlab_core as core
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation, Slerp

SHAPES = [(), (1,), (7,), (2, 3), (0,)]
DTYPES = [torch.float32, torch.float64]
IDENTITY = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture(params=DTYPES, ids=["f32", "f64"])
def dtype(request: pytest.FixtureRequest) -> torch.dtype:
  return request.param


@pytest.fixture(params=SHAPES, ids=str)
def shape(request: pytest.FixtureRequest) -> tuple[int, ...]:
  return request.param


def tolerance(dtype: torch.dtype) -> float:
  return 2e-6 if dtype == torch.float32 else 1e-14


def close(a: torch.Tensor, b: torch.Tensor, dtype: torch.dtype, factor: float = 1.0) -> None:
  assert a.dtype == dtype
  assert a.shape == b.shape
  torch.testing.assert_close(a, b.to(dtype), atol=factor * tolerance(dtype), rtol=factor * tolerance(dtype))


def same_rotation(a: torch.Tensor, b: torch.Tensor, dtype: torch.dtype, factor: float = 1.0) -> None:
  close((a * b).sum(-1).abs(), torch.ones(a.shape[:-1]), dtype, factor)
  close(core.quat_error_magnitude(a, b), torch.zeros(a.shape[:-1]), dtype, factor)


def draw(shape: tuple[int, ...], dtype: torch.dtype, count: int = 3) -> list[torch.Tensor]:
  rng = core.make_generator("cpu", 0)
  return [core.random_quat(shape, generator=rng, dtype=dtype) for _ in range(count)]


def vectors(shape: tuple[int, ...], dtype: torch.dtype) -> torch.Tensor:
  return torch.randn(*shape, 3, dtype=dtype, generator=core.make_generator("cpu", 1))


def scipy(q: torch.Tensor) -> Rotation:
  return Rotation.from_quat(q.double().numpy(), scalar_first=True)


def from_scipy(rotation: Rotation, dtype: torch.dtype) -> torch.Tensor:
  return torch.from_numpy(rotation.as_quat(scalar_first=True)).to(dtype)


def test_the_product_is_associative_with_identity_and_inverses(shape: tuple[int, ...], dtype: torch.dtype) -> None:
  a, b, c = draw(shape, dtype)
  one = torch.tensor(IDENTITY, dtype=dtype)
  close(core.quat_mul(core.quat_mul(a, b), c), core.quat_mul(a, core.quat_mul(b, c)), dtype)
  close(core.quat_mul(a, one), a, dtype)
  close(core.quat_mul(one, a), a, dtype)
  close(core.quat_mul(a, core.quat_conjugate(a)), one.expand(a.shape), dtype)


def test_applying_a_product_applies_both_and_the_inverse_undoes(shape: tuple[int, ...], dtype: torch.dtype) -> None:
  a, b, _ = draw(shape, dtype)
  v = vectors(shape, dtype)
  close(core.quat_apply(core.quat_mul(a, b), v), core.quat_apply(a, core.quat_apply(b, v)), dtype, 3)
  close(core.quat_apply_inverse(a, core.quat_apply(a, v)), v, dtype, 3)
  close(core.quat_apply(core.quat_conjugate(a), v), core.quat_apply_inverse(a, v), dtype, 3)


def test_maps_there_and_back_are_the_identity(shape: tuple[int, ...], dtype: torch.dtype) -> None:
  a, b, _ = draw(shape, dtype)
  same_rotation(core.quat_from_rotvec(core.rotvec_from_quat(a)), a, dtype, 3)
  same_rotation(core.quat_from_matrix(core.matrix_from_quat(a)), a, dtype, 3)
  same_rotation(core.quat_from_euler_xyz(*core.euler_xyz_from_quat(a)), a, dtype, 3)
  same_rotation(core.quat_box_plus(b, core.quat_box_minus(a, b)), a, dtype, 3)


def test_every_map_agrees_with_scipy(dtype: torch.dtype) -> None:
  a, b, _ = draw((500,), dtype)
  v = vectors((500,), dtype)
  ra, rb = scipy(a), scipy(b)
  oracle = torch.from_numpy
  same_rotation(core.quat_mul(a, b), from_scipy(ra * rb, dtype), dtype, 3)
  close(core.quat_apply(a, v), oracle(ra.apply(v.double().numpy())), dtype, 3)
  close(core.matrix_from_quat(a), oracle(ra.as_matrix()), dtype)
  close(core.rotvec_from_quat(a), oracle(ra.as_rotvec()), dtype, 3)
  same_rotation(core.quat_from_rotvec(v), from_scipy(Rotation.from_rotvec(v.double().numpy()), dtype), dtype, 3)
  same_rotation(core.quat_from_matrix(core.matrix_from_quat(a)), from_scipy(ra, dtype), dtype, 3)
  close(core.quat_error_magnitude(a, b), oracle((ra * rb.inv()).magnitude()), dtype, 3)
  angles = v.clamp(-1.5, 1.5)
  euler = Rotation.from_euler("xyz", angles.double().numpy())
  same_rotation(core.quat_from_euler_xyz(*angles.unbind(-1)), from_scipy(euler, dtype), dtype, 3)
  close(torch.stack(core.euler_xyz_from_quat(from_scipy(euler, dtype)), -1), angles, dtype, 30)


def test_slerp_agrees_with_scipy_and_takes_the_short_way(dtype: torch.dtype) -> None:
  a, b = torch.tensor([[0.9, 0.1, -0.2, 0.3], [-0.2, 0.7, 0.1, 0.5]], dtype=torch.float64)
  a, b = core.normalize(a).to(dtype), core.normalize(b).to(dtype)
  t = torch.linspace(0.0, 1.0, 11, dtype=dtype)
  way = Slerp([0.0, 1.0], Rotation.concatenate([scipy(a), scipy(b)]))(t.double().numpy())
  same_rotation(core.quat_slerp(a, b, t), from_scipy(way, dtype), dtype, 5)
  same_rotation(core.quat_slerp(a, -b, t), from_scipy(way, dtype), dtype, 5)
  same_rotation(core.quat_slerp(a, a, 0.5), a, dtype)


@pytest.mark.parametrize("angle", [0.0, 1e-30, 1e-12, 1e-7, 1e-4, 1.0, math.pi - 1e-4, math.pi - 1e-7, math.pi])
def test_rotation_vectors_keep_their_precision_from_zero_to_pi(angle: float, dtype: torch.dtype) -> None:
  axis = torch.tensor([2.0, -1.0, 2.0], dtype=torch.float64) / 3.0
  rotvec = (angle * axis).to(dtype)
  q = core.quat_from_rotvec(rotvec)
  back = core.rotvec_from_quat(q)
  # At pi both signs of the axis are the same rotation.
  if (back * rotvec).sum() < 0.0:
    back = core.rotvec_from_quat(core.quat_from_rotvec(-rotvec))
    rotvec = -rotvec
  limit = tolerance(dtype) * (angle if angle < 1.0 else 3.0)
  assert torch.linalg.vector_norm(back.abs() - rotvec.abs()) <= limit
  assert torch.isfinite(q).all()


def test_gradients_at_the_identity_are_finite(dtype: torch.dtype) -> None:
  rotvec = torch.zeros(3, dtype=dtype, requires_grad=True)
  core.rotvec_from_quat(core.quat_from_rotvec(rotvec)).sum().backward()
  assert rotvec.grad is not None
  close(rotvec.grad, torch.ones(3), dtype)


def test_a_quaternion_and_its_negative_are_one_rotation(dtype: torch.dtype) -> None:
  a, b, _ = draw((50,), dtype)
  v = vectors((50,), dtype)
  close(core.rotvec_from_quat(-a), core.rotvec_from_quat(a), dtype)
  close(core.quat_error_magnitude(-a, b), core.quat_error_magnitude(a, b), dtype)
  close(core.quat_apply(-a, v), core.quat_apply(a, v), dtype)
  close(core.matrix_from_quat(-a), core.matrix_from_quat(a), dtype)
  close(core.quat_unique(-a), core.quat_unique(a), dtype)
  close(core.heading(-a), core.heading(a), dtype)
  same_rotation(core.quat_yaw(-a), core.quat_yaw(a), dtype)
  assert (core.quat_unique(a)[:, 0] >= 0.0).all()


def test_half_turns_survive_the_matrix(dtype: torch.dtype) -> None:
  axes = torch.tensor([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, -1, 1]], dtype=dtype)
  q = torch.cat((torch.zeros(5, 1, dtype=dtype), core.normalize(axes)), -1)
  same_rotation(core.quat_from_matrix(core.matrix_from_quat(q)), q, dtype, 3)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_gimbal_lock_still_gives_the_rotation_back(pitch: float, dtype: torch.dtype) -> None:
  roll = torch.linspace(-3.0, 3.0, 13, dtype=dtype)
  yaw = torch.linspace(2.0, -2.0, 13, dtype=dtype)
  for offset in (0.0, 1e-6, -1e-6):
    q = core.quat_from_euler_xyz(roll, torch.full_like(roll, pitch + offset), yaw)
    same_rotation(core.quat_from_euler_xyz(*core.euler_xyz_from_quat(q)), q, dtype, 5)


def test_yaw_is_the_heading_of_the_x_axis(dtype: torch.dtype) -> None:
  a, _, _ = draw((100,), dtype)
  x = core.quat_apply(a, torch.tensor([1.0, 0.0, 0.0], dtype=dtype))
  close(core.heading(a), torch.atan2(x[:, 1], x[:, 0]), dtype, 20)
  close(core.rotvec_from_quat(core.quat_yaw(a))[:, 2], core.heading(a), dtype, 20)
  close(core.quat_yaw(a)[:, 1:3], torch.zeros(100, 2), dtype)


def test_box_minus_is_in_the_parent_frame(dtype: torch.dtype) -> None:
  a, b, _ = draw((20,), dtype)
  w = vectors((20,), dtype)
  world = core.quat_box_minus(a, b)
  body = core.quat_apply_inverse(b, world)
  same_rotation(core.quat_mul(b, core.quat_from_rotvec(body)), a, dtype, 5)
  oracle = Rotation.from_rotvec(0.3 * w.double().numpy()) * scipy(b)
  same_rotation(core.quat_box_plus(b, 0.3 * w), from_scipy(oracle, dtype), dtype, 3)


def test_wrapping_keeps_small_angles_bit_identical_and_ends_in_range(dtype: torch.dtype) -> None:
  angle = torch.tensor([0.0, 1e-20, -1.5, 3.0, 3.5, -3.5, 7.0, -100.0], dtype=dtype)
  wrapped = core.wrap_to_pi(angle)
  assert torch.equal(wrapped[:4], angle[:4])
  assert (wrapped.abs() <= math.pi + 1e-6).all()
  close(torch.sin(wrapped), torch.sin(angle), dtype, 20)


def test_random_rotations_are_uniform_and_repeat_with_the_seed() -> None:
  q = core.random_quat(4000, generator=core.make_generator("cpu", 3))
  assert torch.equal(q, core.random_quat((4000,), generator=core.make_generator("cpu", 3)))
  matrices = core.matrix_from_quat(q)
  # Uniform over SO(3): every entry has mean 0 and variance 1/3.
  np.testing.assert_allclose(matrices.mean(0).numpy(), 0.0, atol=0.04)
  np.testing.assert_allclose(matrices.square().mean(0).numpy(), 1 / 3, atol=0.03)


def test_leading_dimensions_broadcast(dtype: torch.dtype) -> None:
  q = draw((4, 1), dtype)[0]
  v = vectors((1, 5), dtype)
  assert core.quat_apply(q, v).shape == (4, 5, 3)
  assert core.quat_mul(q, q.mT.reshape(1, 4, 4)[..., :4]).shape == (4, 4, 4)
  assert core.quat_apply(q, v[0, 0]).shape == (4, 1, 3)


def test_frames_multiply_as_matrices_and_subtracting_undoes_combining() -> None:
  dtype = torch.float64
  wa, ab = ((vectors((6,), dtype) * scale, quat) for scale, quat in zip((1.0, -2.0), draw((6,), dtype, 2), strict=True))

  def homogeneous(pos: torch.Tensor, quat: torch.Tensor) -> torch.Tensor:
    matrix = torch.eye(4, dtype=dtype).repeat(6, 1, 1)
    matrix[:, :3, :3], matrix[:, :3, 3] = core.matrix_from_quat(quat), pos
    return matrix

  wb = core.combine_frames(*wa, *ab)
  torch.testing.assert_close(homogeneous(*wb), homogeneous(*wa) @ homogeneous(*ab))
  torch.testing.assert_close(core.subtract_frames(*wa, *wb), ab)
