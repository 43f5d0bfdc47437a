"""Entities, terrain and sensors in one model."""

from pathlib import Path
from typing import Any

import mujoco
import pytest
import torch
from mjlab_core import UnknownNameError
from mjlab_scene import EntityCfg, InitialStateCfg, Scene, SceneCfg
from mjlab_sensors import BuiltinSensorCfg
from mjlab_terrain import PlaneCfg, TerrainGridCfg, WavesCfg
from scene_models import MakeWorlds

WALKER = """
<mujoco>
  <option timestep="0.004" cone="elliptic"/>
  <worldbody>
    <body name="trunk" pos="0 0 .7">
      <freejoint/>
      <geom size=".1"/>
      <site name="imu"/>
      <body name="leg"><joint name="hip" range="-1 1"/><geom size=".05" pos="0 0 -.2"/></body>
    </body>
  </worldbody>
  <compiler angle="radian"/>
  <actuator><position joint="hip" kp="10"/></actuator>
  <sensor><gyro name="gyro" site="imu"/><accelerometer site="imu"/></sensor>
  <keyframe><key name="home" qpos="0 0 .4 0 0 0 1 .3" qvel="1 0 0 0 0 2 .5" ctrl=".6"/><key name="sit"/></keyframe>
</mujoco>
"""
ARM = """
<mujoco>
  <worldbody>
    <frame euler="0 0 30"><body name="post"><joint name="yaw"/><geom size=".1"/>
      <frame pos="0 0 .2"><body name="link"><joint name="ball" type="ball"/><geom size=".1"/></body></frame>
      <joint name="lift" type="slide"/></body></frame>
  </worldbody>
  <keyframe><key qpos=".1 .2 0 1 0 0"/></keyframe>
</mujoco>
"""
GOAL = '<mujoco><worldbody><body name="goal" mocap="true" pos="0 0 2"><site name="g"/></body></worldbody></mujoco>'


def entity(text: str, **start: Any) -> EntityCfg:
  return EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string(text), init_state=InitialStateCfg(**start))


def three(num_envs: int = 3, **kwargs: Any) -> SceneCfg:
  return SceneCfg(
    num_envs=num_envs,
    terrain=PlaneCfg(),
    entities={
      "robot": entity(WALKER, joint_pos=None),
      "arm": entity(ARM, joint_pos=None, pos=(0.0, 1.0, 0.0)),
      "goal": entity(GOAL, pos=(0.5, 0.0, 2.0)),
      "twin": entity(WALKER, joint_pos={"hip": -0.2}, pos=(0.0, 0.0, 0.9)),
    },
    **kwargs,
  )


# Keyframes


def test_each_robot_takes_the_keyframe_of_its_model(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(cfg=three())
  robot, arm, twin = (scene[name].data for name in ("robot", "arm", "twin"))
  assert robot.default_joint_pos.tolist() == [[0.3]]
  assert robot.default_joint_vel.tolist() == [[0.5]]
  assert robot.default_root_state[0, :10].tolist() == [0, 0, 0.4, 0, 0, 0, 1, 1, 0, 0]
  assert arm.default_joint_pos.tolist() == [[0.1, 0.2, 0, 1, 0, 0]]
  assert arm.default_root_state.tolist() == [[0, 1, 0, 1, 0, 0, 0]]
  assert twin.default_joint_pos.tolist() == [[-0.2]]
  assert twin.default_root_state[0, :7].tolist() == [0, 0, 0.9, 1, 0, 0, 0]


def test_the_scene_has_one_keyframe_that_puts_every_entity_at_its_default(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(cfg=three(num_envs=1))
  model = scene.compile()
  assert [model.key(i).name for i in range(model.nkey)] == ["init_state"]
  key = model.key("init_state")
  assert sim.data.qpos[0].tolist() == pytest.approx(key.qpos)
  assert sim.data.qvel[0].tolist() == pytest.approx(key.qvel)
  assert sim.data.mocap_pos[0].reshape(-1).tolist() == pytest.approx(key.mpos.ravel())
  assert sim.data.mocap_quat[0].reshape(-1).tolist() == pytest.approx(key.mquat.ravel())
  # A keyframe's own controls; without one, a servo's joint position.
  assert key.ctrl.tolist() == [0.6, -0.2]


def test_initial_velocity_of_the_keyframe_turns_with_the_base(make_worlds: MakeWorlds) -> None:
  text = '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
  start = {"rot": (0.5, 0.5, 0.5, 0.5), "ang_vel": (0.1, 0.2, 0.3)}
  scene, sim = make_worlds(cfg=SceneCfg(entities={"robot": entity(text, **start)}))
  assert scene.compile().key("init_state").qvel[3:].tolist() == pytest.approx([0.2, 0.3, 0.1])
  torch.testing.assert_close(scene["robot"].data.root_link_ang_vel_w[0], torch.tensor([0.1, 0.2, 0.3]).to(sim.dtype))


@pytest.mark.parametrize("root", ["<freejoint/>", ""], ids=["floating", "fixed"])
def test_an_entity_with_mesh_files_stands_on_ground_that_is_coloured_by_a_picture(tmp_path: Path, root: str) -> None:
  file = tmp_path / "corner.obj"
  file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
  xml = f"""<mujoco><asset><mesh name="corner" file="{file}"/></asset><worldbody>
    <body name="it">{root}<geom type="mesh" mesh="corner"/></body></worldbody></mujoco>"""
  ground = TerrainGridCfg(types={"waves": WavesCfg()}, rows=1, columns=1, difficulty=(1.0, 1.0))
  scene = Scene(SceneCfg(num_envs=1, terrain=ground, entities={"it": entity(xml)}))
  assert scene.spec.assets
  model = scene.spec.compile()
  assert (model.nmesh, model.nhfield) == (1, 1)


# Placement


def test_every_base_is_placed_at_the_origin_of_its_world(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(cfg=three(num_envs=5, env_spacing=3.0))
  assert scene.env_origins.shape == (5, 3)
  assert len({tuple(row) for row in scene.env_origins.tolist()}) == 5
  for name in ("robot", "arm", "goal", "twin"):
    offset = scene[name].data.root_link_pos_w - scene[name].data.default_root_state[:, :3]
    torch.testing.assert_close(offset, scene.env_origins)
  sim.step()
  post = scene["arm"].data.body_link_pos_w[:, 1] - scene.env_origins
  torch.testing.assert_close(post[:, :2], torch.tensor([[0.0, 1.0]] * 5).to(sim.dtype))


def test_origins_are_spaced_without_a_terrain_too(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(cfg=SceneCfg(num_envs=4, env_spacing=2.5, entities={"goal": entity(GOAL)}))
  distance = torch.cdist(scene.env_origins, scene.env_origins) + 100 * torch.eye(4)
  assert distance.min() == pytest.approx(2.5)


def test_a_reset_keeps_bases_in_place_and_leaves_other_worlds_bit_identical(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(cfg=three())
  for _ in range(3):
    scene.write_ctrl()
    sim.step()
    scene.update(sim.timestep)
  names = ("qpos", "qvel", "mocap_pos", "mocap_quat", "ctrl", "sensordata")
  before = {name: getattr(sim.data, name).clone() for name in names}
  mask = torch.tensor([True, False, False])
  sim.reset(mask)
  scene.reset(mask)
  scene.write_default_state(mask)
  for name in names:
    assert torch.equal(getattr(sim.data, name)[1:], before[name][1:]), name
  assert torch.equal(sim.data.mocap_pos[0], before["mocap_pos"][0])
  assert scene["robot"].data.joint_pos[0].item() == 0.3


# Options


def test_options_of_an_entity_become_the_scenes_without_a_warning(capfd: pytest.CaptureFixture[str]) -> None:
  model = Scene(three()).compile()
  assert model.opt.timestep == 0.004
  assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
  assert capfd.readouterr() == ("", "")


def test_entities_that_disagree_on_an_option_are_both_named() -> None:
  other = WALKER.replace("0.004", "0.001")
  message = "option 'timestep': entity 'b' says 0.001 and entity 'a' says 0.004"
  with pytest.raises(ValueError, match=message):
    Scene(SceneCfg(entities={"a": entity(WALKER), "b": entity(other)}))


# Sensors


def test_sensors_of_a_model_are_wrapped_named_or_not(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(cfg=three())
  assert list(scene.sensors) == ["robot/gyro", "robot/accelerometer_imu", "twin/gyro", "twin/accelerometer_imu"]
  sim.data.qvel[:, 3:6] = 1.5
  assert (scene["robot/gyro"].data == 1.5).all()


def test_a_configured_sensor_claims_the_element_it_wraps(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(cfg=three(sensors={"gyro": BuiltinSensorCfg(element="robot/gyro")}))
  assert "robot/gyro" not in scene
  assert scene["gyro"].data.shape == (3, 3)


def test_duplicate_names_of_parts_are_refused() -> None:
  gyro = BuiltinSensorCfg(element="robot/gyro")
  with pytest.raises(ValueError, match="'robot' names two parts"):
    Scene(three(sensors={"robot": gyro}))
  with pytest.raises(ValueError, match="'terrain' names two parts"):
    Scene(three(sensors={"terrain": gyro}))
  with pytest.raises(ValueError, match="'twin/gyro' exists already"):
    Scene(three(sensors={"twin/gyro": gyro}))


# Access


def test_the_error_for_an_unknown_name_has_the_nearest() -> None:
  scene = Scene(three())
  assert scene["robot"] is scene.entities["robot"]
  assert scene["terrain"] is scene.terrain
  with pytest.raises(UnknownNameError, match=r"scene: entity or sensor 'robt' does not exist. Nearest: robot"):
    scene["robt"]


def test_reading_an_entity_before_its_scene_is_initialized_is_refused() -> None:
  with pytest.raises(RuntimeError, match="initialize its scene first"):
    _ = Scene(three())["robot"].data


def test_building_leaves_the_configuration_as_it_is_so_that_scenes_can_share_it() -> None:
  cfg = three()
  before = repr(cfg)
  first, second = Scene(cfg), Scene(cfg)
  assert repr(cfg) == before
  assert first.compile().nq == second.compile().nq


def test_the_last_edit_and_the_extent_reach_the_model() -> None:
  cfg = SceneCfg(extent=7.0, spec_fn=lambda spec: spec.worldbody.add_site(name="mark"), entities={"a": entity(GOAL)})
  model = Scene(cfg).compile()
  assert model.stat.extent == 7.0
  assert model.site("mark").id >= 0


@pytest.mark.parametrize(
  ("options", "message"),
  [
    ({"num_envs": 2.5}, "scene: num_envs must be a whole number, got 2.5"),
    ({"extent": 0.0}, "scene: extent must be positive, got 0.0"),
    ({"extent": float("nan")}, "scene: extent must be a number, got nan"),
  ],
)
def test_numbers_that_cannot_be_are_refused_by_name(options: dict[str, Any], message: str) -> None:
  with pytest.raises(ValueError, match=message):
    Scene(SceneCfg(**options))


# State


def test_a_restored_scene_goes_on_as_the_saved_one(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(cfg=three())
  robot = scene["robot"]
  robot.set_joint_position_target(torch.full((3, 1), 0.7, dtype=torch.float64))
  robot.data.encoder_bias.fill_(0.01)
  saved = scene.state_dict()
  scene.reset(torch.ones(3, dtype=torch.bool))
  robot.data.encoder_bias.zero_()
  scene.load_state_dict(saved)
  assert (robot.data.joint_pos_target == 0.7).all()
  assert (robot.data.encoder_bias == 0.01).all()


def test_constants_of_a_single_world_are_not_taken_for_state(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(cfg=three(num_envs=1))
  for entity_state in scene.state_dict()["entities"].values():
    assert set(entity_state["data"]) == {"encoder_bias"}
    assert set(entity_state["actuation"]) == {"position", "velocity", "effort"}
