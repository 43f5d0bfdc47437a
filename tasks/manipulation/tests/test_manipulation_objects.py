"""Objects of many sizes, shapes, weights and surfaces, one in each world."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from manipulation_worlds import images, in_mujoco, lift, metric, room_in_sight
from mjlab_core.errors import ConfigError
from mjlab_core.rotations import random_quat
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_managers import ObservationTermCfg
from mjlab_manipulation import lift_objects, lift_objects_depth_env, lift_objects_env
from mjlab_manipulation import mdp as lifting
from mjlab_manipulation.lift import COMMAND, lift_env
from mjlab_manipulation.mdp import LiftCommand
from mjlab_manipulation.objects import OBJECTS, cube_spec
from mjlab_rl import Console, train
from mjlab_scene import EntityCfg, VariantEntity, VariantEntityCfg
from scipy import stats

_G = mujoco.mjtGeom
NAMES = tuple(OBJECTS)
EDGES = {
  "cube_30mm": (0.03, 0.03, 0.03),
  "cube_40mm": (0.04, 0.04, 0.04),
  "cube_50mm": (0.05, 0.05, 0.05),
  "brick": (0.06, 0.04, 0.03),
  "ball_40mm": (0.04, 0.04, 0.04),
  "ball_50mm": (0.05, 0.05, 0.05),
  "cylinder": (0.04, 0.04, 0.06),
  "capsule": (0.07, 0.035, 0.035),
}


def each_once(make: Callable[[], ManagerBasedRlEnvCfg] = lift_objects_env) -> ManagerBasedRlEnvCfg:
  """One world for each object, in their order."""
  cfg = make()
  entity: Any = cfg.scene.entities["object"]
  entity.assignment = NAMES
  return cfg


@pytest.fixture(scope="module")
def each() -> tuple[ManagerBasedRlEnv, LiftCommand]:
  """An environment of one world for each object, which tests put where they want them."""
  return lift(8, each_once)


def put(env: ManagerBasedRlEnv, position: Any, quat: Any = (1.0, 0.0, 0.0, 0.0), entity: str = "object") -> None:
  """Objects at rest at positions from their worlds' origins, (3,) or (num_envs, 3) [m]."""
  state = torch.zeros(env.num_envs, 13, dtype=torch.float64)
  state[:, :3] = env.scene.env_origins + torch.as_tensor(position, dtype=torch.float64)
  state[:, 3:7] = torch.as_tensor(quat, dtype=torch.float64)
  env.scene[entity].write_root_state(state)


def lowest_point(env: ManagerBasedRlEnv, world: int, geom: str) -> float:
  """By MuJoCo's own collision functions: the distance of a geom from a plane deep below."""
  spec = mujoco.MjSpec()
  model = env.sim.mj_model
  source, data = model.geom(geom), in_mujoco(env, world)
  spec.worldbody.add_geom(name="deep", type=_G.mjGEOM_PLANE, size=[0, 0, 1], pos=[0, 0, -1])
  body = spec.worldbody.add_body(pos=data.geom(geom).xpos)
  quat = np.zeros(4)
  mujoco.mju_mat2Quat(quat, data.geom(geom).xmat)
  body.quat = quat
  size = env.sim.model.geom_size[world, source.id].tolist()
  body.add_geom(name="it", type=_G(int(source.type[0])), size=size)
  alone = spec.compile()
  placed = mujoco.MjData(alone)
  mujoco.mj_forward(alone, placed)
  ids = [alone.geom(name).id for name in ("it", "deep")]
  return mujoco.mj_geomDistance(alone, placed, *ids, 10.0, None) - 1.0


def test_every_world_has_one_object_whose_size_weight_and_surface_are_its_own() -> None:
  env, term = lift(8 * 12, lift_objects_env)
  entity, model = env.scene["object"], env.sim.model
  assert isinstance(entity, VariantEntity)
  assert entity.variant.bincount().tolist() == [12] * 8
  edges = torch.tensor([EDGES[name] for name in NAMES], dtype=torch.float64)[entity.variant]
  torch.testing.assert_close(term.object_size, edges, rtol=0.0, atol=1e-9)
  body = env.sim.mj_model.body("object/object").id
  factors = []
  for world, number in enumerate(entity.variant.tolist()):
    alone = OBJECTS[NAMES[number]]().compile()
    factor = float(model.body_mass[world, body]) / alone.body_mass[1]
    # As heavy as it is, so hard it is to turn.
    moments = np.sort(model.body_inertia[world, body].numpy()) / np.sort(alone.body_inertia[1])
    np.testing.assert_allclose(moments, factor, rtol=1e-6)
    factors.append(factor)
  # A factor of e^(2 u), u uniform.
  assert stats.kstest((0.5 * np.log(factors) + 0.35) / 0.7, "uniform").pvalue > 0.01
  friction = model.geom_friction[:, entity.indexing.ids["geom"].tolist(), 0]
  assert friction.unique().numel() == 96
  assert (friction == friction[:, :1]).all()
  assert 0.5 <= float(friction.min()) <= float(friction.max()) <= 1.5


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu_a_recorded_step_draws_from_the_objects_that_were_loaded() -> None:
  def deal(shuffle: int) -> ManagerBasedRlEnv:
    cfg = lift_objects_env()
    entity, mass = cfg.scene.entities["object"], cfg.events["object_mass"]
    assert isinstance(entity, VariantEntityCfg)
    assert mass is not None
    cfg.scene.num_envs, cfg.seed, entity.seed, mass.mode = 64, 0, shuffle, "reset"
    cfg.episode_length_s = 0.1
    return ManagerBasedRlEnv(cfg, "cuda:0")

  with deal(0) as saved, deal(1) as loaded:
    still = torch.zeros(64, saved.action_manager.total_action_dim, device="cuda:0")
    for env in (saved, loaded):
      env.reset()
      for _ in range(8):
        env.step(still)
    loaded.load_state_dict(saved.state_dict())
    before = saved.sim.model.body_mass.clone()
    for env in (saved, loaded):
      # All worlds end in these.
      for _ in range(8):
        env.step(still)
      assert env.num_graphs == 1
    assert not torch.equal(saved.sim.model.body_mass, before)
    for name in saved.sim.expanded_fields:
      assert torch.equal(loaded.sim.model[name], saved.sim.model[name]), name


def test_each_begins_above_the_ground_by_as_much_whatever_its_size() -> None:
  env, term = lift(8 * 40, lift_objects_env)
  variant, drawn = env.scene["object"].variant.numpy(), []
  for _ in range(4):
    env.reset()
    drawn.append(term.object_clearance.numpy())
  for number in range(8):
    assert stats.kstest(np.array(drawn)[:, variant == number].flatten() / 0.03, "uniform").pvalue > 0.01


def test_a_run_goes_on_with_the_objects_it_had_however_they_would_be_dealt_now(tmp_path: Path) -> None:
  def run(shuffle: int, iterations: int, resume: Path | None = None) -> Path:
    task: Any = lift_objects()
    entity: Any = task.env.scene.entities["object"]
    task.env.scene.num_envs, task.env.seed, entity.seed = 8, 0, shuffle
    # Of reach in few steps.
    task.env.episode_length_s = 0.1
    # A mass that resets draw starts from that of the object which its world has.
    mass: Any = task.env.events["object_mass"]
    mass.mode = "reset"
    task.agent.num_steps_per_env, task.agent.max_iterations, task.agent.seed = 8, iterations, 0
    task.agent.algorithm.num_learning_epochs = 1
    options: dict[str, Any] = {"log_root": tmp_path / str(shuffle), "console": Console("quiet"), "resume": resume}
    checkpoint: Any = train(task, name="Lift", make_env=ManagerBasedRlEnv, **options).checkpoint
    return checkpoint

  def worlds(path: Path) -> dict[str, Any]:
    return torch.load(path, weights_only=True)["mjlab"]["env"]

  half, whole = run(0, 1), run(0, 2)
  resumed, unlike = run(1, 2, half), run(1, 1)
  variants = [worlds(path)["scene"]["entities"]["object"]["variant"] for path in (half, whole, resumed, unlike)]
  assert not torch.equal(variants[0], variants[3])
  assert torch.equal(variants[0], variants[2])
  for part in ("data", "model", "default"):
    ours, theirs = worlds(resumed)["sim"][part], worlds(whole)["sim"][part]
    assert ours.keys() == theirs.keys()
    for name, value in ours.items():
      assert torch.equal(value, theirs[name]), name


def test_the_lowest_point_is_where_mujoco_has_it_however_it_is_turned(
  each: tuple[ManagerBasedRlEnv, LiftCommand],
) -> None:
  env, term = each
  generator = torch.Generator().manual_seed(0)
  geoms = env.scene["object"].indexing.names["geom"]
  for _ in range(4):
    put(env, (0.3, 0.1, 0.2), random_quat((8,), generator=generator, dtype=torch.float64))
    expected = [lowest_point(env, world, f"object/{name}") for world, name in enumerate(geoms)]
    assert term.object_clearance.tolist() == pytest.approx(expected, abs=1e-6)


def test_only_what_a_world_has_counts_wherever_it_sits_on_its_body() -> None:
  def off_centre(kind: _G, size: float, x: float, z: float) -> Callable[[], mujoco.MjSpec]:
    def spec_fn() -> mujoco.MjSpec:
      spec = cube_spec()
      spec.geoms[0].type, spec.geoms[0].size, spec.geoms[0].pos = kind, (size,) * 3, (x, 0.0, z)
      return spec

    return spec_fn

  box, ball = off_centre(_G.mjGEOM_BOX, 0.02, 0.1, 0.1), off_centre(_G.mjGEOM_SPHERE, 0.01, 0, 0.05)
  entity = VariantEntityCfg(variants={"box": box, "ball": ball}, assignment=("box", "ball"))
  env, term = lift(2, lambda: lift_env({"object": entity}))
  # Begins as high above the ground as was drawn, which its own lowest point says.
  assert (term.object_clearance >= 0.0).all()
  assert (term.object_clearance <= 0.03).all()
  put(env, (0.3, 0.0, 0.2))
  assert term.object_clearance.tolist() == pytest.approx([0.2 + 0.08, 0.2 + 0.04])
  assert term.object_size.tolist() == [pytest.approx([0.04] * 3), pytest.approx([0.02] * 3)]


def test_a_mesh_reaches_as_far_as_the_box_about_it() -> None:
  def wedge() -> mujoco.MjSpec:
    spec = cube_spec()
    vertices = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.04, 0], [0, 0, 0.03]], dtype=float)
    spec.add_mesh(name="wedge", uservert=vertices.flatten())
    geom = spec.geoms[0]
    geom.type, geom.meshname = _G.mjGEOM_MESH, "wedge"
    return spec

  env, term = lift(3, lambda: lift_env({"cube": EntityCfg(spec_fn=wedge)}))
  model, geom = env.sim.mj_model, env.sim.mj_model.geom("cube/cube").id
  # Behind those of the robot, where it wears its meshes.
  vertices = model.mesh_vert[model.mesh_vertadr[model.geom_dataid[geom]] :]
  quat = random_quat((3,), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
  put(env, (0.3, 0.0, 0.2), quat, "cube")
  for world in range(3):
    data = in_mujoco(env, world)
    points = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    # Never higher than the mesh, and no lower than its size.
    below = points[:, 2].min() - float(term.object_clearance[world])
    assert 0.0 <= below < 0.05
  # Upright it begins on the ground or above.
  env.reset()
  for world in range(3):
    data = in_mujoco(env, world)
    assert (vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])[:, 2].min() >= -1e-9


def test_the_wrist_camera_sees_all_of_every_object_wherever_it_begins() -> None:
  env, term = lift(1, lift_objects_env)
  room = {name: room_in_sight(env, term.cfg.start, edges) for name, edges in EDGES.items()}
  assert 0.0 < min(room.values()) < 0.02, room


def test_objects_lie_still_where_they_come_to_rest(each: tuple[ManagerBasedRlEnv, LiftCommand]) -> None:
  env, term = each
  env.reset()
  for _ in range(50):
    env.step(torch.zeros(8, 7))
  assert float(term.object_clearance.abs().max()) < 1e-3
  assert float(env.scene["object"].data.root_link_lin_vel_w.abs().max()) < 1e-3
  # Each as high as half of what it is.
  heights = torch.tensor([0.5 * EDGES[name][2] for name in NAMES], dtype=torch.float64)
  torch.testing.assert_close(term.object_height, heights, rtol=0.0, atol=1e-3)


def test_stages_know_the_size_of_the_object_of_each_world(each: tuple[ManagerBasedRlEnv, LiftCommand]) -> None:
  env, _ = each
  env.reset()
  half = torch.tensor([0.5 * EDGES[name][2] for name in NAMES], dtype=torch.float64)
  for clearance, lifted, dropped in ((0.059, 0, 0), (0.061, 1, 0), (0.011, 0, 0), (0.009, 0, 1)):
    put(env, torch.stack((torch.full_like(half, 0.3), torch.zeros_like(half), clearance + half), -1))
    env.metrics_manager.compute()
    assert metric(env, "lifted").tolist() == [float(lifted)] * 8
    assert metric(env, "dropped").tolist() == [float(dropped)] * 8


def test_fingers_close_around_each_of_them_and_hold_it() -> None:
  def weightless() -> ManagerBasedRlEnvCfg:
    cfg = each_once()
    cfg.sim.gravity = (0.0, 0.0, 0.0)
    return cfg

  env, _ = lift(8, weightless)
  robot = env.scene["robot"]
  opening, closing = torch.zeros(8, 7), torch.zeros(8, 7)
  opening[:, 6], closing[:, 6] = 10.0, -10.0
  for _ in range(40):
    env.step(opening)
  # Between the fingers, which have come to rest.
  put(env, robot.data.site_pos_w[:, 1] - env.scene.env_origins, robot.data.site_quat_w[:, 1])
  grasped = torch.zeros(8)
  for _ in range(40):
    env.step(closing)
    grasped += metric(env, "grasped")
  assert (grasped >= 10.0).all(), grasped
  assert (metric(env, "finger_force") > 0.5).all()
  # Held, it stays in the hand.
  assert (metric(env, "reached") == 1.0).all()


def test_the_critic_sees_the_size_of_the_object_and_its_orientation_in_the_hand(
  each: tuple[ManagerBasedRlEnv, LiftCommand],
) -> None:
  env, _ = each
  quat = random_quat((8,), generator=torch.Generator().manual_seed(1), dtype=torch.float64)
  put(env, (0.3, 0.0, 0.2), quat)
  env.observation_manager.compute()
  critic: Any = env.get_observations()["critic"]
  for world, name in enumerate(NAMES):
    data = in_mujoco(env, world)
    frame = data.site("robot/grasp_site").xmat.reshape(3, 3).T @ data.body("object/object").xmat.reshape(3, 3)
    expected = np.concatenate([10.0 * np.array(EDGES[name]), frame[:, 0], frame[:, 1]])
    np.testing.assert_allclose(critic[world, 29:].numpy(), expected, atol=1e-5)


@pytest.mark.warp
def test_the_mask_is_of_the_shape_that_the_world_has() -> None:
  def masked() -> ManagerBasedRlEnvCfg:
    cfg = each_once(lift_objects_depth_env)
    group: Any = cfg.observations["camera"]
    group.corrupt = False
    params = {"sensor": "wrist_camera", "channels": ("object",), "command": COMMAND}
    group.terms = {"image": ObservationTermCfg(lifting.camera_image, params=params)}
    sensor: Any = cfg.scene.sensors["wrist_camera"]
    sensor.data_types = ("segmentation",)
    return cfg

  env, _ = lift(8, masked)
  put(env, (0.31, 0.0, 0.03))
  area = dict(zip(NAMES, images(env).sum((1, 2, 3)), strict=True))
  assert area["cube_30mm"] < area["cube_40mm"] < area["cube_50mm"]
  assert area["ball_40mm"] < area["cube_40mm"]
  assert area["ball_50mm"] < area["cube_50mm"]
  # Twice as long as wide.
  assert 1.5 * area["cube_30mm"] < area["capsule"] < 3.0 * area["cube_30mm"]


def test_what_cannot_be_lifted_is_refused_by_name() -> None:
  def of(**variants: Callable[[], mujoco.MjSpec] | None) -> Callable[[], ManagerBasedRlEnvCfg]:
    return lambda: lift_env({"thing": VariantEntityCfg(variants=variants)})

  with pytest.raises(ConfigError, match="'thing' has no geom in some worlds"):
    lift(2, of(cube=cube_spec, nothing=None))
  with pytest.raises(ConfigError, match="'robot' cannot be lifted"):
    lift(2, objects=("robot",))

  def two_bodies() -> mujoco.MjSpec:
    spec = cube_spec()
    handle = spec.body("cube").add_body(name="handle")
    handle.add_joint(name="hinge")
    handle.add_geom(size=[0.01, 0, 0], mass=0.01)
    return spec

  with pytest.raises(ConfigError, match="'cube' must have its geoms on one body"):
    lift(2, lambda: lift_env({"cube": EntityCfg(spec_fn=two_bodies)}))
