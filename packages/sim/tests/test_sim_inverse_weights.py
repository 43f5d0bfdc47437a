"""Constants that follow from the inertia matrix are MuJoCo's, whatever the model is made of."""

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from mjlab_sim.warp.constants.inverse_weights import InverseWeights

FIELDS = ("dof_invweight0", "body_invweight0", "tendon_invweight0", "actuator_acc0")

TREE = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="trunk" pos="0 0 1">
      <freejoint name="floating"/>
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
    <body name="spinner" pos="3 0 1"><joint name="spin" axis="0 0 1"/><geom size="0.1" pos="0.2 0 0" mass="1"/></body>
    <body name="rotor" pos="4 0 1"><joint axis="0 0 1"/><geom size="0.1" mass="1"/></body>
    <body name="hand" mocap="true" pos="0 2 1"><geom size="0.05" mass="1"/></body>
    <body name="post" pos="0 3 0"><geom size="0.05" mass="1"/><site name="anchor" pos="0 0 1"/></body>
  </worldbody>
  <tendon>
    <fixed name="coupled"><joint joint="left_hip" coef="0.5"/><joint joint="right_slide" coef="-2"/></fixed>
    <fixed name="belt"><joint joint="left_twist" coef="1"/><joint joint="cart_x" coef="0.5"/>
      <joint joint="spin" coef="-1"/></fixed>
    <spatial name="rope"><site site="anchor"/><site site="toe"/></spatial>
  </tendon>
  <actuator>
    <motor joint="left_twist" gear="3"/>
    <motor joint="right_hip" gear="1 2 0.5"/>
    <motor joint="floating" gear="1 0 2 0 0.1 0"/>
    <motor tendon="coupled"/>
    <motor tendon="belt" gear="3"/>
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


NUM_LINKS = 40
# Longer than a block has threads, and with a branch from its middle.
LONG = f"""
<mujoco>
  <default><joint armature="0.1"/><geom size="0.02" mass="0.1"/></default>
  <worldbody>
    {"".join(f'<body pos="0.05 0 0"><joint name="j{i}" axis="{i % 2} 1 0"/><geom/>' for i in range(NUM_LINKS))}
    {"</body>" * (NUM_LINKS // 2)}
    <body pos="0 0.1 0"><joint name="branch" axis="0 0 1"/><geom pos="0.1 0 0"/></body>
    {"</body>" * (NUM_LINKS // 2)}
  </worldbody>
  <tendon><fixed name="t"><joint joint="j0" coef="1"/><joint joint="branch" coef="1"/><joint joint="j39" coef="-1"/>
  </fixed></tendon>
  <actuator><motor joint="j0"/><motor joint="j39"/><motor joint="branch"/><motor tendon="t"/></actuator>
</mujoco>
"""
MODELS = pytest.mark.parametrize("xml", [TREE, CHAIN, LONG], ids=["tree", "chain", "long"])

UNTOUCHED = -7.0


def compute(
  model: mujoco.MjModel, mask: list[bool], mass_scale: list[float] | None = None
) -> tuple[mjw.Model, mjw.Data]:
  """The constants of the worlds in `mask`, from a state that is not the reference; `UNTOUCHED` in all others."""
  data = mujoco.MjData(model)
  mujoco.mj_integratePos(model, data.qpos, np.random.default_rng(0).normal(size=model.nv), 0.2)
  mujoco.mj_forward(model, data)
  with wp.ScopedDevice("cpu"):
    m = mjw.put_model(model)
    d = mjw.put_data(model, data, nworld=len(mask), nconmax=16, njmax=64)
    for name in FIELDS:
      shape = (len(mask), *getattr(model, name).shape)
      setattr(m, name, wp.array(np.full(shape, UNTOUCHED), dtype=getattr(m, name).dtype))
    if mass_scale is not None:
      for name in ("body_mass", "body_subtreemass", "body_inertia"):
        scaled = np.multiply.outer(mass_scale, getattr(model, name))
        setattr(m, name, wp.array(scaled, dtype=getattr(m, name).dtype))
    mjw.set_const(m, d, groups=int(mjw.SetConstGroup.KIN0), restore=False)
    InverseWeights(model, m, d).compute(wp.array(mask, dtype=wp.bool))
  np.testing.assert_array_equal(d.qpos.numpy(), np.tile(data.qpos.astype(np.float32), (len(mask), 1)))
  assert d.nacon.numpy()[0] == len(mask) * data.ncon
  return m, d


@pytest.mark.warp
@MODELS
def test_constants_are_mujocos_from_any_state(xml: str) -> None:
  model = mujoco.MjModel.from_xml_string(xml)
  m, _ = compute(model, [True, True])
  for name in FIELDS:
    expected = getattr(model, name)
    for actual in getattr(m, name).numpy():
      np.testing.assert_allclose(actual, expected.reshape(actual.shape), rtol=2e-5, atol=2e-5, err_msg=name)


@pytest.mark.warp
@pytest.mark.parametrize("mask", [[False] * 3, [False, True, False], [True, False, True], [True] * 3])
def test_worlds_of_the_mask_get_constants_of_their_own_masses_and_all_others_are_left_alone(mask: list[bool]) -> None:
  model = mujoco.MjModel.from_xml_string(TREE)
  scales = [1.0, 0.5, 2.0]
  m, _ = compute(model, mask, scales)
  for world, scale in enumerate(scales):
    own = mujoco.MjModel.from_xml_string(TREE)
    own.body_mass *= scale
    own.body_inertia *= scale
    mujoco.mj_setConst(own, mujoco.MjData(own))
    for name in FIELDS:
      actual = getattr(m, name).numpy()[world]
      if mask[world]:
        expected = getattr(own, name).reshape(actual.shape)
        np.testing.assert_allclose(actual, expected, rtol=2e-5, atol=2e-5, err_msg=name)
      else:
        assert (actual == UNTOUCHED).all(), name


@pytest.mark.warp
@MODELS
def test_threads_that_share_a_world_come_to_the_same_bits_as_one_alone(
  xml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
  model = mujoco.MjModel.from_xml_string(xml)
  mask = [True, False, True]
  alone, _ = compute(model, mask)
  # Each thread of a block runs until it waits for the others, so that a wait too few shows.
  monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
  together, _ = compute(model, mask)
  for name in FIELDS:
    np.testing.assert_array_equal(getattr(together, name).numpy(), getattr(alone, name).numpy(), err_msg=name)


@MODELS
def test_a_row_of_the_inertia_matrix_begins_like_the_rows_of_its_columns(xml: str) -> None:
  model = mujoco.MjModel.from_xml_string(xml)
  rows = [model.M_colind[adr : adr + nnz] for adr, nnz in zip(model.M_rowadr, model.M_rownnz, strict=True)]
  for dof, row in enumerate(rows):
    assert row[-1] == dof
    for k, column in enumerate(row):
      np.testing.assert_array_equal(rows[column], row[: k + 1])
