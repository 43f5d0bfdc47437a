"""What an entity makes of a model and a configuration, and what it refuses."""

from typing import Any

import mujoco
import pytest
from mjlab_actuators import XmlActuatorCfg
from mjlab_core.errors import MjlabError, UnknownNameError
from mjlab_scene import CollisionCfg, Entity, EntityArticulationCfg, EntityCfg, InitialStateCfg
from scene_models import entity

ARM = """
<mujoco>
  <worldbody>
    <geom name="table" size=".1"/>
    <body name="left/arm">
      <joint name="left/elbow" range="-90 90"/>
      <geom name="left_collision" size=".1"/>
    </body>
    <body name="right/arm">
      <joint name="right/elbow" range="-90 90"/>
      <geom name="right_collision" size=".1"/>
      <geom name="right_foot" size=".1"/>
    </body>
  </worldbody>
  <actuator><position joint="left/elbow" kp="1"/><motor joint="right/elbow"/></actuator>
</mujoco>
"""

NECK = '<mujoco><worldbody><body><joint name="neck" type="ball"/><geom size=".1"/></body></worldbody></mujoco>'


def build(text: str = ARM, name: str = "robot", **kwargs: Any) -> Entity:
  return entity(text, **kwargs).build(name)


def geom(entity: Entity, name: str) -> mujoco.MjsGeom:
  return entity.spec.geom(name)


# Names


def test_elements_are_addressed_by_their_full_path() -> None:
  entity = build()
  assert entity.joint_names == ("left/elbow", "right/elbow")
  assert entity.find_joints("right/elbow") == ([1], ["right/elbow"])
  with pytest.raises(UnknownNameError, match=r"entity 'robot': pattern 'left/elbw' matches no joint. Nearest: left/el"):
    entity.find_joints("left/elbw")
  assert entity.find_joints([r"right/.*", r"left/.*"], preserve_order=True)[1] == ["right/elbow", "left/elbow"]


def test_unnamed_elements_are_named_so_that_they_can_be_addressed() -> None:
  text = """
  <mujoco><worldbody><body name="base"><freejoint/><geom size=".1"/><geom size=".2"/><site/>
    <body><joint/><geom size=".1"/></body></body></worldbody>
    <sensor><gyro site="base_site"/><gyro site="base_site"/></sensor></mujoco>
  """.replace("<site/>", '<site name="base_site"/>')
  entity = build(text)
  assert entity.geom_names == ("base_geom", "base_geom_2", "base_body_geom")
  assert entity.joint_names == ("base_body_joint",)
  assert [sensor.name for sensor in entity.spec.sensors] == ["gyro_base_site", "gyro_base_site_2"]
  assert entity.spec.joints[0].name == "floating_base_joint"


@pytest.mark.parametrize("name", ["", "a/b"])
def test_an_entity_needs_a_plain_name(name: str) -> None:
  with pytest.raises(ValueError, match="must be a word"):
    build(name=name)


# Bases


def test_a_free_joint_need_not_come_first() -> None:
  text = """
  <mujoco><worldbody><body name="stand"><joint name="crank"/><geom size=".1"/></body>
    <body name="trunk"><freejoint name="root"/><geom size=".1"/></body></worldbody></mujoco>
  """
  entity = build(text)
  assert entity.is_floating
  assert entity.root_body_name == "trunk"
  assert entity.joint_names == ("crank",)


def test_a_fixed_base_hangs_below_a_mocap_body_and_a_mocap_root_does_not() -> None:
  assert build().body_names == ("mocap_base", "left/arm", "right/arm")
  mocap = build('<mujoco><worldbody><body name="goal" mocap="true"><geom size=".1"/></body></worldbody></mujoco>')
  assert mocap.is_mocap
  assert mocap.body_names == ("goal",)


def test_an_entity_of_world_geoms_alone_is_a_fixture() -> None:
  entity = build('<mujoco><worldbody><geom name="slab" size=".1"/></worldbody></mujoco>')
  assert entity.body_names == ("mocap_base",)
  assert not entity.is_articulated


# Initial state


def test_a_quaternion_is_normalised() -> None:
  pose = build(init_state=InitialStateCfg(rot=(2.0, 0.0, 0.0, 0.0))).initial_state.root_pose
  assert pose.tolist() == [0, 0, 0, 1, 0, 0, 0]


def test_a_ball_joint_takes_a_quaternion() -> None:
  entity = build(NECK, init_state=InitialStateCfg(joint_pos={"neck": (0.0, 0.0, 0.0, 3.0)}))
  assert entity.initial_state.joint_pos["neck"].tolist() == [0, 0, 0, 1]
  assert build(NECK).initial_state.joint_pos["neck"].tolist() == [1, 0, 0, 0]


def test_a_joint_without_a_pattern_keeps_the_models_reference() -> None:
  text = '<mujoco><worldbody><body><joint name="j" ref="90"/><geom size=".1"/></body></worldbody></mujoco>'
  assert build(text).initial_state.joint_pos["j"][0] == pytest.approx(1.5707963)


def test_the_root_of_a_floating_base_starts_where_the_model_puts_it() -> None:
  text = """
  <mujoco><worldbody><frame pos="1 0 0" euler="0 0 90"><body name="a" pos="0 0 .5" euler="0 0 90">
    <freejoint/><geom size=".1"/></body></frame></worldbody></mujoco>
  """
  pose = build(text).initial_state.root_pose
  spec = mujoco.MjSpec.from_string(text)
  assert pose == pytest.approx(spec.compile().qpos0)


# Contact presets


def test_a_preset_sets_matching_geoms_and_switches_the_rest_off() -> None:
  preset = CollisionCfg(
    geom_names_expr=".*_collision", condim={"left_.*": 4, "right_.*": 1}, friction=(0.6,), solref=(0.01, 1.0)
  )
  entity = build(collisions=(preset,))
  left, right, foot = (geom(entity, name) for name in ("left_collision", "right_collision", "right_foot"))
  assert (left.condim, right.condim) == (4, 1)
  assert list(left.friction) == [0.6, 0.005, 0.0001]
  assert (left.contype, foot.contype, foot.conaffinity) == (1, 0, 0)


def test_a_specific_pattern_overrides_the_one_for_all() -> None:
  condim = {".*": 3, "left_.*": 4}
  entity = build(collisions=(CollisionCfg(geom_names_expr=".*_collision", condim=condim),))
  assert [geom(entity, f"{side}_collision").condim for side in ("left", "right")] == [4, 3]


def test_presets_compose_and_none_disables_the_geoms_of_another() -> None:
  one, two = (CollisionCfg(geom_names_expr=(name,)) for name in ("left_collision", "right_collision"))
  entity = build(collisions=(one, two))
  assert [geom(entity, name).contype for name in entity.geom_names] == [0, 1, 1, 0]


def start(**fields: Any) -> dict[str, Any]:
  return {"init_state": InitialStateCfg(**fields)}


def preset(names: str | tuple[str, ...], **fields: Any) -> dict[str, Any]:
  return {"collisions": (CollisionCfg(geom_names_expr=names, **fields),)}


TWO_BASES = """
<mujoco><worldbody><body name="a"><freejoint/><geom size=".1"/></body>
  <body name="b"><freejoint/><geom size=".1"/></body></worldbody></mujoco>
"""


@pytest.mark.parametrize(
  ("text", "fields", "message"),
  [
    (TWO_BASES, {}, "at most one free joint, and bodies 'a', 'b'"),
    (ARM, start(joint_pos={"left/elbo": 0.1}), "pattern 'left/elbo' matches no joint"),
    (ARM, start(joint_vel={"lef.*w?t": 0.1}), "pattern .* matches no joint"),
    (ARM, start(ctrl={"x": 1.0}), "pattern 'x' matches no"),
    # A pattern must match the whole name.
    (ARM, start(joint_pos={"left": 0.1}), "'left' matches no joint"),
    (ARM, start(joint_pos={"left/elbow": 2.0}), r"position 2 of joint 'left/elbow' is outside \[-1.5708, 1.5708\]"),
    (ARM, start(lin_vel=(1.0, 0.0, 0.0)), "need a floating base"),
    (ARM, start(rot=(0.0, 0.0, 0.0, 0.0)), "rot: the quaternion"),
    (NECK, start(joint_pos={"neck": 0.5}), "joint_pos of 'neck': 0.5 must be a quaternion"),
    (ARM, start(joint_pos=None), "takes the model's keyframe, but the model has none"),
    *(
      (ARM, {"articulation": EntityArticulationCfg(soft_joint_pos_limit_factor=factor)}, r"factor must be in \(0, 1\]")
      for factor in (0.0, 1.5, -1.0)
    ),
    (ARM, preset((".*_collision", "foot_.*")), "pattern 'foot_.*' matches no geom"),
    (ARM, preset(".*_collision", condim={"lft": 1}), "condim: pattern 'lft' matches no geom"),
    (ARM, preset("left_collision", condim=0), ".* 'left_collision': condim must be"),
    (ARM, preset("left_collision", contype=-1), ".* 'left_collision': contype must not be negative, got -1"),
    (ARM, preset("left_collision", solmix=1.5), r".* 'left_collision': solmix must be in \[0, 1\]"),
    (ARM, preset("left_collision", friction=(1.0,) * 4), ".* 'left_collision': friction must have at most 3 elements"),
    (ARM, preset("left_collision", friction=(-1.0,)), ".* 'left_collision': friction must not be negative, got"),
  ],
)
def test_impossible_entities_are_refused_by_name(text: str, fields: dict[str, Any], message: str) -> None:
  with pytest.raises(MjlabError, match=f"entity 'robot'.*{message}"):
    build(text, **fields)


def test_an_mjcf_that_mujoco_refuses_is_named_with_its_entity() -> None:
  with pytest.raises(ValueError, match=r"entity 'robot': its model cannot be made: .*unrecognized"):
    EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string("<mujoco><bdy/></mujoco>")).build("robot")
  with pytest.raises(ValueError, match=r"entity 'robot': its model cannot be made: .*nowhere\.xml"):
    EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_file("nowhere.xml")).build("robot")


@pytest.mark.parametrize("spec_fn", ["robot.xml", lambda: None, mujoco.MjSpec()])
def test_a_spec_fn_that_returns_no_spec_is_refused_by_name(spec_fn: Any) -> None:
  with pytest.raises(ValueError, match="entity 'robot': spec_fn must be a function that returns an MjSpec"):
    Entity(EntityCfg(spec_fn=spec_fn), "robot")


KINDS = """
<mujoco>
  <asset><material name="paint"/></asset>
  <worldbody>
    <body name="arm">
      <joint name="elbow"/><geom name="hull" size=".1"/><site name="tip"/><camera name="eye"/><light name="lamp"/>
    </body>
  </worldbody>
  <tendon><fixed name="rope"><joint joint="elbow" coef="1"/></fixed></tendon>
  <actuator><motor name="push" joint="elbow"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(
  ("kind", "kinds", "name"),
  [
    ("body", "bodies", "arm"),
    ("joint", "joints", "elbow"),
    ("geom", "geoms", "hull"),
    ("site", "sites", "tip"),
    ("tendon", "tendons", "rope"),
    ("actuator", "actuators", "push"),
    ("camera", "cameras", "eye"),
    ("light", "lights", "lamp"),
    ("material", "materials", "paint"),
  ],
)
def test_parts_of_every_kind_are_found_by_name(kind: str, kinds: str, name: str) -> None:
  entity = build(KINDS)
  names = getattr(entity, f"{kind}_names")
  assert getattr(entity, f"find_{kinds}")(name) == ([names.index(name)], [name])
  with pytest.raises(ValueError, match=f"{kind}.*{name}"):
    getattr(entity, f"find_{kinds}")(name + "x")


def test_an_entity_is_actuated_where_actuators_are_configured() -> None:
  driven = EntityArticulationCfg(actuators=(XmlActuatorCfg(target_names_expr=("elbow",)),))
  assert build(KINDS, articulation=driven).is_actuated
  assert not build(KINDS).is_actuated
