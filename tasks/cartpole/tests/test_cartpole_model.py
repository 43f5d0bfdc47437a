"""The compiled cartpole has the published masses, lengths, limits and drive."""

import mujoco
import numpy as np
import pytest
from mjlab_cartpole import balance
from mjlab_envs import ManagerBasedRlEnv


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
  cfg = balance().env
  cfg.scene.num_envs = 1
  return ManagerBasedRlEnv(cfg, device="cpu").sim.mj_model


def test_the_cart_slides_along_x_between_soft_stops(model: mujoco.MjModel) -> None:
  slider = model.joint("cartpole/slider")
  assert slider.type[0] == mujoco.mjtJoint.mjJNT_SLIDE
  assert slider.axis.tolist() == [1.0, 0.0, 0.0]
  assert slider.range.tolist() == [-1.8, 1.8]
  assert model.jnt_limited[slider.id]
  assert model.jnt_solref[slider.id].tolist() == [0.08, 1.0]
  assert model.dof_damping[slider.dofadr[0]] == 5e-4


def test_the_cart_is_a_box_of_one_kilogram_a_metre_up(model: mujoco.MjModel) -> None:
  assert model.body("cartpole/cart").mass[0] == pytest.approx(1.0)
  geom = model.geom("cartpole/cart")
  assert geom.type[0] == mujoco.mjtGeom.mjGEOM_BOX
  assert geom.size.tolist() == [0.2, 0.15, 0.1]
  data = mujoco.MjData(model)
  mujoco.mj_forward(model, data)
  np.testing.assert_allclose(data.geom("cartpole/cart").xpos, (0.0, 0.0, 1.0), atol=1e-12)


def test_the_pole_is_a_capsule_of_one_metre_that_turns_freely_about_y(model: mujoco.MjModel) -> None:
  hinge, geom = model.joint("cartpole/hinge"), model.geom("cartpole/pole")
  assert hinge.type[0] == mujoco.mjtJoint.mjJNT_HINGE
  assert hinge.axis.tolist() == [0.0, 1.0, 0.0]
  assert not model.jnt_limited[hinge.id]
  assert model.dof_damping[hinge.dofadr[0]] == 2e-6
  assert geom.type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE
  np.testing.assert_allclose(geom.size[:2], (0.045, 0.5))
  assert model.body("cartpole/pole").mass[0] == pytest.approx(0.1)
  np.testing.assert_allclose(model.body("cartpole/pole").ipos, (0.0, 0.0, 0.5), atol=1e-12)


def test_a_motor_drives_the_cart_with_up_to_ten_newton(model: mujoco.MjModel) -> None:
  (actuator,) = [model.actuator(i) for i in range(model.nu)]
  assert model.joint(int(actuator.trnid[0])).name == "cartpole/slider"
  assert actuator.gear[0] == 10.0
  assert actuator.ctrlrange.tolist() == [-1.0, 1.0]
  assert actuator.ctrllimited[0]
  assert (actuator.gainprm[0], actuator.biasprm.any()) == (1.0, False)


def test_nothing_touches_and_the_solver_is_as_published(model: mujoco.MjModel) -> None:
  option = model.opt
  assert option.disableflags == mujoco.mjtDisableBit.mjDSBL_CONTACT
  assert (option.timestep, option.iterations, option.ls_iterations) == (0.01, 100, 50)
  assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
  assert option.solver == mujoco.mjtSolver.mjSOL_NEWTON
  assert option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
  assert (option.tolerance, option.ls_tolerance, option.impratio) == (1e-8, 0.01, 1.0)


def test_accelerations_are_those_of_the_textbook(model: mujoco.MjModel) -> None:
  """(M + m) x'' + m l (w' cos - w^2 sin) = F; I w' + m l x'' cos - m g l sin = 0, about the hinge, less damping."""
  data = mujoco.MjData(model)
  rng = np.random.default_rng(0)
  m, length, inertia = 0.1, 0.5, model.body("cartpole/pole").inertia[0] + 0.1 * 0.5**2
  for _ in range(20):
    x, angle, v, w = rng.uniform(-1.0, 1.0), *rng.uniform(-3.0, 3.0, 3)
    action = rng.uniform(-2.0, 2.0)
    data.qpos[:], data.qvel[:], data.ctrl[:] = (x, angle), (v, w), action
    mujoco.mj_forward(model, data)
    c, s = np.cos(angle), np.sin(angle)
    force = 10.0 * np.clip(action, -1.0, 1.0) - 5e-4 * v + m * length * w**2 * s
    torque = m * 9.81 * length * s - 2e-6 * w
    expected = np.linalg.solve([[1.0 + m, m * length * c], [m * length * c, inertia]], [force, torque])
    np.testing.assert_allclose(data.qacc, expected, rtol=1e-6, atol=1e-9)
