"""The numbers of the four tasks: of the model, the terms, the learner, and what watching changes."""

from importlib.metadata import entry_points
from typing import Any

import mujoco
import pytest
import torch
from mjlab_envs import ManagerBasedRlEnv
from mjlab_sensors import ContactSensorCfg, RingPatternCfg, TerrainHeightSensorCfg
from velocity_facts import TASKS
from velocity_rollout import make_env

every_task = pytest.mark.parametrize("name", TASKS)


@pytest.fixture(scope="module", params=TASKS)
def built(request: pytest.FixtureRequest) -> tuple[str, ManagerBasedRlEnv]:
  return request.param, make_env(2, task=request.param)


@every_task
def test_the_task_is_found_under_its_name(name: str) -> None:
  (entry,) = entry_points(group="mjlab.tasks", name=name)
  task = entry.load()()
  assert task.env == TASKS[name].make().env


def test_time_and_solver_are_those_of_the_table(built: tuple[str, ManagerBasedRlEnv]) -> None:
  name, env = built
  solver = TASKS[name].robot.solver
  assert (env.physics_dt, env.step_dt, env.max_episode_length) == (0.005, 0.02, 1000)
  option = env.sim.mj_model.opt
  assert (option.iterations, option.ls_iterations) == (10, 20)
  assert (option.ccd_iterations, option.impratio) == (solver["ccd"], solver["impratio"])
  cones = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
  assert option.cone == cones[solver["cone"]]
  assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
  assert option.solver == mujoco.mjtSolver.mjSOL_NEWTON
  assert (option.tolerance, option.ls_tolerance) == (1e-8, 0.01)
  assert option.gravity.tolist() == [0.0, 0.0, -9.81]
  assert env.sim.mj_model.stat.extent == 2.0
  assert env.cfg.sim.contact_sensor_maxmatch == (128 if TASKS[name].rough else 64)


@every_task
def test_sensors_are_those_of_the_table(name: str) -> None:
  facts = TASKS[name]
  env = make_env(1, task=name)
  configured = {sensor: env.scene.sensors[sensor] for sensor in env.cfg.scene.sensors}
  expected = {"feet_ground_contact", "foot_height_scan"}
  expected |= {"terrain_scan", *facts.robot.touch} if facts.rough else set()
  expected |= {"self_collision"} if "self_collisions" in env.cfg.rewards else set()
  assert set(configured) == expected
  feet, heights = configured["feet_ground_contact"].cfg, configured["foot_height_scan"].cfg
  assert isinstance(feet, ContactSensorCfg)
  assert (feet.fields, feet.reduce, feet.track_air_time) == (("found", "force"), "netforce", True)
  assert isinstance(heights, TerrainHeightSensorCfg)
  assert isinstance(heights.pattern, RingPatternCfg)
  assert (heights.pattern.radius, heights.pattern.num_samples) == facts.robot.ring
  assert (heights.alignment, heights.max_distance, heights.reduction) == ("yaw", 1.0, "min")
  assert heights.geom_groups == (0,)
  for sensor, geoms in (facts.robot.touch if facts.rough else {}).items():
    touch: Any = configured[sensor]
    assert tuple(primary.removeprefix("robot/") for primary in touch.primary_names) == geoms
  for sensor in expected & {"self_collision", *facts.robot.touch}:
    touch: Any = configured[sensor]
    assert touch.history_length == env.cfg.decimation == 4
    cfg = touch.cfg
    assert (cfg.history_length, cfg.num_slots) == ("decimation", 1)
  if facts.rough:
    scan: Any = configured["terrain_scan"].cfg
    assert (scan.alignment, scan.max_distance, scan.geom_groups) == ("yaw", 5.0, (0,))
    assert scan.exclude_parent_body


@every_task
def test_all_tasks_push_resample_and_widen_commands_alike(name: str) -> None:
  cfg, other = TASKS[name].make().env, TASKS["Mjlab-Velocity-Flat-Unitree-Go1"].make().env
  assert cfg.events["push_robot"] == other.events["push_robot"]
  assert cfg.commands == other.commands
  assert cfg.curriculum["command_vel"] == other.curriculum["command_vel"]
  assert cfg.metrics == other.metrics
  assert set(cfg.curriculum) == {"command_vel", *(["terrain_levels"] if TASKS[name].rough else [])}


@every_task
def test_the_play_config_differs_only_as_the_table_says(name: str) -> None:
  task: Any = TASKS[name].make()
  cfg, trained = task.play(task.env), TASKS[name].make().env
  actor: Any = cfg.observations["actor"]
  assert cfg.episode_length_s == 1e9
  assert not actor.corrupt
  assert cfg.events["push_robot"] is None
  assert not cfg.curriculum
  if TASKS[name].rough:
    assert cfg.terminations["out_of_terrain_bounds"] is None
    ground: Any = cfg.scene.terrain
    assert (ground.layout, ground.rows, ground.columns, ground.border_width) == ("random", 5, 5, 10.0)
    # First the tile, then the place on it.
    assert next(iter(cfg.events)) == "randomize_terrain"
    del cfg.events["randomize_terrain"]
    cfg.terminations["out_of_terrain_bounds"] = trained.terminations["out_of_terrain_bounds"]
    cfg.scene.terrain = trained.scene.terrain
    cfg.scene.max_init_terrain_level = trained.scene.max_init_terrain_level

  cfg.episode_length_s = 20.0
  actor.corrupt = True
  cfg.events["push_robot"] = trained.events["push_robot"]
  cfg.curriculum = trained.curriculum
  # The commands too: a short training has not seen faster ones.
  assert cfg == trained


def test_the_play_config_has_no_noise_no_pushes_and_no_time_out() -> None:
  task: Any = TASKS["Mjlab-Velocity-Flat-Unitree-Go1"].make()
  task.env.scene.num_envs, task.env.seed = 4, 7
  env = ManagerBasedRlEnv(task.play(task.env), device="cpu")
  env.reset()
  env.episode_length_buf.fill_(10**9)
  bias = env.scene["robot"].data.encoder_bias.float()
  # Pushes would come after 3 s at the latest.
  for _ in range(160):
    observations, _, terminated, truncated, _ = env.step(torch.zeros(4, 12))
    actor, critic = (torch.as_tensor(observations[group]) for group in ("actor", "critic"))
    seen = critic[:, : actor.shape[1]]
    torch.testing.assert_close(actor[:, 9:21], seen[:, 9:21] + bias)
    assert torch.equal(actor[:, :9], seen[:, :9])
    assert torch.equal(actor[:, 21:], seen[:, 21:])
    assert not (terminated | truncated).any()
    assert env.sim.data.qvel[:, :2].abs().max() < 1.0


@every_task
def test_the_learner_is_that_of_the_table(name: str) -> None:
  agent: Any = TASKS[name].make().agent
  for model in (agent.actor, agent.critic):
    assert model.hidden_dims == (512, 256, 128)
    assert model.activation == "elu"
    assert model.obs_normalization
  gaussian = {"class_name": "GaussianDistribution", "init_std": 1.0, "std_type": "scalar"}
  assert agent.actor.distribution_cfg == gaussian
  assert agent.critic.distribution_cfg is None
  expected: dict[str, Any] = {
    "num_learning_epochs": 5,
    "num_mini_batches": 4,
    "learning_rate": 1e-3,
    "schedule": "adaptive",
    "clip_param": 0.2,
    "use_clipped_value_loss": True,
    "value_loss_coef": 1.0,
    "entropy_coef": 0.01,
    "gamma": 0.99,
    "lam": 0.95,
    "desired_kl": 0.01,
    "max_grad_norm": 1.0,
    "normalize_advantage_per_mini_batch": False,
  }
  assert {key: getattr(agent.algorithm, key) for key in expected} == expected
  assert (agent.num_steps_per_env, agent.max_iterations, agent.save_interval) == (24, TASKS[name].robot.iterations, 50)
  assert (agent.experiment_name, agent.seed, agent.clip_actions) == (TASKS[name].robot.experiment, 42, None)
