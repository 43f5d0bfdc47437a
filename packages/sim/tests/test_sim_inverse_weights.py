"""Constants that follow from the inertia matrix are MuJoCo's, whatever the model is made of."""

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from mjlab_sim.inverse_weights import InverseWeights

FIELDS = ("dof_invweight0", "body_invweight0", "tendon_invweight0", "actuator_acc0")

TREE = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="trunk" pos="0 0 1">
      <freejoint/>
      <geom size="0.1" mass="5"/>
      <body name="left" pos="0 0.2 0">
        <joint name="left_hip" axis="0 1 0" armature="0.02"/>
        <joint name="left_twist" axis="0 0 1" pos="0.01 0 0"/>
        <geom type="capsule" size="0.04" fromto="0 0 0 0.1 0 -0.4" mass="1"/>
        <body name="plate" pos="0 0 -0.4">
          <geom type="box" size="0.1 0.05 0.01" mass="0.3"/>
          <site name="toe" pos="0.1 0 0"/>
        </body>
      </body>
      <body name="right" pos="0 -0.2 0">
        <joint name="right_hip" type="ball"/>
        <geom type="capsule" size="0.04" fromto="0 0 0 0 0.1 -0.4" mass="1"/>
        <body name="slider" pos="0 0 -0.4">
          <joint name="right_slide" type="slide" axis="0 0 1"/>
          <geom size="0.05" mass="0.5"/>
          <site name="tip"/>
        </body>
      </body>
    </body>
    <body name="crate" pos="1 0 0.099"><freejoint/><geom type="box" size="0.1 0.2 0.1" mass="2"/></body>
    <body name="cart" pos="2 0 1">
      <joint name="cart_x" type="slide" axis="1 0 0" armature="2"/>
      <joint name="cart_y" type="slide" axis="0 1 0"/>
      <geom size="0.1" mass="3"/>
    </body>
    <body name="spinner" pos="3 0 1"><joint axis="0 0 1"/><geom size="0.1" pos="0.2 0 0" mass="1"/></body>
    <body name="rotor" pos="4 0 1"><joint axis="0 0 1"/><geom size="0.1" mass="1"/></body>
    <body name="hand" mocap="true" pos="0 2 1"><geom size="0.05" mass="1"/></body>
    <body name="post" pos="0 3 0"><geom size="0.05" mass="1"/><site name="anchor" pos="0 0 1"/></body>
  </worldbody>
  <tendon>
    <fixed name="coupled"><joint joint="left_hip" coef="0.5"/><joint joint="right_slide" coef="-2"/></fixed>
    <spatial name="rope"><site site="anchor"/><site site="toe"/></spatial>
  </tendon>
  <actuator>
    <motor joint="left_twist" gear="3"/>
    <motor joint="right_hip" gear="1 2 0.5"/>
    <motor tendon="coupled"/>
    <motor tendon="rope" gear="2"/>
    <motor site="tip" gear="0 0 1 0.1 0 0"/>
    <motor site="toe" refsite="tip" gear="1 0 0 0 0 0"/>
    <adhesion body="crate" ctrlrange="0 1" gain="5"/>
  </actuator>
</mujoco>
"""

# Armature along a tendon couples dofs, which MuJoCo allows within one branch of a tree.
CHAIN = """
<mujoco>
  <worldbody>
    <body pos="0 0 1">
      <joint name="a" axis="0 1 0"/>
      <geom size="0.05" fromto="0 0 0 0.3 0 0" type="capsule"/>
      <body pos="0.3 0 0">
        <joint name="b" axis="0 1 0"/>
        <geom size="0.05" fromto="0 0 0 0.3 0 0" type="capsule"/>
        <body pos="0.3 0 0">
          <joint name="c" axis="0 0 1"/>
          <geom size="0.05" fromto="0 0 0 0.3 0.1 0" type="capsule"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="t" armature="0.3"><joint joint="a" coef="1"/><joint joint="b" coef="-2"/></fixed></tendon>
  <actuator><motor joint="c"/><motor tendon="t"/></actuator>
</mujoco>
"""


def compute(model: mujoco.MjModel, mask: list[bool]) -> tuple[mjw.Model, mjw.Data]:
  """The constants of every world cleared, then derived anew for `mask`, from a state that is not the reference."""
  data = mujoco.MjData(model)
  mujoco.mj_integratePos(model, data.qpos, np.random.default_rng(0).normal(size=model.nv), 0.2)
  mujoco.mj_forward(model, data)
  with wp.ScopedDevice("cpu"):
    m = mjw.put_model(model)
    d = mjw.put_data(model, data, nworld=len(mask), nconmax=16, njmax=64)
    for name in FIELDS:
      shared = getattr(m, name)
      setattr(m, name, wp.zeros((len(mask), *shared.shape[1:]), dtype=shared.dtype))
    mjw.set_const(m, d, groups=int(mjw.SetConstGroup.KIN0), restore=False)
    InverseWeights(model, m, d).compute(wp.array(mask, dtype=wp.bool))
  return m, d


@pytest.mark.warp
@pytest.mark.parametrize("xml", [TREE, CHAIN], ids=["tree", "chain"])
def test_constants_are_mujocos_from_any_state(xml: str) -> None:
  model = mujoco.MjModel.from_xml_string(xml)
  m, d = compute(model, [True, True])
  for name in FIELDS:
    expected = getattr(model, name)
    for actual in getattr(m, name).numpy():
      np.testing.assert_allclose(actual, expected.reshape(actual.shape), rtol=2e-5, atol=2e-5, err_msg=name)
  data = mujoco.MjData(model)
  mujoco.mj_integratePos(model, data.qpos, np.random.default_rng(0).normal(size=model.nv), 0.2)
  np.testing.assert_allclose(d.qpos.numpy()[0], data.qpos, atol=1e-6)


@pytest.mark.warp
def test_worlds_outside_of_the_mask_are_not_computed() -> None:
  m, _ = compute(mujoco.MjModel.from_xml_string(TREE), [True, False])
  for name in FIELDS:
    asked, other = getattr(m, name).numpy()
    assert asked.any(), name
    assert not other.any(), name
