"""Promises of a step."""

import logging
from collections.abc import Callable
from typing import Any

import pytest
import torch
from envs_hopper import Ended, Make, actions, end, hopper_cfg
from envs_watch import Watch
from mjlab_envs import ManagerBasedRlEnv, mdp
from mjlab_managers import CurriculumTermCfg, EventTermCfg, RewardTermCfg, TerminationTermCfg

TIME_OUT = {"time_out": TerminationTermCfg(mdp.time_out, time_out=True)}


def quiet(engine: str = "native", **options):
  """The hopper without anything random."""
  cfg = hopper_cfg(engine=engine, **options)
  cfg.observations["actor"].corrupt = False
  cfg.observations["actor"].terms["joint_vel"].delay_max_lag = 0
  cfg.events = {"default": EventTermCfg(mdp.reset_scene_to_default, mode="reset")}
  return cfg


def test_an_episode_ends_on_exactly_its_last_step(make: Make) -> None:
  env = make(terminations=TIME_OUT)
  assert env.max_episode_length == 20
  for step in range(1, 46):
    if step == 6:
      env.reset(env_ids=[1])
    _, _, terminated, truncated, _ = env.step(actions(env, step))
    ages = [step, step - 5 if step > 5 else step, step, step]
    assert truncated.tolist() == [age % 20 == 0 for age in ages]
    assert not terminated.any()
    assert env.episode_length_buf.tolist() == [age % 20 for age in ages]


@pytest.mark.parametrize(
  ("timestep", "decimation", "seconds", "steps"),
  [(0.02, 5, 0.3, 3), (0.005, 4, 20.0, 1000), (0.002, 5, 0.025, 3), (0.005, 4, 0.7, 35), (0.01, 1, 0.07, 7)],
)
def test_an_environment_has_its_own_rate_and_episodes_round_up_to_whole_steps(
  make: Make, timestep: float, decimation: int, seconds: float, steps: int
) -> None:
  cfg = hopper_cfg(decimation=decimation, episode_length_s=seconds)
  cfg.sim.timestep = timestep
  env = make(cfg)
  assert env.max_episode_length == steps
  assert (env.physics_dt, env.step_dt) == pytest.approx((timestep, timestep * decimation))
  assert env.metadata["render_fps"] == pytest.approx(1.0 / env.step_dt)


def test_a_push_is_in_the_same_steps_observation_and_not_in_its_reward(make: Make) -> None:
  cfg = quiet()
  params = {"velocity_range": {"x": (10.0, 10.0)}}
  cfg.events["push"] = EventTermCfg(
    mdp.push_by_setting_velocity, mode="interval", interval_range_s=(0.05, 0.05), params=params
  )
  speed = RewardTermCfg(lambda env: env.scene["robot"].data.root_link_lin_vel_w[:, 0], weight=1.0)
  cfg.commands, cfg.rewards = {}, {"speed": speed}
  cfg.observations["actor"].terms["command"] = None
  pushed = make(cfg)
  cfg.events["push"] = None
  calm = make(cfg)
  for step in range(1, 7):
    (a, reward_a, *_), (b, reward_b, *_) = calm.step(actions(calm, step)), pushed.step(actions(calm, step))
    assert torch.equal(reward_a, reward_b) == (step <= 5)
    assert torch.equal(a["critic"], b["critic"]) == (step < 5)
    if step == 5:
      change = b["critic"][:, :3] - a["critic"][:, :3]
      torch.testing.assert_close(change.norm(dim=-1), torch.full((4,), 10.0))
    if step == 6:
      torch.testing.assert_close(reward_b - reward_a, torch.full((4,), 0.1), rtol=0.05, atol=0.0)


def test_no_time_passes_for_timers_in_the_step_that_resets_a_world(make: Make) -> None:
  pushed: list[tuple[int, list[bool]]] = []

  def note(env: ManagerBasedRlEnv, mask: torch.Tensor) -> None:
    pushed.append((int(env.common_step_counter), mask.tolist()))

  cfg = hopper_cfg(terminations={"ended": TerminationTermCfg(Ended)})
  cfg.events["push"] = EventTermCfg(note, mode="interval", interval_range_s=(0.05, 0.05))
  env = make(cfg)
  pushed.clear()
  env.reset()
  for step in range(1, 14):
    end(env, *([2] if step == 7 else []))
    env.step(actions(env, step))
  assert [step for step, mask in pushed if mask[0]] == [5, 10]
  assert [step for step, mask in pushed if mask[2]] == [5, 12]


def test_what_a_world_sees_does_not_depend_on_who_is_reset(make: Make, engine: str) -> None:
  a, b = make(engine=engine), make(engine=engine)
  others = [0, 1, 3]
  for step in range(12):
    end(b, *([2] if step in (3, 7, 8) else []))
    outputs = [env.step(actions(env, step)) for env in (a, b)]
    (obs_a, reward_a, *_), (obs_b, reward_b, *_) = outputs
    for group in ("actor", "critic"):
      assert torch.equal(obs_a[group][others], obs_b[group][others]), (step, group)
    assert torch.equal(reward_a[others], reward_b[others])
    assert torch.equal(obs_a["actor"][2], obs_b["actor"][2]) == (step < 3)
  assert b.episode_length_buf.tolist() == [12, 12, 3, 12]


def test_what_a_step_returns_belongs_to_the_caller(make: Make) -> None:
  a, b = make(), make()
  kept, copies = [], []
  for step in range(25):
    end(a, step % 4)
    end(b, step % 4)
    action = actions(a, step)
    obs, *rest, _ = a.step(action)
    # The action may be written to, and observations asked for again.
    action.zero_()
    assert torch.equal(a.action_manager.action, actions(a, step) * ~a.reset_buf[:, None])
    for _ in range(3):
      assert torch.equal(a.get_observations()["actor"], obs["actor"])
    other, *_ = b.step(actions(b, step))
    assert torch.equal(other["actor"], obs["actor"])
    for value in other.values():
      value.fill_(torch.nan)
    kept.append([*obs.values(), *rest])
    copies.append([value.clone() for value in kept[-1]])
  for old, copy in zip(kept, copies, strict=True):
    assert all(torch.equal(value, same) for value, same in zip(old, copy, strict=True))
  assert [value.dtype for value in kept[0]] == [torch.float32] * 3 + [torch.bool] * 2


def test_a_diverged_world_is_ended_counted_and_not_observed(make: Make, engine: str) -> None:
  well, ill = make(engine=engine), make(engine=engine)
  for env in (well, ill):
    env.reset()
    env.step(actions(env, 0))
  ill.drain_log()
  ill.sim.data.qpos[1, 2] = torch.nan
  others = [0, 2, 3]
  for step in range(1, 5):
    obs, reward, terminated, truncated, _ = ill.step(actions(ill, step))
    expected, expected_reward, *_ = well.step(actions(well, step))
    assert terminated.tolist() == [False, step == 1, False, False]
    assert not truncated.any()
    for group in obs:
      assert torch.isfinite(obs[group]).all()
      assert torch.equal(obs[group][others], expected[group][others])
    assert torch.isfinite(reward).all()
    assert torch.equal(reward[others], expected_reward[others])
  log = ill.drain_log()
  assert log["Episode_Termination/nan_detection"] == 1.0
  assert all(value == value for value in log.values())
  assert "Episode_Termination/nan_detection" not in ill.drain_log()


def test_a_task_can_bring_its_own_watch_over_diverged_worlds(make: Make) -> None:
  env = make(terminations=TIME_OUT | {"broken": TerminationTermCfg(mdp.nan_detection)})
  assert env.termination_manager.active_terms == ["time_out", "broken"]
  assert make(terminations=TIME_OUT).termination_manager.active_terms == ["time_out", "nan_detection"]


def test_actions_of_a_policy_that_tracks_gradients_are_taken_and_others_than_numbers_count_as_zero(make: Make) -> None:
  a, b = make(), make()
  action = actions(a, 0)
  action[0, 0], action[2, 1] = torch.nan, torch.inf
  for given in (action.requires_grad_(), actions(a, 1).requires_grad_()):
    obs, *_ = a.step(given)
    expected, *_ = b.step(torch.nan_to_num(given.detach(), nan=0.0, posinf=0.0))
    assert torch.equal(obs["actor"], expected["actor"])
    assert not obs["actor"].requires_grad
  assert a.drain_log()["Nonfinite/action"] == 2.0


def test_an_action_of_the_wrong_shape_is_refused_before_anything_moves(make: Make) -> None:
  env = make()
  before = env.sim.data.qpos.clone()
  with pytest.raises(ValueError, match=r"action must have shape \(4, 2\), got \(4, 3\)"):
    env.step(torch.zeros(4, 3))
  with pytest.raises(TypeError, match=r"action must be a torch tensor, got ndarray; torch\.as_tensor makes one"):
    env.step(torch.zeros(4, 2).numpy())  # pyright: ignore[reportArgumentType]
  assert torch.equal(env.sim.data.qpos, before)


def test_startup_events_run_once_with_all_managers_before_the_first_reset(make: Make) -> None:
  seen: list[str] = []

  def at_startup(env: ManagerBasedRlEnv, mask: torch.Tensor) -> None:
    assert all(manager is not None for manager in env.managers.values())
    assert mask.all()
    seen.append("startup")

  def at_reset(env: ManagerBasedRlEnv, mask: torch.Tensor) -> None:
    seen.append("reset")

  env = make(
    events={"a": EventTermCfg(at_reset, mode="reset"), "b": EventTermCfg(at_startup, mode="startup")}, begun=False
  )
  # Both were tried, and what they did was undone.
  assert seen == ["startup", "reset", "startup"]
  env.reset()
  env.reset()
  env.step(actions(env, 0))
  assert seen.count("startup") == 2
  assert seen[3] == "reset"


def test_curricula_see_the_terminal_state_events_default_targets_and_commands_come_last(make: Make) -> None:
  order: list[str] = []
  heights: list[torch.Tensor] = []
  lengths: list[int] = []

  def curriculum(env: ManagerBasedRlEnv, mask: torch.Tensor) -> None:
    if env.common_step_counter == 3:
      order.append("curriculum")
      heights.append(env.scene["robot"].data.root_link_pos_w[:, 2].clone())
      lengths.append(int(env.episode_length_buf[1]))

  def event(env: ManagerBasedRlEnv, mask: torch.Tensor) -> None:
    if env.common_step_counter == 3:
      order.append("event")
      data = env.scene["robot"].data
      assert torch.equal(data.joint_pos_target[1], data.default_joint_pos[0])
      assert not torch.equal(data.joint_pos_target[0], data.default_joint_pos[0])
      assert env.sim.data.qvel[1].abs().max() == 0.0

  cfg = hopper_cfg(curriculum={"watch": CurriculumTermCfg(curriculum)})
  cfg.events = {"watch": EventTermCfg(event, mode="reset"), **cfg.events}
  env = make(cfg)
  term = env.command_manager.get_term("speed")
  resample = term.resample

  def watched(mask: torch.Tensor) -> None:
    if env.common_step_counter == 3 and mask[1]:
      order.append("command")
    resample(mask)

  term.resample = watched  # pyright: ignore[reportAttributeAccessIssue]
  env.reset()
  for step in range(2):
    env.step(actions(env, step))
  end(env, 1)
  before = env.scene["robot"].data.root_link_pos_w[:, 2].clone()
  env.step(actions(env, 2))
  assert order[:3] == ["curriculum", "event", "command"]
  assert (heights[0] - before).abs().max() < 0.05
  assert lengths == [3]


# What a step costs


@pytest.mark.usefixtures("nothing_skipped")
@pytest.mark.parametrize(("is_kept", "most"), [(False, 310), (True, 370)], ids=["plain", "final_obs"])
def test_a_step_never_waits_for_the_device_and_costs_few_operations(
  make: Make, capsys: pytest.CaptureFixture[str], is_kept: bool, most: int
) -> None:
  env = make(capture_terminal_observations=is_kept)
  for step in range(3):
    env.step(actions(env, step))
  counts = []
  for step in range(3, 30):
    end(env, *([step % 4] if step % 3 == 0 else []))
    action = actions(env, step)
    with Watch() as watch:
      env.step(action)
    assert watch.waits == []
    counts.append(watch.count)
  with capsys.disabled():
    print(f"\nThe hopper's step: {counts[-1]} torch operations.")
  # Whether worlds end or are pushed makes no difference: a recorded step has one shape.
  assert len(set(counts)) == 1
  assert counts[0] <= most


def test_a_step_takes_one_of_torchs_threads_and_gives_the_others_back(make: Make) -> None:
  seen: list[int] = []

  def note(env: ManagerBasedRlEnv) -> torch.Tensor:
    seen.append(torch.get_num_threads())
    return torch.zeros(env.num_envs)

  env = make(rewards={"note": RewardTermCfg(note, weight=1.0)})
  seen.clear()
  before = torch.get_num_threads()
  try:
    torch.set_num_threads(2)
    env.reset()
    env.step(actions(env, 0))
    assert torch.get_num_threads() == 2
  finally:
    torch.set_num_threads(before)
  assert seen == [1]


def test_a_step_with_resets_and_pushes_computes_kinematics_once(make: Make, engine: str, monkeypatch) -> None:
  cfg = hopper_cfg(engine=engine)
  cfg.events["push"].interval_range_s = (0.01, 0.01)
  env = make(cfg)
  forwards: list[bool] = []
  forward = env.sim._engine.forward

  def counted(model_changed: bool) -> None:
    forwards.append(model_changed)
    forward(model_changed)

  monkeypatch.setattr(env.sim._engine, "forward", counted)
  for step in range(25):
    end(env, step % 4)
    env.step(actions(env, step))
    assert len(forwards) == step + 1


def test_a_step_that_nothing_happens_in_computes_kinematics_never(make: Make, monkeypatch) -> None:
  cfg = hopper_cfg(events={})
  env = make(cfg)
  forwards: list[bool] = []
  monkeypatch.setattr(env.sim._engine, "forward", lambda changed: forwards.append(changed))
  env._simulate()
  env._terminate()
  env._reward()
  env._observe()
  assert forwards == []


# Code that cannot be recorded


def noting(make: Make, device: str = "cpu", **options: Any) -> tuple[Any, list[list[int]]]:
  """Return an environment with an event that notes the numbers of the worlds that reset, and these notes."""
  seen: list[list[int]] = []

  def note(env: ManagerBasedRlEnv, env_ids: torch.Tensor) -> None:
    seen.append(env_ids.tolist())

  cfg = hopper_cfg(**options)
  cfg.events["note"] = EventTermCfg(note, mode="reset")
  env = make(cfg, device)
  seen.clear()
  return env, seen


@pytest.mark.usefixtures("nothing_skipped")
def test_an_event_that_takes_world_numbers_works_and_is_named_once(
  make: Make, caplog: pytest.LogCaptureFixture, monkeypatch
) -> None:
  env, seen = noting(make)
  env.reset()
  assert seen == [[0, 1, 2, 3]]
  env.step(actions(env, 0))
  end(env, 1, 3)
  env.step(actions(env, 1))
  assert seen == [[0, 1, 2, 3], [1, 3]]
  env.reset(env_ids=[2])
  assert seen[-1] == [2]
  assert not caplog.records

  class Recording:
    def interrupt(self, fn: Callable[[], None]) -> None:
      fn()

  end(env)
  monkeypatch.setattr(env.sim._recordings, "recorder", Recording())
  with caplog.at_level(logging.WARNING, "mjlab"):
    for _ in range(3):
      env._step_stages()
  assert [record.getMessage() for record in caplog.records] == [
    "event 'note' cannot be recorded: the step graph is split around it and it runs eagerly."
  ]


needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")


@needs_gpu
@pytest.mark.parametrize("is_kept", [False, True], ids=["plain", "final_obs"])
def test_a_recorded_step_is_one_graph_that_never_waits_on_a_gpu(make: Make, is_kept: bool) -> None:
  env = make(num_envs=64, device="cuda", engine="auto", capture_terminal_observations=is_kept)
  for step in range(6):
    env.step(actions(env, step))
  assert env.is_captured
  assert env.num_graphs == 1
  action = actions(env, 7)
  try:
    torch.cuda.set_sync_debug_mode("error")
    outputs = [env.step(action) for _ in range(30)]
  finally:
    torch.cuda.set_sync_debug_mode("default")
  for obs, reward, *_ in outputs:
    assert torch.isfinite(obs["actor"]).all()
    assert torch.isfinite(reward).all()
  # Worlds ended and were reset meanwhile.
  assert sum(count for name, count in env.drain_log().items() if name.startswith("Episode_Termination/")) >= 64.0


@needs_gpu
def test_recorded_steps_follow_eager_ones_on_a_gpu(make: Make) -> None:
  recorded, cfg = make(num_envs=16, device="cuda", engine="auto"), hopper_cfg(num_envs=16, engine="auto")
  cfg.sim.capture = False
  eager = make(cfg, "cuda")
  for step in range(12):
    end(recorded, step)
    end(eager, step)
    (a, reward_a, *_), (b, reward_b, *_) = (env.step(actions(env, step)) for env in (recorded, eager))
    # The order of contacts on a GPU is not fixed, so that sums of floats are not either.
    torch.testing.assert_close(a["actor"], b["actor"], rtol=1e-2, atol=1e-2)
    torch.testing.assert_close(reward_a, reward_b, rtol=1e-2, atol=1e-2)
  assert (recorded.is_captured, eager.is_captured) == (True, False)
  assert torch.equal(recorded.episode_length_buf, eager.episode_length_buf)
  # Draws come in the same order.
  assert torch.equal(recorded.command_manager.get_command("speed"), eager.command_manager.get_command("speed"))


@needs_gpu
def test_an_event_that_takes_world_numbers_splits_the_recording_on_a_gpu(
  make: Make, caplog: pytest.LogCaptureFixture
) -> None:
  env, seen = noting(make, "cuda", engine="auto")
  for step in range(8):
    end(env, step % 4)
    env.step(actions(env, step))
  assert env.num_graphs == 2
  assert [[step % 4] for step in range(8)] == seen
  assert sum("event 'note' cannot be recorded" in record.getMessage() for record in caplog.records) == 1
