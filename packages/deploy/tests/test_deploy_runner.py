"""The runner drives a loopback robot, and switches to damping within 20 ms when anything is wrong."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from deploy_bundles import DEFAULT, DESCRIPTION, write_bundle
from mjlab_deploy import Bundle, DeployError, open_bundle
from mjlab_deploy.loopback import LoopbackRobot
from mjlab_deploy.robot_io import RobotCommand, RobotInfo, RobotState
from mjlab_deploy.runner import Runner
from mjlab_deploy.safety import Safety, SafetyLimits

MESSAGE = 0.002  # s
IN_TIME = 0.020  # s
SLOW = replace(DESCRIPTION.robot.joints[0], velocity_limit=1.0, effort_limit=0.05)


class FaultyRobot(LoopbackRobot):
  """Loopback robot whose messages get lost in both directions, or whose sensors hang."""

  def __init__(self, bundle: Bundle, *, loss: float = 0.0, seed: int = 0, **options: Any) -> None:
    super().__init__(bundle, **options)
    self.loss, self._losses = loss, np.random.default_rng(seed)
    self.frozen: RobotState | None = None
    self._arrived: RobotState | None = None

  def advance(self) -> None:
    super().advance()
    state = super().read()
    if state is not None and self._losses.random() >= self.loss:
      repeated = self.frozen or state
      self._arrived = replace(repeated, sequence=state.sequence, time=state.time)

  def read(self) -> RobotState | None:
    return self._arrived

  def write(self, command: RobotCommand) -> None:
    if self._losses.random() >= self.loss:
      super().write(command)


def advance(robot: LoopbackRobot, runner: Runner | None, seconds: float) -> None:
  for _ in range(round(seconds / MESSAGE)):
    robot.advance()
    if runner is not None:
      runner.tick(robot.time)


def driven(bundle: Bundle, **options: Any) -> tuple[FaultyRobot, Runner]:
  """A robot that the policy drives."""
  robot = FaultyRobot(bundle, **options)
  runner = Runner(bundle, robot, stand_time=0.5)
  advance(robot, runner, 0.02)
  assert robot.is_damped
  runner.start()
  advance(robot, runner, 0.02)
  assert runner.phase == "stand"
  advance(robot, runner, 0.5)
  assert runner.phase == "policy", runner.reason
  return robot, runner


def test_the_policy_of_an_arm_begins_in_the_default_pose_in_spite_of_gravity(bundle: Bundle) -> None:
  robot = LoopbackRobot(bundle)
  robot.model.opt.gravity[2] *= 15.0
  runner = Runner(bundle, robot, stand_time=0.5)
  advance(robot, runner, 0.02)
  runner.start()
  while runner.phase != "policy":
    advance(robot, runner, MESSAGE)
    assert runner.phase != "damping", runner.reason
  # The servo alone sags to 0.16 rad.
  assert float(robot.data.qpos[0]) == pytest.approx(DEFAULT, abs=0.02)


@pytest.mark.parametrize(("delay", "loss"), [(0, 0.0), (1, 0.0), (0, 0.003)])
def test_the_policy_follows_commands_through_the_loopback(bundle: Bundle, delay: int, loss: float) -> None:
  robot, runner = driven(bundle, delay=delay, loss=loss)
  for command in (0.4, -0.4, 9.0):
    runner.command["command/angle"][:] = command
    advance(robot, runner, 1.5)
    assert runner.phase == "policy", runner.reason
    # The policy settles where its linear law balances; 9 is limited to 0.5, the end of the range.
    where = float(robot.data.qpos[0])
    assert np.sign(where - 0.1) == np.sign(command), where
    if command == 9.0:
      assert where < 0.5
  runner.stop()
  advance(robot, runner, 0.01)
  assert robot.is_damped


def break_measurement(robot: FaultyRobot) -> None:
  state = robot.read()
  assert state is not None
  robot.frozen = replace(state, gyro=np.array([0.0, np.nan, 0.0]))


@pytest.mark.parametrize(
  ("fault", "reason"),
  [
    (lambda robot: setattr(robot, "loss", 1.0), "no state for"),
    (lambda robot: setattr(robot, "frozen", robot.read()), "sensors are frozen"),
    (break_measurement, "a measurement is not finite"),
    (lambda robot: robot.data.qvel.fill(40.0), "joint 'hinge' moves at"),
  ],
)
def test_a_fault_of_the_robot_ends_in_damping(
  bundle: Bundle, fault: Callable[[FaultyRobot], None], reason: str
) -> None:
  robot, runner = driven(bundle)
  fault(robot)
  advance(robot, runner, IN_TIME)
  assert runner.phase == "damping"
  assert reason in runner.reason
  assert robot.is_damped
  # It stays there until an operator starts it again.
  robot.loss, robot.frozen = 0.0, None
  advance(robot, runner, 0.1)
  assert robot.is_damped


@pytest.mark.parametrize("seed", range(3))
def test_losing_every_twentieth_message_ends_in_damping(bundle: Bundle, seed: int) -> None:
  robot, runner = driven(bundle, seed=seed)
  robot.loss = 0.05
  last, lost, exceeded = robot.read(), [], math.inf
  while not robot.is_damped:
    robot.advance()
    state = robot.read()
    assert state is not None
    assert last is not None
    if state.sequence != last.sequence:
      lost += [True] * (state.sequence - last.sequence - 1) + [False]
      last = state
    if sum(lost[-100:]) >= 5:
      exceeded = min(exceeded, robot.time)
    runner.tick(robot.time)
  assert robot.time - exceeded <= IN_TIME
  assert "messages were lost" in runner.reason


def test_an_action_that_is_not_finite_ends_in_damping(bundle: Bundle) -> None:
  robot, runner = driven(bundle)
  runner.policy.replace_last_action(np.array([np.nan]))
  advance(robot, runner, 0.02 + IN_TIME)
  assert runner.reason == "the policy's action is not finite"
  assert robot.is_damped


def test_an_error_inside_the_runner_ends_in_damping(bundle: Bundle, monkeypatch: pytest.MonkeyPatch) -> None:
  robot, runner = driven(bundle)
  monkeypatch.setattr(runner.policy, "step", lambda readings: 1 / 0)
  advance(robot, runner, 0.02 + IN_TIME)
  assert "ZeroDivisionError" in runner.reason
  assert robot.is_damped


def test_a_killed_runner_ends_in_damping(bundle: Bundle) -> None:
  """The robot itself must notice: its drives damp when commands stop."""
  robot, _ = driven(bundle)
  assert not robot.is_damped
  advance(robot, None, IN_TIME + MESSAGE)
  assert robot.is_damped


@pytest.mark.parametrize(
  ("info", "message"),
  [
    ({"joint_names": ("elbow",)}, "joint 0 is 'hinge' in the bundle and 'elbow' on the robot"),
    ({"joint_names": ("hinge", "knee")}, "joint 1 is 'missing' in the bundle and 'knee' on the robot"),
    ({"stiffness": (21.0,)}, "stiffness of 'hinge' is 20 in the bundle and 21 on the robot"),
    ({"damping": (0.5,)}, "damping of 'hinge' is 2 in the bundle and 0.5 on the robot"),
    ({"rate": 20.0}, "the policy runs at 50 Hz, the robot sends 20 messages a second"),
  ],
)
def test_another_robot_is_refused(
  bundle: Bundle, monkeypatch: pytest.MonkeyPatch, info: dict[str, Any], message: str
) -> None:
  robot = LoopbackRobot(bundle)
  changed: RobotInfo = replace(robot.info(), **info)
  monkeypatch.setattr(robot, "info", lambda: changed)
  with pytest.raises(DeployError, match=message):
    Runner(bundle, robot)


def test_a_policy_with_an_input_that_nothing_supplies_is_refused(tmp_path: Path) -> None:
  folder = write_bundle(tmp_path / "bundle", replace(DESCRIPTION, commands=()))
  with open_bundle(folder) as bundle, pytest.raises(DeployError, match="does not supply command/angle"):
    Runner(bundle, LoopbackRobot(bundle))


def test_targets_stay_within_ranges_torques_and_steps(bundle: Bundle, monkeypatch: pytest.MonkeyPatch) -> None:
  robot, runner = driven(bundle)
  state = robot.read()
  assert state is not None
  asked = runner.safety.limited(np.array([50.0]), np.array([0.0]), state)
  # Effort limit 5 at kp 20: a target more than 0.25 rad away asks for nothing more; kd shifts its centre.
  assert asked[0] == pytest.approx(state.position[0] + 0.1 * state.velocity[0] + 0.25)
  near_the_end = replace(state, position=np.array([1.95]))
  assert abs(runner.safety.limited(np.array([50.0]), np.array([0.0]), near_the_end)[0]) <= 2.0


@pytest.mark.parametrize(
  ("change", "reason"),
  [
    ({"orientation": np.array([math.cos(0.55), math.sin(0.55), 0.0, 0.0])}, "tilted by 1.10 rad, more than 1"),
    ({"position": np.array([2.2])}, "joint 'hinge' is 0.20 rad outside of its range"),
    ({"sequence": 1}, "messages come in the wrong order"),
    ({}, None),
  ],
)
def test_a_state_outside_of_the_limits_is_named(change: dict[str, Any], reason: str | None) -> None:
  safety = Safety(replace(DESCRIPTION, robot=replace(DESCRIPTION.robot, is_floating=True)), SafetyLimits())
  still, upright = np.zeros(1), np.array([1.0, 0.0, 0.0, 0.0])
  state = RobotState(time=0.0, sequence=5, position=still, velocity=still, gyro=np.zeros(3), orientation=upright)
  assert safety.check_message(state) is None
  found = safety.check_message(replace(state, **({"sequence": 6} | change)))
  assert (found or "").startswith(reason or "")
  assert (found is None) == (reason is None)


def test_gains_and_targets_grow_at_the_start_and_targets_move_in_steps(bundle: Bundle) -> None:
  robot = LoopbackRobot(bundle)
  runner = Runner(bundle, robot, stand_time=0.5)
  advance(robot, runner, 0.02)
  sent: list[RobotCommand] = []
  write = robot.write
  robot.write = lambda command: (sent.append(command), write(command))[1]
  runner.start()
  advance(robot, runner, 0.6)
  gains = np.array([command.stiffness[0] for command in sent]) / 20.0
  assert gains[0] < 0.02
  assert np.diff(gains).max() < 0.02
  assert gains[-1] == 1.0
  state = robot.read()
  assert state is not None
  slow = Safety(replace(DESCRIPTION, robot=replace(DESCRIPTION.robot, joints=(SLOW,))), SafetyLimits())
  # 0.02 s at 1 rad/s, and twice the reach of the servo, 0.05 / 20.
  moved = replace(state, position=np.array([0.024]), velocity=np.zeros(1))
  asked = slow.limited(np.array([1.0]), np.array([0.0]), moved)
  assert asked[0] == pytest.approx(0.02 + 2.0 * 0.0025)
