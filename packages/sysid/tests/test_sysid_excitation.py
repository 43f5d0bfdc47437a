"""Excitations give more information than a slow sine, within the limits of the robot."""

import dataclasses
from typing import Any

import mujoco
import numpy as np
import pytest
from mjlab_core import MjlabError
from mjlab_sysid import Excitation, ExcitationCfg, Robot, design_excitation, identify, parse_term
from mjlab_sysid.worlds import Worlds
from sysid_robots import SERVOS, arm, changed, record

TERMS = [parse_term(text) for text in ("armature:.*", "viscous_damping:knee", "frictionloss:.*", "delay:.*,shared")]
CFG = ExcitationCfg(seconds=1.8, rounds=2, candidates=3, velocity=8.0, noise=3e-4)


def strict_arm(**stand: Any) -> Robot:
  servo = dataclasses.replace(SERVOS[0], effort_limit=8.0, velocity_limit=5.0)
  return arm((servo,), **stand)


@pytest.fixture(scope="module")
def designed() -> tuple[Robot, Excitation]:
  robot = strict_arm(pose={"hip": 0.3, "knee": -0.6})
  return robot, design_excitation(robot, TERMS, CFG)


def test_the_smallest_singular_value_rises(designed: tuple[Robot, Excitation]) -> None:
  _, found = designed
  assert found.after.singular_values[-1] > 1.2 * found.before.singular_values[-1]
  assert len(found.after.std) == len(found.parameters) == 6
  assert "smallest singular value: " in found.summary()


def test_mujoco_follows_the_commands_within_all_limits(designed: tuple[Robot, Excitation]) -> None:
  robot, found = designed
  assert set(found.commands.signals) == {"position_target"}
  commands = found.commands.signals["position_target"]
  made = record(robot, robot.model, commands, signals=("position", "velocity", "effort"))
  np.testing.assert_allclose(made.signals["position"], found.record.signals["position"], atol=1e-6)
  share = CFG.share * (1.0 + 1e-6)
  assert np.abs(made.signals["velocity"]).max() <= share * 5.0
  assert np.abs(made.signals["effort"]).max() <= share * 8.0
  for column, name in enumerate(found.record.joints):
    low, high = robot.ranges()[name]
    middle = robot.pose[robot.addresses([name])[0]]
    assert np.abs(made.signals["position"][:, column] - middle).max() <= share * min(high - middle, middle - low)
  # The excitation is as large as a limit allows.
  fast = [peak for peak in found.peaks if peak.signal != "position"]
  assert max(max(-peak.lowest, peak.highest) / peak.limits[1] for peak in fast) > 0.6 * CFG.share
  np.testing.assert_allclose(commands[[0, -1]], robot.pose[None].repeat(2, 0), atol=1e-9)


def touches(robot: Robot, found: Excitation) -> bool:
  data = mujoco.MjData(robot.model)
  for data.qpos[:] in found.record.signals["position"]:
    mujoco.mj_fwdPosition(robot.model, data)
    if data.ncon:
      return True
  return False


def test_the_robot_does_not_touch_the_floor() -> None:
  pose, cfg = {"hip": 0.9, "knee": -0.9}, dataclasses.replace(CFG, rounds=1, candidates=2, seconds=1.5)
  high, low = (strict_arm(pose=pose, floor=floor) for floor in (0.3, 0.565))
  free, careful = (design_excitation(robot, TERMS[:1], cfg) for robot in (high, low))
  assert touches(low, free)
  assert not touches(low, careful)


def test_a_record_of_the_excitation_finds_the_parameters(designed: tuple[Robot, Excitation]) -> None:
  robot, found = designed
  factors = {"dof_armature:hip": 1.4, "dof_frictionloss:knee": 1.5}
  made = record(robot, changed(robot, factors), found.commands.signals["position_target"], noise=3e-4)
  fitted = identify(robot, [made], TERMS)
  for estimate in fitted.estimates:
    assert estimate.identifiable
    if estimate.parameter.name in factors:
      assert estimate.number == pytest.approx(factors[estimate.parameter.name], rel=0.05)


def test_a_single_joint_moves_and_a_search_can_be_ended(
  designed: tuple[Robot, Excitation], monkeypatch: pytest.MonkeyPatch
) -> None:
  robot, _ = designed
  seen: list[int] = []

  def stop(progress: Any) -> bool:
    seen.append(progress.iteration)
    # No candidate of a later round is rolled out.
    monkeypatch.delattr(Worlds, "step")
    return True

  terms = [parse_term("armature:knee")]
  found = design_excitation(robot, terms, dataclasses.replace(CFG, candidates=2), joints="knee", on_iteration=stop)
  assert (found.stopped, seen, found.record.joints) == (True, [1], ("knee",))


def test_a_pose_at_the_end_of_a_joint_is_refused() -> None:
  with pytest.raises(MjlabError, match="joint 'knee' stands at the end of its range"):
    design_excitation(strict_arm(pose={"knee": np.radians(150.0)}), TERMS, CFG)
  with pytest.raises(MjlabError, match="pattern 'ankle' matches no driven joint"):
    design_excitation(strict_arm(), TERMS, CFG, joints="ankle")
