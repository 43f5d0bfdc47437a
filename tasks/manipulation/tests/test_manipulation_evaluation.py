"""The evaluation of lifting, of policies of which it is known how well they do."""

import itertools
from typing import Any

import pytest
import torch
from manipulation_worlds import place, three_cubes
from mjlab_core.errors import ConfigError
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_managers import TerminationTermCfg
from mjlab_manipulation import LiftEvaluation, lift_cube, lift_cube_env, lift_objects_env
from mjlab_manipulation.evaluation import _by_width
from mjlab_manipulation.lift import COMMAND
from mjlab_manipulation.mdp import lift_command
from mjlab_manipulation.objects import OBJECTS


def evaluator() -> LiftEvaluation:
  return LiftEvaluation(episodes=8, seconds=2.0)


def test_success_lifts_and_drops_are_those_of_cubes_that_are_placed() -> None:
  with ManagerBasedRlEnv(evaluator().configure(lift_cube_env()), device="cpu") as env:
    term, steps = lift_command(env, "lift_height"), 0

    def policy(observations: object) -> torch.Tensor:
      nonlocal steps
      del observations
      steps += 1
      # From the 20th step on five cubes are kept at their goals; the sixth is lifted once and falls.
      if steps > 20:
        place(env, term.command.numpy(), world=slice(0, 5))
      if steps == 20:
        place(env, term.command.numpy(), world=slice(5, 6))
      return torch.zeros(8, 7)

    result = evaluator().run(env, policy)
    assert term.goal_time.tolist() == [2.0] * 8
  overall = result.groups["all"]
  assert overall["success_rate"].mean == pytest.approx(5 / 8)
  # A second on end, from then on.
  assert overall["time_to_success"].mean == pytest.approx(20 * 0.02 + 1.0)
  assert overall["time_to_success"].count == 5
  assert overall["lift_rate"].mean == pytest.approx(6 / 8)
  assert overall["drop_rate"].mean == pytest.approx(1 / 6)
  assert overall["failure_rate"].mean == 0.0
  # One cube of one width: no groups but those of its start.
  assert set(result.groups) == {"all", "near", "far", "left", "right"}
  assert sum(result.groups[name]["success_rate"].count for name in ("near", "far")) == 8
  assert "success_rate" in result.table()


def test_forces_errors_and_failures_are_those_of_the_same_episodes_computed_step_by_step() -> None:
  def configured() -> ManagerBasedRlEnvCfg:
    cfg = evaluator().configure(lift_cube_env())
    cfg.terminations["pressed"] = TerminationTermCfg(fails_on_schedule)
    return cfg

  def act(env: ManagerBasedRlEnv, step: int) -> torch.Tensor:
    """Fingers close about cubes that are put between them, but for that of the last world, and hands shake."""
    if step == 30:
      site = (env.scene["robot"].data.site_pos_w[:, 1] - env.scene.env_origins).numpy()
      place(env, site, world=slice(0, 7))
    action = 0.3 * torch.randn(8, 7, generator=torch.Generator().manual_seed(step))
    action[:, 6] = 1.0 if step < 30 else -10.0
    return action

  peak, final, length, failed = torch.zeros(8), torch.zeros(8), torch.zeros(8), torch.zeros(8, dtype=torch.bool)
  cfg = configured()
  cfg.auto_reset = False
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    env.reset(seed=0)
    playing = torch.ones(8, dtype=torch.bool)
    for step in range(1, 101):
      goal = lift_command(env, COMMAND).command + env.scene.env_origins
      _, _, terminated, truncated, _ = env.step(act(env, step))
      # (worlds, fingers by cubes, substeps, 3)
      force = env.scene["fingers"].data.force_history.norm(dim=-1).flatten(1).amax(1).float()
      peak = torch.where(playing, torch.maximum(peak, force), peak)
      error = (env.scene["cube"].data.root_link_pos_w - goal).norm(dim=-1).float()
      final = torch.where(playing, error, final)
      length += playing
      failed |= playing & terminated
      playing &= ~(terminated | truncated)
      if done := (terminated | truncated).nonzero().flatten().tolist():
        env.reset(env_ids=done)
  assert length.tolist() == [100, 1, 33, *[100] * 5]
  # Not every hand gets hold of its cube.
  assert int((peak > 1.0).sum()) >= 4
  assert peak[[1, 7]].tolist() == [0.0, 0.0]
  with ManagerBasedRlEnv(configured(), device="cpu") as env:
    steps = itertools.count(1)
    result = evaluator().run(env, lambda _: act(env, next(steps)))
  overall = result.groups["all"]
  assert overall["failure_rate"].mean == pytest.approx(2 / 8)
  assert overall["peak_force"].mean == pytest.approx(float(peak.mean()), rel=1e-5)
  assert overall["final_error"].mean == pytest.approx(float(final.mean()), rel=1e-5)
  assert failed.tolist() == [False, True, True, *[False] * 5]
  # Sides tell worlds apart by where their cubes were at first.
  left, right = result.groups["left"], result.groups["right"]
  total = left["peak_force"].mean * left["peak_force"].count + right["peak_force"].mean * right["peak_force"].count
  assert total == pytest.approx(float(peak.sum()), rel=1e-5)
  assert left["peak_force"].count + right["peak_force"].count == 8


def fails_on_schedule(env: ManagerBasedRlEnv) -> torch.Tensor:
  """World 1 on its first step, world 2 on its 33rd, when its cube has just been put between the fingers."""
  step = torch.zeros(env.num_envs, dtype=torch.int64)
  step[1], step[2] = 1, 33
  return env.episode_length_buf == step


def test_a_policy_that_does_nothing_never_succeeds() -> None:
  with ManagerBasedRlEnv(evaluator().configure(lift_cube_env()), device="cpu") as env:
    result = evaluator().run(env, lambda _: torch.zeros(8, 7))
  overall = result.groups["all"]
  assert (overall["success_rate"].mean, overall["peak_force"].mean) == (0.0, 0.0)
  assert overall["time_to_success"].count == overall["drop_rate"].count == 0
  assert 0.15 < overall["final_error"].mean < 0.6


def test_results_are_grouped_by_object_by_width_and_by_start() -> None:
  def environment() -> ManagerBasedRlEnvCfg:
    cfg = evaluator().configure(lift_objects_env())
    entity: Any = cfg.scene.entities["object"]
    entity.assignment = (
      "cube_30mm",
      "brick",
      "ball_50mm",
      "ball_50mm",
      "cylinder",
      "cube_40mm",
      "capsule",
      "cube_50mm",
    )
    return cfg

  with ManagerBasedRlEnv(environment(), device="cpu") as env:
    term, steps = lift_command(env, "lift_height"), 0
    near: list[bool] = []

    def policy(observations: object) -> torch.Tensor:
      nonlocal steps
      del observations
      if not steps:
        near.extend(((term.object_pos_w - env.scene.env_origins)[:, 0] <= 0.31).tolist())
      steps += 1
      # Worlds 1 (30 mm), 2 and 3 (50 mm), and 4 (40 mm) succeed.
      place(env, term.command.numpy(), "object", slice(1, 5))
      return torch.zeros(8, 7)

    result = evaluator().run(env, policy)
  rate = {name: metrics["success_rate"] for name, metrics in result.groups.items()}
  assert {name: (found.mean, found.count) for name, found in rate.items() if "mm" in name or name in OBJECTS} == {
    "cube_30mm": (0.0, 1),
    "cube_40mm": (0.0, 1),
    "cube_50mm": (0.0, 1),
    "brick": (1.0, 1),
    "ball_40mm": (pytest.approx(float("nan"), nan_ok=True), 0),
    "ball_50mm": (1.0, 2),
    "cylinder": (1.0, 1),
    "capsule": (0.0, 1),
    "30 mm": (0.5, 2),
    "35 mm": (0.0, 1),
    "40 mm": (0.5, 2),
    "50 mm": (pytest.approx(2 / 3), 3),
  }
  assert rate["near"].count == sum(near)
  assert rate["near"].mean == pytest.approx(sum(near[1:5]) / sum(near))
  assert rate["all"].mean == 0.5
  assert result.groups["brick"]["time_to_success"].mean == pytest.approx(1.0, abs=0.03)


def test_only_the_target_of_several_objects_counts() -> None:
  with ManagerBasedRlEnv(evaluator().configure(three_cubes()), device="cpu") as env:
    result = evaluator().run(env, lambda _: torch.zeros(8, 7))
  counts = {name: metrics["success_rate"].count for name, metrics in result.groups.items()}
  assert sum(counts.get(name, 0) for name in ("red", "green", "blue")) == 8


def test_many_widths_are_thirds() -> None:
  thirds = _by_width(torch.linspace(0.03, 0.05, 31))
  assert list(thirds) == ["to 36.7 mm", "36.7 to 43.3 mm", "above 43.3 mm"]
  assert torch.stack(list(thirds.values())).sum(0).eq(1).all()
  assert [int(mask.sum()) for mask in thirds.values()] == [11, 10, 10]


def test_no_group_of_widths_is_empty_where_most_worlds_have_the_same() -> None:
  groups = _by_width(torch.cat((torch.full((21,), 0.04), torch.linspace(0.05, 0.055, 6))))
  assert {name: int(mask.sum()) for name, mask in groups.items()} == {"to 40.0 mm": 21, "above 40.0 mm": 6}


def test_what_cannot_be_evaluated_is_refused() -> None:
  assert lift_cube().evaluator == LiftEvaluation()
  cfg = lift_cube_env()
  cfg.metrics["held"] = None
  with pytest.raises(ConfigError, match="needs metrics held"):
    evaluator().configure(cfg)
  with pytest.raises(ConfigError, match="'lift' is not a lift command; commands: lift_height"):
    LiftEvaluation(command="lift").configure(lift_cube_env())
  with pytest.raises(ConfigError, match=r"held for 1 s, but a goal lasts 0\.8 s"):
    LiftEvaluation(seconds=0.8).configure(lift_cube_env())
