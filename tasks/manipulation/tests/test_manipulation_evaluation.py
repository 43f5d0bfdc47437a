"""The evaluation of lifting, of policies of which it is known how well they do."""

import pytest
import torch
from manipulation_worlds import place
from mjlab_envs import ManagerBasedRlEnv
from mjlab_manipulation import LiftEvaluation, lift_cube, lift_cube_env
from mjlab_manipulation.mdp import lift_command
from mjlab_rl import EvaluationError


def evaluator() -> LiftEvaluation:
  return LiftEvaluation(episodes=8, seconds=2.0)


def test_a_hand_of_providence_succeeds_as_often_and_as_fast_as_it_did() -> None:
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
  everybody = result.groups["all"]
  assert everybody["success_rate"].mean == pytest.approx(5 / 8)
  # A second on end, from then on.
  assert everybody["time_to_success"].mean == pytest.approx(20 * 0.02 + 1.0)
  assert everybody["time_to_success"].count == 5
  assert everybody["lift_rate"].mean == pytest.approx(6 / 8)
  assert everybody["drop_rate"].mean == pytest.approx(1 / 6)
  assert everybody["failure_rate"].mean == 0.0
  assert set(result.groups) == {"all", "near", "far", "left", "right"}
  assert sum(result.groups[name]["success_rate"].count for name in ("near", "far")) == 8
  assert "success_rate" in result.table()


def test_a_policy_that_does_nothing_never_succeeds() -> None:
  with ManagerBasedRlEnv(evaluator().configure(lift_cube_env()), device="cpu") as env:
    result = evaluator().run(env, lambda _: torch.zeros(8, 7))
  everybody = result.groups["all"]
  assert (everybody["success_rate"].mean, everybody["peak_force"].mean) == (0.0, 0.0)
  assert everybody["time_to_success"].count == everybody["drop_rate"].count == 0
  assert 0.15 < everybody["final_error"].mean < 0.6


def test_what_cannot_be_evaluated_is_refused() -> None:
  assert lift_cube().evaluator == LiftEvaluation()
  cfg = lift_cube_env()
  cfg.metrics["held"] = None
  with pytest.raises(EvaluationError, match="metrics held are measured"):
    evaluator().configure(cfg)
  with pytest.raises(EvaluationError, match="'lift' is no lift command; there are: lift_height"):
    LiftEvaluation(command="lift").configure(lift_cube_env())
