"""Seeds, saving, spaces, and what is said of a wrong config."""

import copy
import gc
import weakref
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from envs_hopper import Make, actions, end, hopper_cfg
from mjlab_core.errors import ConfigError, MjlabError
from mjlab_dr import geom_friction
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg, mdp
from mjlab_managers import (
  EventTermCfg,
  ObservationTermCfg,
  RecorderTerm,
  RecorderTermCfg,
  RewardTermCfg,
  TerminationTermCfg,
)


def run(env: Any, steps: range) -> list[torch.Tensor]:
  seen = []
  for step in steps:
    end(env, *([step % 4] if step % 3 == 1 else []))
    obs, reward, terminated, truncated, _ = env.step(actions(env, step))
    seen += [*obs.values(), reward, terminated, truncated]
  return seen


def randomised_cfg(engine: str) -> ManagerBasedRlEnvCfg:
  cfg = hopper_cfg(engine=engine)
  friction = {"randomizer": geom_friction("foot", (0.3, 1.2))}
  cfg.events["friction"] = EventTermCfg(mdp.randomize, mode="startup", params=friction)
  return cfg


def test_a_loaded_environment_goes_on_bit_for_bit(make: Make, engine: str) -> None:
  a, cfg = make(randomised_cfg(engine)), randomised_cfg(engine)
  cfg.seed = 99
  b = make(cfg)
  a.reset()
  b.reset()
  run(b, range(3))
  a.scene["robot"].data.encoder_bias.fill_(0.05)
  run(a, range(5))
  saved = a.state_dict()
  kept = copy.deepcopy(saved)
  expected = run(a, range(5, 30))
  b.load_state_dict(saved)
  assert torch.equal(b.get_observations()["actor"], b.observation_manager.buffers["actor"])
  for x, y in zip(run(b, range(5, 30)), expected, strict=True):
    assert torch.equal(x, y)
  assert torch.equal(saved["sim"]["data"]["qpos"], kept["sim"]["data"]["qpos"])
  assert b.common_step_counter == a.common_step_counter == 30


@pytest.mark.warp
def test_recorded_physics_makes_no_difference_on_a_cpu(make: Make) -> None:
  recorded, cfg = make(randomised_cfg("warp")), randomised_cfg("warp")
  cfg.sim.capture = False
  eager = make(cfg)
  for x, y in zip(run(recorded, range(12)), run(eager, range(12)), strict=True):
    assert torch.equal(x, y)


@pytest.mark.warp
def test_both_engines_run_the_same_environment(make: Make) -> None:
  # Draws in the engine's own precision differ, so that nothing is drawn for the state.
  events = {"default": EventTermCfg(mdp.reset_scene_to_default, mode="reset")}
  native, warp = make(events=events), make(engine="warp", events=events)
  for step in range(8):
    (a, reward_a, *done_a, _), (b, reward_b, *done_b, _) = (env.step(actions(env, step)) for env in (native, warp))
    for group in a:
      torch.testing.assert_close(a[group], b[group], rtol=5e-3, atol=5e-3)
    torch.testing.assert_close(reward_a, reward_b, rtol=1e-2, atol=1e-3)
    assert all(torch.equal(x, y) for x, y in zip(done_a, done_b, strict=True))


def test_without_auto_reset_pending_worlds_are_saved_too(make: Make) -> None:
  a, b = make(auto_reset=False), make(auto_reset=False)
  end(a, 2)
  a.step(actions(a, 0))
  b.load_state_dict(a.state_dict())
  with pytest.raises(RuntimeError, match=r"\[2\]"):
    b.step(actions(b, 1))


def test_a_state_of_another_size_or_task_is_refused(make: Make) -> None:
  env, larger = make(), make(num_envs=5)
  with pytest.raises(ValueError, match="shape"):
    env.load_state_dict(larger.state_dict())
  cfg = hopper_cfg()
  cfg.observations["actor"].terms["joint_pos"].history_length = 3
  other = make(cfg)
  with pytest.raises(MjlabError):
    env.load_state_dict(other.state_dict())


def leaves(state: Any) -> list[torch.Tensor]:
  return [state] if isinstance(state, torch.Tensor) else [leaf for part in state.values() for leaf in leaves(part)]


def put(state: dict[str, Any], path: str, value: Any) -> None:
  """Put another value into a saved state; None removes it."""
  *parts, last = path.split(".")
  for part in parts:
    state = state[part]
  state[last] = value
  if value is None:
    del state[last]


def test_a_state_that_does_not_fit_in_one_place_changes_nothing(make: Make) -> None:
  env, other = make(), make(seed=8)
  run(env, range(3))
  run(other, range(5))
  before = leaves(env.state_dict())
  for path, value, message in (
    ("metrics._steps", None, r"env\.metrics\._steps: missing from the saved state"),
    ("scene.entities", {}, r"env\.scene\.entities\.robot: missing from the saved state"),
    ("recorders", None, "recorders: missing from the saved state"),
    ("sim.data", None, "saved state lacks 'data'"),
    ("rng", torch.zeros(16, dtype=torch.uint8), "rng: saved on another kind of device"),
    ("episode_length", torch.ones(1, dtype=torch.int64), r"episode_length: saved shape \(1,\), here \(4,\)"),
  ):
    state = other.state_dict()
    put(state, path, value)
    with pytest.raises(ValueError, match=message):
      env.load_state_dict(state)
    assert all(torch.equal(x, y) for x, y in zip(before, leaves(env.state_dict()), strict=True))


def test_progress_alone_fits_any_number_of_worlds(make: Make) -> None:
  env, larger = make(), make(num_envs=5)
  larger.reset()
  run(larger, range(4))
  begun = env.rng.get_state()
  env.load_progress(larger.state_dict())
  assert env.common_step_counter == 4
  # What was drawn at the beginning is not drawn again.
  assert not torch.equal(env.rng.get_state(), begun)


def test_one_seed_gives_one_run(make: Make) -> None:
  a, b, c = make(), make(), make(hopper_cfg(seed=8))
  runs = [run(env, range(25)) for env in (a, b, c)]
  assert all(torch.equal(x, y) for x, y in zip(runs[0], runs[1], strict=True))
  assert not torch.equal(runs[0][0], runs[2][0])
  assert (a.seed, c.seed) == (7, 8)


def test_a_seed_given_to_reset_starts_the_same_run_anywhere(make: Make) -> None:
  a, b = make(), make(hopper_cfg(seed=8))
  a.reset()
  run(a, range(7))
  (first, _), (second, _) = a.reset(seed=3), b.reset(seed=3)
  assert torch.equal(first["actor"][:, :10], second["actor"][:, :10])
  assert a.seed == b.seed == 3


def test_without_a_seed_one_is_drawn_and_shown(make: Make) -> None:
  a, b = make(hopper_cfg(seed=None)), make(hopper_cfg(seed=None))
  assert isinstance(a.seed, int)
  assert a.seed != b.seed
  again = make(hopper_cfg(seed=a.seed))
  assert torch.equal(a.reset()[0]["actor"], again.reset()[0]["actor"])
  assert a.cfg.seed is None


def test_global_generators_are_left_alone(make: Make) -> None:
  torch.manual_seed(0)
  expected = torch.rand(3)
  torch.manual_seed(0)
  env = make()
  state = torch.get_rng_state()
  env.step(torch.zeros(4, 2))
  assert torch.equal(torch.get_rng_state(), state)
  assert torch.equal(torch.rand(3), expected)


# Gymnasium


def test_spaces_are_those_of_what_is_returned(make: Make) -> None:
  cfg = hopper_cfg()
  cfg.observations["critic"].concatenate_terms = False
  env = make(cfg)
  obs, _ = env.reset()
  single, batched = env.single_observation_space, env.observation_space
  assert isinstance(single, gymnasium.spaces.Dict)
  arrays = {
    group: {name: part.numpy() for name, part in value.items()} if isinstance(value, dict) else value.numpy()
    for group, value in obs.items()
  }
  assert batched.contains(arrays)
  first = {
    group: {name: part[0] for name, part in value.items()} if isinstance(value, dict) else value[0]
    for group, value in arrays.items()
  }
  assert single.contains(first)
  assert single["actor"].shape == (16,)
  assert env.single_action_space.shape == (2,)
  assert env.action_space.shape == (4, 2)
  assert env.single_action_space.dtype == np.float32
  assert env.action_space.sample().shape == (4, 2)
  assert batched == gymnasium.vector.utils.batch_space(single, 4)


def test_the_vector_interface_is_gymnasiums(make: Make) -> None:
  env = make()
  assert env.is_vector_env
  assert env.unwrapped is env
  assert env.render_mode is None
  assert env.metadata["autoreset_mode"] == gymnasium.vector.AutoresetMode.SAME_STEP.value
  assert make(auto_reset=False).metadata["autoreset_mode"] == gymnasium.vector.AutoresetMode.DISABLED.value
  obs, info = env.reset(seed=1, options={})
  assert isinstance(obs, dict)
  assert info == {}
  obs, reward, terminated, truncated, info = env.step(actions(env, 0))
  assert reward.shape == terminated.shape == truncated.shape == (4,)
  assert (reward.dtype, terminated.dtype, truncated.dtype) == (torch.float32, torch.bool, torch.bool)
  assert all(value.dtype == torch.float32 for value in obs.values() if isinstance(value, torch.Tensor))


def test_a_closed_environment_says_so_and_closes_again(make: Make) -> None:
  with make() as env:
    env.reset()
  env.close()
  with pytest.raises(RuntimeError, match="this environment is closed"):
    env.step(torch.zeros(4, 2))
  with pytest.raises(RuntimeError, match="this environment is closed"):
    env.reset()


def test_a_closed_environment_without_references_is_freed(engine: str) -> None:
  # Only what is made from here on is looked at: the rest of the process is large.
  gc.freeze()
  env = ManagerBasedRlEnv(randomised_cfg(engine), "cpu")
  env.reset()
  obs, *_ = env.step(actions(env, 0))
  held = [weakref.ref(each) for each in (env, env.sim, env.scene, env.scene["robot"].data, env.sim.data.qpos)]
  env.close()
  del env
  gc.collect()
  gc.unfreeze()
  assert [ref() for ref in held] == [None] * 5
  seen = obs["actor"]
  assert isinstance(seen, torch.Tensor)
  assert torch.isfinite(seen).all()


def test_a_recorder_that_fails_to_close_leaves_nothing_open(make: Make) -> None:
  closed: list[str] = []

  class Failing(RecorderTerm):
    def close(self) -> None:
      closed.append(self.name)
      raise OSError(f"disk full ({self.name})")

  env = make(recorders={"first": RecorderTermCfg(Failing), "second": RecorderTermCfg(Failing)})
  with pytest.raises(OSError, match="disk full"):
    env.close()
  assert closed == ["first", "second"]
  with pytest.raises(MjlabError, match="closed"):
    env.sim.step()


# Configs


def test_a_config_is_not_touched_and_can_serve_again(make: Make) -> None:
  cfg = hopper_cfg()
  before = repr(cfg)
  a = make(cfg)
  assert repr(cfg) == before
  b = make(cfg)
  a.cfg.episode_length_s = 100.0
  assert cfg.episode_length_s == 0.2
  assert torch.equal(a.reset()[0]["actor"], b.reset()[0]["actor"])


def wrong_shape(env: ManagerBasedRlEnv) -> torch.Tensor:
  return torch.zeros(env.num_envs, 1)


def on_reset(func: Any, **params: Any) -> dict[str, Any]:
  return {"events": EventTermCfg(func, mode="reset", params=params)}


MISSPELT: Any = "restet"
ALWAYS = {"cooldown_s": (0.0, 1.0), "duration_s": (0.0, 1.0)}


@pytest.mark.parametrize(
  ("options", "message"),
  [
    ({"episode_length_s": 0.0}, "termination 'time_out' is a time-out, so episode_length_s must be positive"),
    ({"episode_length_s": -1.0}, "episode_length_s must not be negative, got -1.0"),
    ({"decimation": 0}, "decimation must be at least 1, got 0"),
    ({"num_envs": 0}, "scene: num_envs must be at least 1, got 0"),
    ({"num_envs": 2.5}, "scene: num_envs must be a whole number, got 2.5"),
    ({"decimation": True}, "decimation must be a whole number, got True"),
    ({"episode_length_s": float("inf")}, "episode_length_s must be finite, got inf"),
    ({"seed": 1.5}, "seed must be a whole number, got 1.5"),
    ({"seed": 2**64}, "seed must be in .* got 18446744073709551616"),
    ({"rewards": RewardTermCfg(wrong_shape, weight=1.0)}, r"RewardManager.*term 'wrong'.*\(4,\)"),
    ({"terminations": TerminationTermCfg(wrong_shape)}, r"TerminationManager.*term 'wrong'.*bool"),
    ({"rewards": RewardTermCfg(mdp.posture, weight=1.0)}, r"missing parameter std"),
    (
      {"events": EventTermCfg(mdp.reset_scene_to_default, mode=MISSPELT)},
      r"mode 'restet' does not exist. Nearest: reset",
    ),
    ({"rewards": ObservationTermCfg(wrong_shape)}, "expected a RewardTermCfg"),
    ({"rewards": RewardTermCfg(mdp.posture, weight=1.0, params={"std": {"hip": 0.3}})}, "for joint knee"),
    (
      on_reset(mdp.reset_root_state_uniform, pose_range={"rol": (0.0, 1.0)}),
      "'rol' does not exist.*Nearest: roll",
    ),
    (on_reset(mdp.reset_root_state_uniform, pose_range={"x": (1.0, -1.0)}), "parameter 'pose_range' must not fall"),
    (on_reset(mdp.reset_joints_by_offset, position_range=(1.0, 0.0), velocity_range=(0.0, 0.0)), "position_range"),
    (on_reset(mdp.push_by_setting_velocity, velocity_range={"yawn": (0.0, 1.0)}), "Nearest: yaw"),
    (on_reset(mdp.reset_root_state_uniform), "missing parameter pose_range"),
    (on_reset(mdp.apply_external_force_torque, force_range={"w": (0.0, 1.0)}), "axis 'w' does not exist"),
    (on_reset(mdp.apply_external_force_torque, force_range=(1.0, 0.0)), "must not fall"),
    ({"events": EventTermCfg(mdp.apply_body_impulse, mode="step", params=ALWAYS)}, "duration_s"),
    (
      {"observations": ObservationTermCfg(mdp.projected_gravity_from_sensor, params={"sensor": "robot/gyro"})},
      r"'robot/gyro' does not measure the vertical; give an ImuSensorCfg",
    ),
    ({"actions": mdp.JointPositionActionCfg(entity="dog")}, "dog"),
  ],
)
def test_a_mistake_is_named_at_build(make: Make, options: dict[str, Any], message: str) -> None:
  numbers: dict[str, Any] = {name: value for name, value in options.items() if isinstance(value, int | float)}
  cfg = hopper_cfg(**numbers)
  for name, value in options.items():
    if not isinstance(value, int | float):
      part = cfg.observations["critic"].terms if name == "observations" else getattr(cfg, name)
      part["wrong"] = value
  with pytest.raises(ConfigError, match=message):
    make(cfg)


def test_a_term_that_is_none_is_left_out(make: Make) -> None:
  cfg = hopper_cfg()
  cfg.rewards["speed"] = None
  cfg.observations["critic"] = None
  cfg.events["push"] = None
  env = make(cfg)
  assert env.reward_manager.active_terms == ["alive", "action_rate", "torques"]
  assert list(env.reset()[0]) == ["actor"]


def test_rewards_of_endless_episodes_are_logged_as_sums(make: Make) -> None:
  cfg = hopper_cfg(episode_length_s=0.0)
  cfg.terminations["time_out"] = None
  env = make(cfg)
  for step in range(3):
    env.step(actions(env, step))
  env.reset()
  assert env.drain_log()["Episode_Reward/alive"] == pytest.approx(3 * 0.5 * env.step_dt)


def test_a_description_names_every_term(make: Make) -> None:
  text = make().describe()
  for word in ("native engine", "seed 7", "episode 20 steps", "action_rate", "time_out", "joint_vel", "push", "jerk"):
    assert word in text
