"""Terms about power, mounted sensors, touch, and tiles of a terrain, against NumPy."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from envs_hopper import HOPPER, Make, actions, hopper_cfg
from mjlab_core.errors import ConfigError
from mjlab_envs import mdp
from mjlab_managers import (
  EventTermCfg,
  MetricsTermCfg,
  ObservationTermCfg,
  RewardTermCfg,
  SceneEntityCfg,
  TerminationTermCfg,
)
from mjlab_sensors import BuiltinSensorCfg, ContactMatch, ContactSensorCfg, ImuSensorCfg, ObjRef
from mjlab_terrain import FlatPatchCfg, TerrainGridCfg
from mjlab_terrain.types.heights import RandomRoughCfg
from scipy.spatial.transform import Rotation


def test_only_power_that_actuators_put_in_counts(make: Make) -> None:
  cfg = hopper_cfg()
  both = {"asset": SceneEntityCfg("robot", joint_names=(".*",))}
  cfg.rewards["power"] = RewardTermCfg(mdp.electrical_power_cost, weight=-1.0, params=both)
  env = make(cfg)
  signs = set()
  for number in range(20):
    env.step(3.0 * actions(env, number))
    power = (env.sim.data.qfrc_actuator[:, 6:] * env.sim.data.qvel[:, 6:]).double().numpy()
    value = env.reward_manager.term("power")()
    np.testing.assert_allclose(value.double().numpy(), np.maximum(power, 0.0).sum(1), rtol=1e-5, atol=1e-6)
    signs |= set(np.sign(power).ravel())
  assert {-1.0, 1.0} <= signs


def test_gravity_is_seen_in_the_axes_of_the_sensor(make: Make, engine: str) -> None:
  cfg = hopper_cfg(engine=engine)
  tilted = HOPPER.replace('<site name="imu"/>', '<site name="imu" euler="0.3 0.4 0.5"/>')
  cfg.scene.entities["robot"].spec_fn = lambda: mujoco.MjSpec.from_string(tilted)
  site = ObjRef(type="site", name="imu", entity="robot")
  cfg.scene.sensors["up"] = BuiltinSensorCfg(sensor_type="framezaxis", obj=ObjRef(type="xbody", name="world"), ref=site)
  cfg.scene.sensors["imu"] = ImuSensorCfg(site=site)
  for name in ("up", "imu"):
    term = ObservationTermCfg(mdp.projected_gravity_from_sensor, params={"sensor": name})
    cfg.observations["critic"].terms[name] = term
  env = make(cfg)
  observations = env.reset()[0]["critic"]
  for number in range(3):
    observations = env.step(actions(env, number))[0]["critic"]
  site_id = env.sim.mj_model.site("robot/imu").id
  turned = Rotation.from_matrix(env.sim.data.site_xmat[:, site_id].double().cpu().numpy().reshape(-1, 3, 3))
  expected = turned.inv().apply([0.0, 0.0, -1.0])
  seen = observations.double().cpu().numpy()
  np.testing.assert_allclose(seen[:, -6:-3], expected, atol=1e-5)
  np.testing.assert_allclose(seen[:, -3:], expected, atol=1e-5)


def test_substeps_with_a_strong_contact_are_counted_once() -> None:
  history = torch.zeros(2, 3, 4, 3)
  history[0, :, 1, 2] = 11.0
  history[0, 0, 3] = 6.0
  history[1, 2, :, 0] = 9.0
  env: Any = SimpleNamespace(scene={"touch": SimpleNamespace(data=SimpleNamespace(force_history=history))})
  assert mdp.contact_count(env, sensor="touch").tolist() == [2.0, 0.0]
  assert mdp.illegal_contact(env, sensor="touch").tolist() == [True, False]


def test_any_contact_counts_without_a_threshold_and_without_a_history(make: Make) -> None:
  cfg = hopper_cfg(events={"reset": EventTermCfg(mdp.reset_scene_to_default, mode="reset")})
  cfg.scene.sensors["touch"] = ContactSensorCfg(
    primary=ContactMatch(mode="geom", pattern=("foot", "trunk"), entity="robot"), fields=("found",)
  )
  params = {"sensor": "touch", "threshold": None}
  cfg.terminations = {"touch": TerminationTermCfg(mdp.illegal_contact, params=params)}
  cfg.metrics = {"touch": MetricsTermCfg(mdp.contact_count, params=params)}
  env = make(cfg)
  env.sim.data.qpos[:2, 2] += 1.0
  ended = env.step(torch.zeros(4, 2))[2]
  for _ in range(3):
    assert ended.tolist() == env.metrics_manager.term("touch")().bool().tolist()
    if ended.any():
      break
    ended = env.step(torch.zeros(4, 2))[2]
  assert not ended[:2].any()


def rough_cfg(patches: str = "feet") -> Any:
  cfg = hopper_cfg(num_envs=32)
  cfg.scene.terrain = TerrainGridCfg(
    types={"rough": RandomRoughCfg()},
    tile_size=(4.0, 3.0),
    rows=2,
    columns=3,
    flat_patches={"feet": FlatPatchCfg(count=3, radius=0.2, max_height_difference=0.2)},
  )
  cfg.events = {
    "root": EventTermCfg(
      mdp.reset_root_state_from_flat_patches,
      mode="reset",
      params={"patches": patches, "pose_range": {"z": (0.1, 0.2), "yaw": (-3.0, 3.0)}},
    )
  }
  return cfg


def test_roots_begin_on_flat_patches_of_their_tile(make: Make) -> None:
  env = make(rough_cfg())
  levels, terrain = env.scene.terrain_levels, env.scene.terrain
  seen = set()
  for _ in range(5):
    root = env.scene["robot"].data.root_link_pos_w.numpy()
    for world in range(env.num_envs):
      patches = terrain.flat_patches["feet"][levels.levels[world], levels.columns[world]]
      away = np.linalg.norm(patches[:, :2] - root[world, :2], axis=1)
      nearest = int(away.argmin())
      assert away[nearest] < 1e-5
      assert 0.62 + 0.1 - 1e-5 <= root[world, 2] - patches[nearest, 2] <= 0.62 + 0.2 + 1e-5
      seen.add((int(levels.levels[world]), int(levels.columns[world]), nearest))
    env.reset()
  assert len(seen) == 2 * 3 * 3


def test_a_plane_has_no_patches_and_a_wrong_name_is_named(make: Make) -> None:
  with pytest.raises(ConfigError, match=r"set of flat patches 'foot' does not exist. Nearest: feet"):
    make(rough_cfg(patches="foot"))
  cfg = rough_cfg()
  cfg.scene.terrain = hopper_cfg().scene.terrain
  env = make(cfg)
  root = env.scene["robot"].data.root_link_pos_w
  torch.testing.assert_close(root[:, :2], env.scene.env_origins[:, :2])


def test_an_edge_is_that_of_the_worlds_own_tile(make: Make) -> None:
  cfg = rough_cfg()
  cfg.terminations["edge"] = TerminationTermCfg(
    mdp.terrain_edge_reached, time_out=True, params={"threshold_fraction": 0.9}
  )
  cfg.episode_length_s = 10.0
  env = make(cfg)
  levels = env.scene.terrain_levels
  centre = np.stack((levels.levels.numpy() - 0.5, levels.columns.numpy() - 1.0), -1) * [4.0, 3.0]
  offset = np.random.default_rng(0).uniform(-1.0, 1.0, (32, 2)) * [2.0, 1.5]
  env.sim.data.qpos[:, :2] = torch.tensor(centre + offset)
  expected = (np.abs(offset) > 0.9 * np.array([2.0, 1.5])).any(1)
  assert env.termination_manager.term("edge")().tolist() == expected.tolist()
  assert 0 < expected.sum() < 32
