"""The fused solver against MuJoCo C, by properties of the solution, on random models."""

import itertools
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sim import Simulation, SimulationCfg
from mjlab_sim.warp.solver.fused_newton import FusedNewton, choose_solver
from sim_problem import ROWS, Problem
from sim_world import MakeSim

CONES = {
  "pyramidal": mujoco.mjtConstraint.mjCNSTR_CONTACT_PYRAMIDAL,
  "elliptic": mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC,
}
"""Each cone's type of constraint row."""


def random_model(seed: int, cone: str) -> mujoco.MjModel:
  """All kinds of joints and of constraint rows; 12 degrees of freedom, so that all models share their kernels."""
  rng = np.random.default_rng(seed)
  dims = rng.permutation([1, 3, 4, 6])
  x, y, z = rng.uniform(0.1, 0.25, 3)
  equality = rng.choice(
    [
      f'<connect body1="fore" body2="cart" anchor="{x} 0 0"/>',
      f'<weld body1="upper" body2="cart" solref="0.1 1" relpose="{x} {y} {z} 1 0 0 0"/>',
      f'<joint joint1="elbow" joint2="lid" polycoef="{x} 0.5 0 0 0"/>',
      '<tendon tendon1="sum" tendon2="string"/>',
    ]
  )
  return mujoco.MjModel.from_xml_string(f"""
  <mujoco>
    <option cone="{cone}" impratio="{rng.uniform(1, 20)}" timestep="0.005"/>
    <default><geom condim="{dims[0]}" friction="{rng.uniform(0.3, 1.2)} {rng.uniform(0.005, 0.05)} 0.001"/></default>
    <worldbody>
      <geom type="plane" size="5 5 .1" condim="1"/>
      <body name="base" pos="0 0 0.12"><freejoint/><geom type="box" size=".1 .15 .1" condim="{dims[1]}"/>
        <body name="upper" pos="{x} 0 0"><joint type="ball" range="0 0.4" limited="{rng.choice(["true", "false"])}"/>
          <geom type="capsule" size=".04" fromto="0 0 0 {x} 0 -.05" condim="{dims[2]}"/>
          <body name="fore" pos="{x} 0 -.05"><joint name="elbow" axis="0 1 0" limited="true" range="-.2 .2"
              frictionloss="{rng.choice([0, 0.3])}" armature=".01"/><site name="tip" pos="{x} 0 0"/>
            <geom type="sphere" size=".06" pos="{x} 0 0" condim="{dims[3]}"/></body></body></body>
      <body name="cart" pos="-.5 0 .2"><joint name="rail" type="slide" axis="1 0 0" frictionloss=".4" armature=".1"/>
        <geom type="sphere" size=".1"/><site name="hook" pos="0 0 .1"/>
        <body pos="0 .2 0"><joint name="lid" axis="1 0 0" limited="true" range="-.1 .1"/>
          <geom type="sphere" size=".05" pos="0 .1 0"/></body></body>
    </worldbody>
    <tendon>
      <fixed name="sum" frictionloss=".2" limited="true" range="-.1 .1">
        <joint joint="elbow" coef="1"/><joint joint="lid" coef="{y}"/></fixed>
      <spatial name="string" limited="true" range="0 {rng.uniform(0.5, 1.5)}">
        <site site="tip"/><site site="hook"/></spatial>
    </tendon>
    <equality>{equality}</equality>
  </mujoco>""")


def random_problem(seed: int, cone: str = "elliptic") -> Problem:
  """A random state of a random model."""
  model, rng = random_model(seed, cone), np.random.default_rng(seed)
  host = mujoco.MjData(model)
  mujoco.mj_integratePos(model, host.qpos, rng.normal(0, 0.15, model.nv), 1.0)
  host.qpos[2] = rng.uniform(0.08, 0.12)
  host.qvel[:] = rng.normal(0, 1, model.nv)
  mujoco.mj_forward(model, host)
  return Problem(model, host)


@pytest.fixture
def problem() -> Problem:
  return random_problem(3)


@pytest.mark.warp
@pytest.mark.parametrize("cone", CONES)
def test_solutions_on_random_models_are_optimal_by_mujoco(cone: str) -> None:
  types, dims, worst = set(), set(), 0.0
  for seed in range(8):
    problem = random_problem(seed, cone)
    m, d, host = problem.m, problem.d, problem.host
    assert d.nefc.numpy()[0] == host.nefc
    types |= set(host.efc_type.tolist())
    dims |= set(host.contact.dim.tolist())
    solver = FusedNewton(m, d)
    costs = []
    for iterations in (1, 2, 3, 100):
      m.opt.iterations = iterations
      solver.solve(m, d)
      gap, residual = problem.judge(d.qacc.numpy()[0])
      costs.append(gap)
    assert all(after <= before + 1e-6 for before, after in itertools.pairwise(costs)), seed
    # The tolerance is 1e-6, in the same unit.
    assert abs(costs[-1]) < 2e-6, seed
    assert residual < 1e-3, seed
    worst = max(worst, np.abs(d.qacc.numpy()[0] - problem.best).max() / np.abs(problem.best).max())
    force = d.qfrc_constraint.numpy()[0]
    np.testing.assert_allclose(force, host.qfrc_constraint, atol=1e-3 * np.abs(host.qfrc_constraint).max())
  assert worst < 1e-4
  assert {*range(6), int(CONES[cone])} <= types
  assert dims == {1, 3, 4, 6}


@pytest.mark.warp
def test_worlds_beyond_shared_memory_are_solved_alike(problem: Problem) -> None:
  m, d = problem.m, problem.d
  found = []
  for sizes in ({}, {"rows": 4}, {"groups": 8}):
    solver = FusedNewton(m, d, **sizes)
    d.qacc.zero_()
    solver.solve(m, d)
    assert solver.is_left.numpy()[0] == bool(sizes)
    found.append([x.numpy().copy() for x in (d.qacc, d.efc.force, d.efc.state, d.efc.Ma, d.solver_niter)])
  for left in found[1:]:
    for mine, first in zip(left, found[0], strict=True):
      np.testing.assert_array_equal(mine, first)


@pytest.mark.warp
@pytest.mark.parametrize("run_qacc_smooth", [True, False])
def test_a_world_without_rows_gets_its_smooth_acceleration(problem: Problem, run_qacc_smooth: bool) -> None:
  m, d = problem.m, problem.d
  m.opt.run_qacc_smooth = run_qacc_smooth
  for count in (d.ne, d.nf, d.nefc):
    count.zero_()
  FusedNewton(m, d).solve(m, d)
  smooth = problem.host.qacc_smooth
  np.testing.assert_allclose(d.qacc.numpy()[0], smooth, atol=1e-4 * np.abs(smooth).max())
  assert np.abs(d.qfrc_constraint.numpy()).max() < 1e-3


@pytest.mark.warp
def test_a_solver_follows_buffers_that_grow(problem: Problem) -> None:
  m, d = problem.m, problem.d
  found = []
  for rows in (8, ROWS):
    solver = FusedNewton(m, mjw.make_data(problem.model, nworld=1, nconmax=4, njmax=rows))
    d.qacc.zero_()
    solver.solve(m, d)
    found.append(d.qacc.numpy().copy())
  np.testing.assert_array_equal(*found)


@pytest.mark.warp
def test_forces_and_states_of_rows_are_those_of_mujoco_warp(problem: Problem) -> None:
  m, d = problem.m, problem.d
  found = []
  for solve in (FusedNewton(m, d).solve, mjw.solve):
    solve(m, d)
    found.append([x.numpy()[0, : problem.host.nefc].copy() for x in (d.efc.force, d.efc.state)])
  np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-3 * np.abs(found[1][0]).max())
  np.testing.assert_array_equal(found[0][1], found[1][1])


@pytest.mark.warp
def test_a_simulation_moves_alike_with_either_solver(make_sim: MakeSim) -> None:
  ends = []
  for backend in ("mujoco_warp", "fused"):
    sim = make_sim("warp", solver_backend=backend)
    for _ in range(40):
      sim.step()
    ends.append(sim.data.qpos.clone())
  assert not torch.equal(ends[0], ends[1])
  torch.testing.assert_close(ends[0], ends[1], atol=1e-4, rtol=1e-4)


MODEL = '<mujoco><option {option}/><worldbody><body><{joint}/><geom size=".1"/></body></worldbody></mujoco>'


@pytest.mark.warp
@pytest.mark.parametrize(
  ("option", "reason"),
  [
    ('solver="CG"', "its solver is not Newton"),
    ('noslip_iterations="3"', "noslip"),
    ('integrator="discrete"', "discrete"),
    ('iterations="0"', "no solver iterations"),
  ],
)
def test_models_that_it_does_not_cover_are_refused_by_name(option: str, reason: str) -> None:
  spec = mujoco.MjSpec.from_string(MODEL.format(option=option, joint="freejoint"))
  settings: dict[str, Any] = {"engine": "warp", "integrator": None, "nconmax": 4, "njmax": 8}
  with pytest.raises(MjlabError, match=f"solver_backend 'fused' does not cover this model: .*{reason}.*'auto'"):
    Simulation(1, spec, SimulationCfg(solver_backend="fused", **settings), "cpu")
  m = mjw.put_model(spec.compile())
  d = mjw.make_data(spec.compile(), nworld=1, nconmax=4, njmax=8)
  assert choose_solver(m, d, "auto") is None
