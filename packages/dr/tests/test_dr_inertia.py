"""The perturbation of inertial parameters: its definition, its inverse, and its limits."""

from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core import make_generator, matrix_from_quat, normalize, quat_error_magnitude
from mjlab_dr import inertia_perturbation, perturb_inertia, pseudo_inertia, randomize
from mjlab_dr.inertia import second_moments
from torch import Tensor

torch.set_num_threads(1)


@pytest.fixture(params=["torch", pytest.param("warp", marks=pytest.mark.warp)])
def path(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
  """By operations of torch, and by the kernel that a GPU would run."""
  if request.param == "warp":
    pytest.importorskip("warp", reason="Warp is not installed")
    from mjlab_dr import inertia_kernels

    monkeypatch.setattr("mjlab_dr.inertia._has_kernel", lambda device: True)
    # Kernels of tests are compiled without optimisation, which many bodies would pay for.
    kernel: Any = inertia_kernels.perturb_inertia
    kernel.module.options["cpu_compiler_flags"] = "-march=native"


each_path = pytest.mark.usefixtures("path")

Body = tuple[Tensor, Tensor, Tensor, Tensor]


def bodies(n: int, *, seed: int = 0, thinnest: float = 0.02) -> Body:
  """n random bodies: mass over four decades, anywhere, any orientation, second moments over a range of 1 / thinnest."""
  generator = make_generator("cpu", seed)
  draw: dict[str, Any] = {"generator": generator, "dtype": torch.float64}
  mass = 10.0 ** (torch.rand(n, **draw) * 4.0 - 3.0)
  second = mass[:, None] * 0.1 * (thinnest + (1.0 - thinnest) * torch.rand(n, 3, **draw))
  inertia = second.sum(-1, keepdim=True) - second
  return mass, torch.randn(n, 3, **draw) * 0.3, inertia, normalize(torch.randn(n, 4, **draw))


def parameters(n: int, size: float, seed: int = 1) -> Tensor:
  draw = torch.rand(n, 10, generator=make_generator("cpu", seed), dtype=torch.float64)
  return size * (2.0 * draw - 1.0)


def upper(p: Tensor) -> Tensor:
  """U of ten parameters as the paper writes it, (n, 4, 4)."""
  alpha, d1, d2, d3, s12, s13, s23, t1, t2, t3 = p.unbind(-1)
  one, zero = torch.ones_like(alpha), torch.zeros_like(alpha)
  rows = [d1.exp(), s12, s13, t1, zero, d2.exp(), s23, t2, zero, zero, d3.exp(), t3, zero, zero, zero, one]
  return alpha.exp()[:, None, None] * torch.stack(rows, -1).unflatten(-1, (4, 4))


def pseudo_inertia_matrix(mass: Tensor, com: Tensor, inertia: Tensor, quat: Tensor) -> Tensor:
  """J of inertial parameters, (..., 4, 4), in float64: positive definite if and only if they are physical."""
  m, c = mass.double()[..., None, None], com.double().unsqueeze(-1)
  top = torch.cat((second_moments(inertia, quat) + m * c @ c.mT, m * c), -1)
  return torch.cat((top, torch.cat((m * c.mT, m), -1)), -2)


def tensor(inertia: Tensor, quat: Tensor) -> Tensor:
  axes = matrix_from_quat(quat)
  return (axes * inertia.unsqueeze(-2)) @ axes.mT


def test_it_is_the_congruence_of_the_pseudo_inertia() -> None:
  before, p = bodies(2000), parameters(2000, 0.5)
  expected = upper(p) @ pseudo_inertia_matrix(*before) @ upper(p).mT
  actual = pseudo_inertia_matrix(*perturb_inertia(*before, p))
  size = expected.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None]
  assert ((actual - expected).abs() / size).max() < 1e-14


@each_path
def test_zero_parameters_change_nothing() -> None:
  before = bodies(500)
  before[2][:100] = torch.tensor([0.5, 0.7, 1.2])  # planar, and not in float32
  before[2][100] = 0.0
  for dtype in (torch.float64, torch.float32):
    given = [x.to(dtype) for x in (*before, torch.zeros(10))]
    for a, b in zip(perturb_inertia(*given), given[:4], strict=True):
      assert a.dtype == dtype
      assert torch.equal(a, b)


def test_a_scaled_body_has_every_number_scaled_and_none_turned_or_moved() -> None:
  _, com, inertia, quat = bodies(500)
  p = torch.zeros(500, 10, dtype=torch.float64)
  p[:, 0] = torch.linspace(-3.0, 3.0, 500)
  # As much as a mass of one, which is the factor itself.
  gain, moved, after, turned = perturb_inertia(torch.ones(500), com, inertia, quat, p)
  torch.testing.assert_close(after, inertia * gain[:, None], rtol=1e-14, atol=0.0)
  assert torch.equal(moved, com)
  assert torch.equal(turned, quat)
  torch.testing.assert_close(gain, (2.0 * p[:, 0]).exp(), rtol=1e-15, atol=0.0)


@each_path
@pytest.mark.parametrize(
  "shapes",
  [
    ((), (), (), (), ()),
    ((7,), (7,), (7,), (7,), ()),
    ((1, 7), (1, 7), (1, 7), (1, 7), (3, 7)),
    ((7,), (3, 1), (1, 1), (), (1, 7)),
    ((2, 3, 7), (3, 7), (7,), (7,), (2, 1, 7)),
    ((0, 7), (0, 7), (0, 7), (0, 7), (7,)),
  ],
  ids=str,
)
def test_batch_dimensions_broadcast_and_memory_may_be_in_any_order(shapes: tuple[tuple[int, ...], ...]) -> None:
  generator = make_generator("cpu", 0)
  batch = torch.broadcast_shapes(*shapes)
  given, repeated = [], []
  for shape, tail in zip(shapes, ((), (3,), (3,), (4,), (10,)), strict=True):
    # Gaps in memory, and the last dimension outermost.
    x = 0.5 + torch.rand(*reversed((*shape, *tail)), 2, generator=generator)[..., 0]
    given.append(x.permute(tuple(reversed(range(x.dim())))))
    repeated.append(given[-1].expand((*batch, *tail)).contiguous())
  for actual, expected in zip(perturb_inertia(*given), perturb_inertia(*repeated), strict=True):
    assert actual.shape == expected.shape
    torch.testing.assert_close(actual, expected, rtol=1e-6, atol=1e-6)


def test_parameters_are_found_again() -> None:
  before, p = bodies(2000), parameters(2000, 1.0)
  after = perturb_inertia(*before, p)
  torch.testing.assert_close(inertia_perturbation(*before, *after), p, rtol=0.0, atol=1e-9)
  # Any body can be turned into any other.
  other = bodies(2000, seed=7)
  reached = perturb_inertia(*before, inertia_perturbation(*before, *other))
  torch.testing.assert_close(pseudo_inertia_matrix(*reached), pseudo_inertia_matrix(*other), rtol=1e-9, atol=1e-9)


def test_between_flat_bodies_there_is_no_one_answer() -> None:
  mass, com, inertia, quat = bodies(2)
  inertia[0] = torch.tensor([1.0, 1.0, 2.0])
  found = inertia_perturbation(mass, com, inertia, quat, mass, com, inertia, quat)
  assert found[0, 1:7].isnan().all()
  torch.testing.assert_close(found[1], torch.zeros(10, dtype=torch.float64), rtol=0.0, atol=1e-12)


@each_path
def test_many_bodies_stay_physical_at_sizes_up_to_3() -> None:
  n = 250_000
  p = parameters(n, 1.0, seed=4) * torch.linspace(0.0, 3.0, n)[:, None]
  before = bodies(n, seed=3)
  mass, com, inertia, quat = perturb_inertia(*before, p)
  # In units of the body's own size, or the matrix says more of the choice of units than of the body.
  length = (inertia.sum(-1) / mass + com.square().sum(-1)).sqrt()
  scaled = pseudo_inertia_matrix(torch.ones(n), com / length[:, None], inertia / (mass * length**2)[:, None], quat)
  assert torch.linalg.cholesky_ex(scaled)[1].max() == 0
  assert mass.min() > 0.0
  single = perturb_inertia(*(x.float() for x in (*before, p)))[2]
  assert single.dtype == torch.float32
  for moments in (inertia, single.double()):
    assert moments.min() > 0.0
    assert (moments <= moments.sum(-1, keepdim=True) - moments).all()


@pytest.mark.parametrize("inertia", [(1.0, 2.0, 3.0), (2.0, 2.0, 4.0), (0.0, 1.0, 1.0), (0.0, 0.0, 0.0)], ids=str)
def test_planar_bodies_rods_and_points_stay_finite_and_what_they_are(inertia: tuple[float, float, float]) -> None:
  n = 1000
  moments = torch.tensor(inertia, dtype=torch.float64).expand(n, 3)
  before = (torch.ones(n), torch.zeros(n, 3), moments, bodies(n)[3])
  mass, com, after, quat = perturb_inertia(*before, parameters(n, 1.0))
  assert all(x.isfinite().all() for x in (mass, com, after, quat))
  assert (after >= 0.0).all()
  # As many directions without extent as before: stretching makes none, and removes none.
  flat = ((0.5 * after.sum(-1, keepdim=True) - after) <= 1e-12 * after.max()).sum(-1)
  assert (flat == int((0.5 * sum(inertia) - np.array(inertia) <= 0.0).sum())).all()
  # A body without mass keeps none.
  assert not perturb_inertia(torch.zeros(n), *before[1:], parameters(n, 0.5))[0].any()


@pytest.mark.parametrize("inertia", [(1.0, 1.0, 1.0), (1.0, 1.0, 1.5), (1.0, 1.4, 1.4)], ids=str)
def test_equal_moments_are_no_special_case(inertia: tuple[float, float, float]) -> None:
  n = 500
  moments = torch.tensor(inertia, dtype=torch.float64).expand(n, 3)
  quat = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64).expand(n, 4)
  p = torch.zeros(n, 10, dtype=torch.float64)
  p[:, 4:7] = parameters(n, 0.5)[:, 4:7]
  _, _, after, turned = perturb_inertia(torch.ones(n), torch.zeros(n, 3), moments, quat, p)
  a = upper(p)[:, :3, :3]
  second = a @ torch.diag_embed(0.5 * moments.sum(-1, keepdim=True) - moments) @ a.mT
  expected = second.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None] * torch.eye(3) - second
  torch.testing.assert_close(tensor(after, turned), expected, rtol=0.0, atol=1e-14)
  torch.testing.assert_close(after.sort(-1)[0], torch.linalg.eigvalsh(expected), rtol=0.0, atol=1e-14)


def test_gradients_are_those_of_finite_differences() -> None:
  given = [x.requires_grad_() for x in (*bodies(3), parameters(3, 0.5))]
  assert torch.autograd.gradcheck(perturb_inertia, given)


def test_principal_axes_turn_no_further_than_they_must() -> None:
  mass, com, _, quat = bodies(500)
  inertia = torch.tensor([0.5, 0.9, 0.7], dtype=torch.float64).expand(500, 3)
  for size in (1e-3, 1e-6):
    turned = perturb_inertia(mass, com, inertia, quat, parameters(500, size))[3]
    assert quat_error_magnitude(turned, quat).max() < 10.0 * size


@each_path
def test_single_precision_loses_no_more_than_its_own_rounding() -> None:
  """Fields in float32 as on a GPU: the error is that of storing input and output, whatever the body."""
  n = 20_000
  mass, com, inertia, quat = bodies(n, thinnest=1e-3)
  # A gram, half a metre away from the origin of its frame.
  mass[0], com[0], inertia[0] = 1e-3, torch.tensor([0.5, 0.0, 0.0]), torch.tensor([1e-7, 1.2e-7, 1.5e-7])
  p = parameters(n, 0.5).float()
  exact = perturb_inertia(mass, com, inertia, quat, p)
  stored = perturb_inertia(mass.float(), com.float(), inertia.float(), quat.float(), p)
  epsilon = torch.finfo(torch.float32).eps
  assert ((stored[0] - exact[0]) / exact[0]).abs().max() < 2.0 * epsilon
  assert (stored[1] - exact[1]).abs().max() < 20.0 * epsilon * exact[1].abs().max()
  error = (tensor(stored[2].double(), stored[3].double()) - tensor(exact[2], exact[3])).flatten(1).norm(dim=-1)
  assert (error / exact[2].norm(dim=-1)).max() < 30.0 * epsilon


def test_a_fixed_base_without_mass_is_left_alone_by_a_pattern_for_all() -> None:
  model = mujoco.MjModel.from_xml_string("""
<mujoco><worldbody><body name="mount" mocap="true"><body name="base"><geom size=".1"/>
  <body name="link"><joint/><geom name="plate" type="box" size=".1 .2 .001" pos=".1 0 0" mass="1"/></body></body></body>
</worldbody></mujoco>""")
  fields = randomize(model, [pseudo_inertia(".*", scale=0.3, t=(-0.01, 0.01))], num_worlds=20, seed=0)
  for name, value in fields.items():
    assert value.isfinite().all(), name
  link = model.body("link").id
  others = [i for i in range(model.nbody) if i != link and model.body_weldid[i] == 0]
  assert torch.equal(fields["body_mass"][:, others], torch.tensor(model.body_mass[others]).float().expand(20, -1))
  assert len(fields["body_mass"][:, link].unique()) == 20


def test_a_body_compiled_as_simple_can_be_scaled_and_stretched_but_neither_moved_nor_sheared() -> None:
  xml = """<mujoco><worldbody><body name="cube"{}><freejoint/><geom type="box" size=".1 .2 .3"/></body></worldbody>
</mujoco>"""
  model, oracle = (mujoco.MjModel.from_xml_string(xml.format(simple)) for simple in ("", ' simple="false"'))
  assert model.body("cube").simple != oracle.body("cube").simple
  sizes: Any = {"alpha": (-0.3, 0.3), "d": (-0.2, 0.2)}
  for each in (model, oracle):
    randomize(each, [pseudo_inertia("cube", **sizes)], seed=0)
    for name in ("body_ipos", "body_iquat"):
      np.testing.assert_array_equal(getattr(each, name)[1], getattr(model, name)[0])
  for name in ("body_mass", "body_inertia", "dof_invweight0"):
    np.testing.assert_allclose(getattr(model, name), getattr(oracle, name), rtol=1e-12)
  for group in ("s", "t"):
    more: Any = {group: (0.0, 0.1)}
    with pytest.raises(ValueError, match="'cube' would do nothing, for it was compiled as simple"):
      randomize(model, [pseudo_inertia("cube", **sizes, **more)], seed=0)


def test_the_shorthand_names_its_parts() -> None:
  cfg = pseudo_inertia("torso", scale=0.1, d=(-0.2, 0.2), t=(-0.01, 0.02))
  assert [d.support() for d in cfg.values.values()] == [
    (-0.1, 0.1), *[(-0.2, 0.2)] * 3, *[(-0.1, 0.1)] * 3, *[(-0.01, 0.02)] * 3
  ]  # fmt: skip
  with pytest.raises(ValueError, match="no axis is given values"):
    pseudo_inertia("torso")


@pytest.mark.warp
def test_the_kernel_for_gpus_gives_what_torch_does(monkeypatch: pytest.MonkeyPatch) -> None:
  pytest.importorskip("warp", reason="Warp is not installed")
  n = 3000
  mass, com, inertia, quat = bodies(n, seed=3)
  p = parameters(n, 1.0, seed=4) * torch.linspace(0.0, 3.0, n)[:, None]
  inertia[:200, 2] = inertia[:200, 0] + inertia[:200, 1]  # planar
  inertia[200:250] = torch.tensor([0.0, 0.1, 0.1])
  inertia[250:300] = 0.3
  inertia[300:400] *= 1e-9
  mass[400], inertia[400] = 0.0, 0.0
  inertia[410:420, 2] = 1.1 * (inertia[410:420, 0] + inertia[410:420, 1])  # no body has such
  p[500:600, 1:7] = 0.0
  p[600:700, 4:7] = 0.0
  tolerance = 30.0 * torch.finfo(torch.float32).eps
  given = [x.float() for x in (mass, com, inertia, quat, p)]
  expected = perturb_inertia(*given)
  monkeypatch.setattr("mjlab_dr.inertia._has_kernel", lambda device: True)
  actual = perturb_inertia(*given)
  torch.testing.assert_close(actual[:2], expected[:2], rtol=tolerance, atol=tolerance)
  inertias = [tensor(x[2].double(), x[3].double()).flatten(1) for x in (actual, expected)]
  assert ((inertias[0] - inertias[1]).norm(dim=-1) <= tolerance * inertias[1].norm(dim=-1)).all()
  # Where no two moments are equal, axes are in the same order as well.
  actual, expected = ([x[700:].double() for x in results] for results in (actual, expected))
  assert ((actual[2] - expected[2]).abs() <= tolerance * expected[2].amax(-1, keepdim=True)).all()
  assert quat_error_magnitude(actual[3], expected[3]).max() < 1e4 * torch.finfo(torch.float64).eps
