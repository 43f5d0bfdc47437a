"""Robot of `tools/sysid_policy_proof.py`, and the overlay that was identified from its record."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import sysid_policy_proof as proof
from mjlab import load_task
from mjlab_robots import go1
from mjlab_scene.models.overlay import read_overlay
from mjlab_sysid import Robot

OVERLAY = Path(__file__).parents[1] / "docs/benchmarks/sysid_go1.json"


def test_the_identified_robot_is_the_real_one_and_the_model_is_not() -> None:
  real, wrong, found = proof.stand().model, proof.stand().model, proof.stand(OVERLAY).model
  proof.make_real(real)
  for leg in ("FR", "FL", "RR", "RL"):
    for kind in ("hip", "thigh", "calf"):
      joint = f"{leg}_{kind}_joint"
      for name in ("frictionloss", "damping"):
        true = float(getattr(real.joint(joint), name)[0])
        assert getattr(found.joint(joint), name)[0] == pytest.approx(true, rel=0.15), (joint, name)
        assert getattr(wrong.joint(joint), name)[0] != pytest.approx(true, rel=0.15), (joint, name)
      # The steps of 5 ms act as a part of the armature, so less of it explains a record of steps of 1 ms.
      assert wrong.joint(joint).armature[0] < found.joint(joint).armature[0] < real.joint(joint).armature[0]
      assert found.actuator(joint).gainprm[0] == pytest.approx(real.actuator(joint).gainprm[0], rel=0.05)
    assert found.body(f"{leg}_calf").mass[0] == pytest.approx(real.body(f"{leg}_calf").mass[0], rel=0.06)
  entity = go1(meshes="never")
  entity.overlay = str(OVERLAY)
  actuators = entity.build("robot").actuators
  assert actuators is not None
  lags = {(actuator.delay_min_lag, actuator.delay_max_lag) for actuator in actuators.cfgs}
  timestep = load_task(proof.TASK).env.sim.timestep
  assert lags == {(8, 9)}
  assert 8 * timestep < proof.DELAY * proof.TIMESTEP < 9 * timestep


def test_the_identified_robot_moves_as_the_real_one() -> None:
  model, real, found = proof.stand(), proof.stand(), proof.stand(OVERLAY)
  proof.make_real(real.model)
  commands = proof.excitation(real, 3.0, np.random.default_rng(1))
  truth = proof.motion(real, commands, proof.DELAY * proof.TIMESTEP)[0]

  def error(robot: Robot, delay: float) -> float:
    return float(np.sqrt(np.mean((proof.motion(robot, commands, delay)[0] - truth) ** 2)))

  (delay,) = set(read_overlay(OVERLAY).delay.values())
  assert error(found, delay) < 0.002
  assert error(model, 0.0) > 0.03
  # The true numbers at 5 ms a step do not predict as well.
  real.model.opt.timestep = found.model.opt.timestep
  assert error(found, delay) < error(real, delay)


def test_the_real_robot_on_the_ground_of_the_task_is_one_for_both_policies() -> None:
  (model, none), (real, delay) = proof.worlds(None).values()
  (found, late), (same, again) = proof.worlds(OVERLAY).values()
  assert (none, delay, again) == (0, proof.DELAY, proof.DELAY)
  assert late == pytest.approx(proof.DELAY, abs=3)
  for name in ("body_mass", "dof_armature", "dof_frictionloss", "actuator_gainprm", "actuator_biasprm"):
    np.testing.assert_array_equal(getattr(same, name), getattr(real, name))
  assert real.geom("terrain").type == mujoco.mjtGeom.mjGEOM_PLANE
  assert real.opt.timestep == model.opt.timestep == found.opt.timestep == proof.TIMESTEP
  for name in ("robot/FR_calf", "robot/RL_calf"):
    assert real.body(name).mass[0] == pytest.approx(proof.SHANK * model.body(name).mass[0])
  assert real.actuator("robot/FL_hip_joint").gainprm[0] == pytest.approx(
    proof.GAIN * model.actuator("robot/FL_hip_joint").gainprm[0]
  )
  true = proof.REAL["dof_frictionloss"]["thigh"]
  assert found.joint("robot/FL_thigh_joint").frictionloss[0] == pytest.approx(true, rel=0.1)
  assert real.joint("robot/FL_thigh_joint").frictionloss[0] == true
