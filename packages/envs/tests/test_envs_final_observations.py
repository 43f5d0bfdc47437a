"""Last observations of episodes, in a step that resets them, against an environment that does not."""

import logging
from typing import Any

import pytest
import torch
from envs_hopper import Ended, Make, SpeedCommandCfg, actions, end, hopper_cfg
from mjlab_core.errors import ConfigError
from mjlab_envs import mdp
from mjlab_managers import (
  ConstantNoiseCfg,
  EventTermCfg,
  NoiseModelWithAdditiveBiasCfg,
  ObservationTermCfg,
  TerminationTermCfg,
  UniformNoiseCfg,
)


def quiet_cfg(**options: Any) -> Any:
  """The hopper with fixed delays, histories and noise that is drawn at resets alone, so that steps draw nothing."""
  cfg = hopper_cfg(**options)
  actor, critic = cfg.observations["actor"], cfg.observations["critic"]
  bias = NoiseModelWithAdditiveBiasCfg(
    noise_cfg=ConstantNoiseCfg(bias=0.01), bias_noise_cfg=UniformNoiseCfg(n_min=-0.1, n_max=0.1)
  )
  for name in ("gyro", "gravity"):
    actor.terms[name].noise = bias
  actor.terms["joint_vel"].delay_min_lag = 2
  critic.concatenate_terms = False
  cfg.commands = {"speed": SpeedCommandCfg(resampling_time_range=None)}
  cfg.terminations = {"ended": TerminationTermCfg(Ended)}
  cfg.events.pop("push")
  return cfg


def flat(observations: dict[str, Any]) -> dict[str, torch.Tensor]:
  found = {}
  for group, value in observations.items():
    parts = {"": value} if isinstance(value, torch.Tensor) else value
    found |= {f"{group}/{name}": part for name, part in parts.items()}
  return found


def test_final_observations_are_those_of_an_environment_that_does_not_reset(make: Make, engine: str) -> None:
  kept = make(quiet_cfg(engine=engine, capture_terminal_observations=True))
  manual = make(quiet_cfg(engine=engine, auto_reset=False))
  plain = make(quiet_cfg(engine=engine))
  for number in range(5):
    observed, reward, *_, extras = kept.step(actions(kept, number))
    expected = manual.step(actions(manual, number))[0]
    assert not extras["_final_obs"].any()
    assert all(torch.equal(a, b) for a, b in zip(flat(observed).values(), flat(expected).values(), strict=True))
    plain.step(actions(plain, number))
  for env in (kept, manual, plain):
    end(env, 1, 3)
  observed, reward, *_, extras = kept.step(actions(kept, 9))
  final, expected = flat(extras["final_obs"]), flat(manual.step(actions(manual, 9))[0])
  assert extras["_final_obs"].tolist() == [False, True, False, True]
  for name, value in expected.items():
    assert torch.equal(final[name][[1, 3]], value[[1, 3]]), name
    assert not torch.equal(final[name], flat(observed)[name]), name
  without, reward_without, *_ = plain.step(actions(plain, 9))
  assert torch.equal(reward, reward_without)
  # Observing once more has moved no delay, no history and no count.
  assert all(torch.equal(a, b) for a, b in zip(flat(observed).values(), flat(without).values(), strict=True))
  for env in (kept, plain):
    end(env)
  later, later_plain = (flat(env.step(actions(env, 10))[0]) for env in (kept, plain))
  assert all(torch.equal(a, b) for a, b in zip(later.values(), later_plain.values(), strict=True))
  before = {name: value.clone() for name, value in final.items()}
  kept.step(actions(kept, 11))
  assert all(torch.equal(final[name], value) for name, value in before.items())


def test_noise_of_a_final_observation_is_as_large_as_any(make: Make) -> None:
  env = make(hopper_cfg(num_envs=64, capture_terminal_observations=True))
  end(env, *range(64))
  *_, extras = env.step(actions(env, 0))
  columns = next(part.columns for part in env.observation_manager.layout("actor") if part.name == "gravity")
  seen = extras["final_obs"]["actor"][:, columns]
  # Upright but for the noise of 0.05: yaw does not tilt it, and one step hardly does.
  assert (seen[:, :2].abs() < 0.2).all()
  assert seen[:, :2].std() > 0.01


def test_without_auto_reset_it_is_refused_and_without_the_option_extras_are_empty(make: Make) -> None:
  with pytest.raises(ConfigError, match="capture_terminal_observations is for auto_reset"):
    make(hopper_cfg(auto_reset=False, capture_terminal_observations=True))
  env = make()
  assert env.step(actions(env, 0))[-1] == {}


def broken(env: Any) -> torch.Tensor:
  return torch.full((env.num_envs, 2), float("nan"))


def test_a_group_may_warn_of_nan(make: Make, caplog: pytest.LogCaptureFixture) -> None:
  cfg = hopper_cfg(events={"reset": EventTermCfg(mdp.reset_scene_to_default, mode="reset")})
  cfg.observations["critic"].terms["broken"] = ObservationTermCfg(broken)
  cfg.observations["critic"].nan_policy = "warn"
  env = make(cfg)
  observed = env.step(actions(env, 0))[0]["critic"]
  assert torch.isfinite(observed).all()
  with caplog.at_level(logging.WARNING, logger="mjlab"):
    env.drain_log()
  assert "observation 'critic/broken': 16 entries were NaN or infinite and became 0" in caplog.text
  caplog.clear()
  with caplog.at_level(logging.WARNING, logger="mjlab"):
    env.drain_log()
  assert caplog.text == ""


def test_the_viewer_section_becomes_the_camera_of_pictures() -> None:
  from mjlab_envs import ViewerCfg

  viewer = ViewerCfg(body="robot/trunk", distance=2.0, elevation=-40.0, width=320)
  picture = viewer.picture()
  assert (picture.width, picture.height) == (320, 480)
  assert (picture.camera.body, picture.camera.distance, picture.camera.elevation) == ("robot/trunk", 2.0, -40.0)
  assert picture.camera.azimuth == 120.0
