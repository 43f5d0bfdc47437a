"""The evaluation of tracking against manual rollouts of its episodes, terminal states included."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_core.rotations import quat_apply, quat_conjugate, quat_error_magnitude, quat_mul, quat_yaw
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_rl import play_first_episodes
from mjlab_tracking import TrackingEvaluation
from mjlab_tracking.evaluation import UNITS
from mjlab_tracking.g1 import BODIES, END_EFFECTORS, g1_flat_env
from mjlab_tracking.mdp import motion
from tracking_env import command, still

REPEATS = 3
NAMES = [name for name in UNITS if name != "survived"]


def evaluator() -> TrackingEvaluation:
  return TrackingEvaluation(end_effectors=END_EFFECTORS, repeats=REPEATS)


def configured(folder: Path) -> ManagerBasedRlEnvCfg:
  return evaluator().configure(still(folder))


def act(step: int) -> torch.Tensor:
  """Return wild actions for worlds that fall, and zeros for worlds that reach the end of their clip."""
  wild = 8.0 * torch.randn(6, 29, generator=torch.Generator().manual_seed(step))
  return wild * torch.tensor([1.0, 1.0, 0.0, 0.0, 0.3, 0.0])[:, None]


def policy() -> Callable[[object], torch.Tensor]:
  """Return the same actions in the same steps."""
  steps = itertools.count(1)
  return lambda _: act(next(steps))


@pytest.fixture(scope="module")
def expected(folder: Path) -> tuple[list[dict[str, list[float]]], list[bool]]:
  """Return errors of each world's first episode from body poses at the end of each step, and failures."""
  cfg = configured(folder)
  cfg.auto_reset = False
  found: list[dict[str, list[float]]] = [{name: [] for name in NAMES} for _ in range(6)]
  failed, playing = [False] * 6, [True] * 6
  feet = [BODIES.index(body) for body in END_EFFECTORS]
  torso = BODIES.index("torso_link")
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    env.reset(seed=0)
    term = motion(env, "motion")
    for step in range(1, 60):
      # The target of this step is the one that the policy saw before it.
      wanted = [part.clone() for part in (term.body_pos_w, term.body_quat_w, term.joint_vel)]
      _, _, terminated, truncated, _ = env.step(act(step))
      pos, quat = term.robot_body_pos_w, term.robot_body_quat_w
      for w in [w for w in range(6) if playing[w]]:
        ref_pos, ref_quat = wanted[0][w], wanted[1][w]
        turn = quat_yaw(quat_mul(quat[w, torso], quat_conjugate(ref_quat[torso])))
        arm = quat_apply(turn.expand(14, 4), ref_pos - ref_pos[torso])
        laid = arm + torch.cat((pos[w, torso, :2], ref_pos[torso, 2:]))
        angles = quat_error_magnitude(quat_mul(turn.expand(14, 4), ref_quat), quat[w])
        values = {
          "mpkpe": (ref_pos - pos[w]).norm(dim=-1).mean(),
          "r_mpkpe": (arm + pos[w, torso] - pos[w]).norm(dim=-1).mean(),
          "joint_vel_error": (wanted[2][w] - env.scene["robot"].data.joint_vel[w]).square().mean().sqrt(),
          "ee_pos_error": (laid - pos[w])[feet].norm(dim=-1).mean(),
          "ee_ori_error": angles[feet].mean(),
        }
        for name, value in values.items():
          found[w][name].append(value.item())
        if terminated[w] or truncated[w]:
          playing[w], failed[w] = False, bool(terminated[w])
      if done := (terminated | truncated).nonzero().flatten().tolist():
        env.reset(env_ids=done)
      if not any(playing):
        break
  assert not any(playing)
  return found, failed


def test_every_error_of_a_step_is_that_of_its_last_state(folder: Path, expected: Any) -> None:
  errors_of, failed = expected
  lengths = [len(errors["mpkpe"]) for errors in errors_of]
  # Both kinds of ends, and different lengths.
  assert set(failed) == {True, False}
  assert len(set(lengths)) >= 3
  with ManagerBasedRlEnv(configured(folder), device="cpu") as env:
    played = play_first_episodes(
      env, policy(), lambda: {name: env.metrics_manager.get_value(name) for name in NAMES}, max_steps=60, seed=0
    )
  assert played.length.tolist() == lengths
  assert played.has_failed.tolist() == failed
  for world, errors in enumerate(errors_of):
    for name, values in errors.items():
      found = played.values[name][: lengths[world], world]
      np.testing.assert_allclose(found, values, rtol=1e-4, err_msg=f"world {world}, {name}")


def test_the_summary_has_success_over_whole_clips_by_clip_and_by_second(folder: Path, expected: Any) -> None:
  errors_of, failed = expected
  with ManagerBasedRlEnv(configured(folder), device="cpu") as env:
    result = evaluator().run(env, policy())
  assert list(result.groups) == ["all", "a_squat", "b_march"]
  for group, worlds in (("all", range(6)), ("a_squat", (0, 2, 4)), ("b_march", (1, 3, 5))):
    metrics = result.groups[group]
    assert metrics["success_rate"].mean == pytest.approx(1.0 - np.mean([failed[w] for w in worlds]))
    assert metrics["survived"].mean == pytest.approx(0.02 * np.mean([len(errors_of[w]["mpkpe"]) for w in worlds]))
    means = [np.mean(errors_of[w]["mpkpe"]) for w in worlds]
    assert metrics["mpkpe"].mean == pytest.approx(np.mean(means), rel=1e-4)
  # Clips of less than a second have one point.
  assert [len(line) for line in result.curves["mpkpe"].values()] == [1, 1, 1]
  assert 0.0 < result.curves["playing"]["all"][0] < 1.0


def test_a_world_that_fails_on_its_first_step_counts_with_that_step(folder: Path) -> None:
  cfg = evaluator().configure(still(folder))
  # With this threshold every first step is a failure.
  term: Any = cfg.terminations["anchor_pos"]
  term.params["threshold"] = -1.0
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    result = evaluator().run(env, lambda _: torch.zeros(6, 29))
  metrics = result.groups["all"]
  assert metrics["success_rate"].mean == 0.0
  assert metrics["survived"].mean == pytest.approx(0.02)
  assert 0.0 < metrics["mpkpe"].mean < 0.02
  assert metrics["mpkpe"].count == 6


def test_two_evaluations_with_one_seed_are_the_same(folder: Path) -> None:
  def judge(seed: int) -> dict[str, Any]:
    judged = TrackingEvaluation(end_effectors=END_EFFECTORS, repeats=1, seed=seed)
    cfg = g1_flat_env()
    command(cfg).motion = str(folder)
    with ManagerBasedRlEnv(judged.configure(cfg), device="cpu") as env:
      return judged.run(env, lambda _: torch.zeros(2, 29)).to_json()

  assert judge(1) == judge(1)
  assert judge(1) != judge(2)


def test_a_task_without_a_motion_is_refused() -> None:
  cfg = g1_flat_env()
  cfg.commands = {}
  with pytest.raises(ConfigError, match="'motion' is not a motion command"):
    evaluator().configure(cfg)
