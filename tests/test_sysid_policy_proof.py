"""Robot of `tools/sysid_policy_proof.py`, and the overlay that was identified from its record."""

from pathlib import Path

import mujoco
import pytest
import sysid_policy_proof as proof
from mjlab import load_task
from mjlab_robots import go1

OVERLAY = Path(__file__).parents[1] / "docs/benchmarks/sysid_go1.json"


def test_the_identified_robot_is_the_real_one_and_the_model_is_not() -> None:
  real, wrong = go1(meshes="never").build("robot"), go1(meshes="never").build("robot").spec.compile()
  model = real.spec.compile()
  proof.make_real(model)
  cfg = go1(meshes="never")
  cfg.overlay = str(OVERLAY)
  entity = cfg.build("robot")
  found = entity.spec.compile()
  for leg in ("FR", "FL", "RR", "RL"):
    for kind in ("hip", "thigh", "calf"):
      joint = f"{leg}_{kind}_joint"
      for name in ("armature", "frictionloss", "damping"):
        true = float(getattr(model.joint(joint), name)[0])
        # The record was made at 1 ms a step; at 5 ms a part of the damping is the integrator's.
        assert getattr(found.joint(joint), name)[0] == pytest.approx(true, rel=0.25), (joint, name)
        assert getattr(wrong.joint(joint), name)[0] != pytest.approx(true, rel=0.25), (joint, name)
      assert found.actuator(joint).gainprm[0] == pytest.approx(model.actuator(joint).gainprm[0], rel=0.05)
    assert found.body(f"{leg}_calf").mass[0] == pytest.approx(model.body(f"{leg}_calf").mass[0], rel=0.06)
  assert entity.actuators is not None
  lags = {(actuator.delay_min_lag, actuator.delay_max_lag) for actuator in entity.actuators.cfgs}
  timestep = load_task(proof.TASK).env.sim.timestep
  assert lags == {(5, 6)}
  assert 5 * timestep < proof.DELAY * proof.TIMESTEP < 6 * timestep


def test_the_real_robot_walks_on_the_ground_of_the_task() -> None:
  model, real = proof.walking_model(is_real=False), proof.walking_model(is_real=True)
  assert real.geom("terrain").type == mujoco.mjtGeom.mjGEOM_PLANE
  assert real.opt.timestep == model.opt.timestep == proof.TIMESTEP
  for name in ("robot/FR_calf", "robot/RL_calf"):
    assert real.body(name).mass[0] == pytest.approx(proof.SHANK * model.body(name).mass[0])
  found = proof.walking_model(is_real=False, overlay=OVERLAY)
  assert found.opt.timestep == proof.TIMESTEP
  true = proof.REAL["dof_frictionloss"]["thigh"]
  assert found.joint("robot/FL_thigh_joint").frictionloss[0] == pytest.approx(true, rel=0.1)
  assert real.joint("robot/FL_thigh_joint").frictionloss[0] == true
