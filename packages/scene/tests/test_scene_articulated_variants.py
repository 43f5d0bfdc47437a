"""Robots and drawers that differ between worlds, against models of each that are compiled alone."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_actuators import IdealPdActuatorCfg, NativePositionActuatorCfg
from mjlab_core.errors import MjlabError
from mjlab_scene import EntityArticulationCfg, EntityCfg, InitialStateCfg, Scene, SceneCfg, VariantEntityCfg
from mjlab_sim import Simulation
from mjlab_terrain import PlaneCfg
from scene_models import MakeWorlds, entity

# Boxes and meshes collide with the ground only: between them, collisions take long to compile.
ROUND, FLAT = '<default><geom contype="3" conaffinity="2"/></default>', 'contype="1" conaffinity="0"'
WEDGE = '<asset><mesh name="m" vertex="0 0 0 .2 0 0 0 .15 0 .2 .15 0 0 0 .1 0 .15 .1"/></asset>'
ROBOTS = {
  "short": f"""<mujoco>{ROUND}{WEDGE}<worldbody><body name="base"><freejoint/>
    <geom name="trunk" type="mesh" mesh="m" mass="2" {FLAT}/>
    <frame pos="0 0.02 0" euler="10 0 20"><body name="upper" pos=".1 0 -.05">
      <joint name="shoulder" axis="0 1 0" range="-40 40" damping=".2" armature=".01"/>
      <geom name="bone" type="capsule" size=".03" fromto="0 0 0 .2 0 0" mass=".4"/>
      <body name="hand" pos=".2 0 0"><geom name="ball" size=".05" friction=".5" mass=".2"/>
        <site name="tip" pos=".1 0 0"/>
      </body></body></frame></body></worldbody></mujoco>""",
  "long": f"""<mujoco>{ROUND}<compiler angle="radian"/><worldbody><body name="base"><freejoint/>
    <geom name="trunk" type="box" size=".1 .1 .05" mass="3" {FLAT}/>
    <body name="upper" pos=".1 0 0">
      <joint name="shoulder" axis="0 .8 .6" pos="0 0 .01" damping=".1" frictionloss=".05"/>
      <geom name="bone" type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass=".6"/>
      <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0" range="-.5 1" stiffness="2" armature=".02"/>
        <geom name="rod" type="capsule" size=".02" fromto="0 0 0 .2 0 0" mass=".3"/>
        <body name="hand" pos=".2 0 0"><site name="tip" pos="0 0 .05"/>
          <geom name="pad" type="box" size=".03 .03 .03" {FLAT}/>
      </body></body></body></body></worldbody></mujoco>""",
}
# The hand of the one is on the upper arm, that of the other on the forearm: give each a name of its own.
ROBOTS["long"] = ROBOTS["long"].replace('"hand"', '"gripper"').replace('"tip"', '"grip"')
START = InitialStateCfg(pos=(0.0, 0.0, 0.25), rot=(0.98, 0.1, 0.1, 0.14), joint_pos={"shoulder": 0.2})


def spec(xml: str) -> Callable[[], mujoco.MjSpec]:
  return lambda: mujoco.MjSpec.from_string(xml)


def motors(joints: tuple[str, ...]) -> EntityArticulationCfg:
  """A native servo on the shoulder, PD in torch on all other joints."""
  servo = NativePositionActuatorCfg(target_names_expr=("shoulder",), stiffness=8.0, damping=0.3, effort_limit=5.0)
  others = IdealPdActuatorCfg(target_names_expr=joints, stiffness=4.0, damping=0.1)
  return EntityArticulationCfg(actuators=(servo, others) if joints else (servo,))


@pytest.fixture
def make(make_worlds: MakeWorlds) -> MakeWorlds:
  def build(entity: EntityCfg, num_envs: int = 1, engine: str = "native") -> tuple[Scene, Simulation]:
    cfg = SceneCfg(num_envs=num_envs, terrain=PlaneCfg(), entities={"robot": entity}, env_spacing=0.0)
    return make_worlds(engine=engine, cfg=cfg, sizes={"nconmax": 32, "njmax": 160})

  return build


def robots(**changes: Any) -> VariantEntityCfg:
  fields: dict[str, Any] = {
    "variants": {name: spec(xml) for name, xml in ROBOTS.items()},
    "assignment": ("long", "short", "long"),
    "init_state": START,
    "articulation": motors(("elbow",)),
  }
  return VariantEntityCfg(**(fields | changes))


def drive(scene: Scene, sim: Simulation, steps: int) -> None:
  robot = scene["robot"]
  for step in range(steps):
    joints = robot.data.joint_pos_target
    robot.set_joint_position_target(torch.full_like(joints, 0.4 if step % 100 < 50 else -0.3))
    scene.write_ctrl()
    sim.step()


def test_each_world_has_the_constants_of_its_robot(make: MakeWorlds) -> None:
  scene, sim = make(robots(), 3)
  robot = scene["robot"]
  assert robot.joint_names == ("shoulder", "elbow")
  assert robot.body_names == ("base", "upper", "hand", "fore", "gripper")
  assert robot.site_names == ("tip", "grip")
  assert robot.joint_is_there.tolist() == [[True, True], [True, False], [True, True]]
  for world, name in enumerate(("long", "short")):
    alone = spec(ROBOTS[name])().compile()
    engine: Any = sim._engine
    model = engine._batch.get_model(world)
    assert model.body_subtreemass[0] == pytest.approx(alone.body_subtreemass[0])
    for index in range(1, alone.nbody):
      here = model.body(f"robot/{alone.body(index).name}")
      np.testing.assert_allclose(model.body_invweight0[here.id], alone.body_invweight0[index], rtol=1e-9)
      np.testing.assert_allclose(here.ipos, alone.body_ipos[index], atol=1e-12)
    for index in range(1, alone.njnt):
      here, there = model.joint(f"robot/{alone.joint(index).name}"), alone.joint(index)
      for field in ("axis", "pos", "stiffness", "qpos0"):
        np.testing.assert_allclose(getattr(here, field), getattr(there, field), atol=1e-12, err_msg=field)
    for index in range(alone.ngeom):
      here = model.geom(f"robot/{name}/{alone.geom(index).name}")
      assert model.body(int(here.bodyid[0])).name == f"robot/{alone.body(alone.geom_bodyid[index]).name}"
      for field in ("geom_size", "geom_pos", "geom_quat", "geom_friction"):
        np.testing.assert_allclose(getattr(model, field)[here.id], getattr(alone, field)[index], atol=1e-9)


def test_each_robot_moves_as_it_would_alone_and_joints_that_it_lacks_rest(make: MakeWorlds) -> None:
  scene, sim = make(robots(), 3)
  drive(scene, sim, 300)
  assert torch.equal(sim.data.qpos[0], sim.data.qpos[2])
  for world, (name, joints) in enumerate((("long", ("elbow",)), ("short", ()))):
    alone, own = make(entity(ROBOTS[name], init_state=START, articulation=motors(joints)))
    drive(alone, own, 300)
    columns = own.data.qpos.shape[1]
    torch.testing.assert_close(sim.data.qpos[world, :columns], own.data.qpos[0], rtol=0.0, atol=1e-5)
    assert (own.data.qpos[0, 7:] - 0.2).abs().max() > 0.05
  assert sim.data.qpos[1, 8].abs() < 1e-3


def test_drawers_of_different_lengths_have_different_limits(make: MakeWorlds) -> None:
  def drawer(depth: float) -> Callable[[], mujoco.MjSpec]:
    return spec(
      f"""<mujoco><worldbody><body name="cabinet" pos="0 0 .5"><geom name="case" type="box" size="{depth} .3 .4"/>
      <body name="drawer"><joint name="slide" type="slide" axis="1 0 0" range="0 {depth}" damping="2"/>
      <geom name="box" type="box" size="{depth / 2} .2 .1" contype="0" conaffinity="0"/></body></body></worldbody>
      </mujoco>"""
    )

  depths = {"shallow": 0.2, "deep": 0.5}
  cfg = VariantEntityCfg(variants={name: drawer(d) for name, d in depths.items()}, assignment=("shallow", "deep"))
  scene, sim = make(cfg, 2)
  data = scene["robot"].data
  np.testing.assert_allclose(data.joint_pos_limits[:, 0, 1], list(depths.values()))
  for _ in range(1500):
    sim.data.qfrc_applied[:, 0] = 20.0
    sim.step()
  np.testing.assert_allclose(data.joint_pos[:, 0], list(depths.values()), atol=0.01)
  assert scene["robot"].geom_is_there.tolist() == [[True, False, True, False], [False, True, False, True]]


@pytest.mark.warp
def test_engines_agree_on_worlds_with_different_robots(make: MakeWorlds) -> None:
  both = [make(robots(), 3, engine) for engine in ("native", "warp")]
  for scene, sim in both:
    drive(scene, sim, 60)
  native, warp = (sim.data.qpos.double() for _, sim in both)
  torch.testing.assert_close(warp, native, rtol=0.0, atol=5e-3)


def test_the_assignment_is_part_of_the_saved_state(make: MakeWorlds) -> None:
  scene, sim = make(robots(), 3)
  saved = scene.state_dict(), sim.state_dict()
  other, theirs = make(robots(assignment=("short", "long", "short")), 3)
  other.load_state_dict(saved[0])
  theirs.load_state_dict(saved[1])
  assert other["robot"].joint_is_there.tolist() == scene["robot"].joint_is_there.tolist()
  for one in ((scene, sim), (other, theirs)):
    drive(*one, 50)
  assert torch.equal(sim.data.qpos, theirs.data.qpos)


@pytest.mark.parametrize(
  ("old", "new", "message"),
  [
    (
      'name="shoulder" axis',
      'name="shoulder" type="slide" axis',
      "variant 'long': joints of body 'upper' are 'shoulder'",
    ),
    ("<freejoint/>", "", "variant 'long' has no free joint, but others have"),
    ('name="base"', 'name="trunk"', "variant 'long': its body on top is 'trunk', that of another variant is 'base'"),
    ('name="grip"', 'name="tip"', "variant 'long': site 'tip' is on another body than in another variant"),
    (
      "</worldbody>",
      '</worldbody><actuator><motor name="drive" joint="elbow"/></actuator>',
      "variant 'long': actuator 'drive' cannot be part of a variant; configure actuators in",
    ),
  ],
)
def test_variants_that_differ_in_shared_parts_are_refused(old: str, new: str, message: str) -> None:
  changed = {"short": spec(ROBOTS["short"]), "long": spec(ROBOTS["long"].replace(old, new, 1))}
  with pytest.raises(MjlabError, match=message):
    robots(variants=changed).build("robot")


def test_only_rigid_objects_can_be_absent() -> None:
  with pytest.raises(MjlabError, match="variant 'none' is None, but others have joints"):
    robots(variants={"short": spec(ROBOTS["short"]), "none": None}).build("robot")
