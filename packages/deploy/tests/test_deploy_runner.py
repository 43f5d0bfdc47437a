"""The runner drives a loopback robot, and switches to damping within 20 ms when anything is wrong."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from deploy_bundles import DEFAULT, DESCRIPTION, HINGE, write_bundle
from mjlab_deploy import Bundle, DeployError, Description, open_bundle
from mjlab_deploy.robot.robot_io import RobotCommand, RobotInfo, RobotState
from mjlab_deploy.robot.runner import Runner
from mjlab_deploy.robot.safety import Safety, SafetyLimits
from mjlab_deploy.simulation.loopback import LoopbackRobot

MESSAGE = 0.002  # s
IN_TIME = 0.020  # s
SLOW = replace(HINGE, velocity_limit=1.0, effort_limit=0.05)
STILL, UPRIGHT = np.zeros(1), np.array([1.0, 0.0, 0.0, 0.0])
STATE = RobotState(time=0.0, sequence=5, position=STILL, velocity=STILL, gyro=np.zeros(3), orientation=UPRIGHT)


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
    # The policy settles where its linear feedback balances; 9 is limited to 0.5, the end of the range.
    where = float(robot.data.qpos[0])
    assert np.sign(where - 0.1) == np.sign(command), where
    if command == 9.0:
      assert where < 0.5
  runner.stop()
  advance(robot, runner, 0.01)
  assert robot.is_damped


def break_measurement(robot: FaultyRobot, runner: Runner) -> None:
  state = robot.read()
  assert state is not None
  robot.frozen = replace(state, gyro=np.array([0.0, np.nan, 0.0]))


@pytest.mark.parametrize(
  ("fault", "until_noticed", "reason"),
  [
    (lambda robot, runner: setattr(robot, "loss", 1.0), 0.0, "no state for"),
    (lambda robot, runner: setattr(robot, "frozen", robot.read()), 0.0, "sensors are frozen"),
    (break_measurement, 0.0, "a measurement is not finite"),
    (lambda robot, runner: robot.data.qvel.fill(40.0), 0.0, "joint 'hinge' moves at"),
    # The next step of the policy is up to 20 ms away.
    (lambda robot, runner: runner.policy.replace_last_action(np.array([np.nan])), 0.02, "action is not finite"),
    (lambda robot, runner: setattr(runner, "policy", None), 0.02, "AttributeError: 'NoneType' object"),
  ],
)
def test_a_fault_ends_in_damping(
  bundle: Bundle, fault: Callable[[FaultyRobot, Runner], None], until_noticed: float, reason: str
) -> None:
  robot, runner = driven(bundle)
  fault(robot, runner)
  advance(robot, runner, until_noticed + IN_TIME)
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
  while not robot.is_damped and robot.time < 5.0:
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
  assert robot.is_damped
  assert robot.time - exceeded <= IN_TIME
  assert "messages were lost" in runner.reason


def test_commands_arrive_late(bundle: Bundle) -> None:
  robot, damped = LoopbackRobot(bundle, delay=2), []
  for _ in range(4):
    robot.write(RobotCommand(position=np.zeros(1), stiffness=np.ones(1), damping=np.ones(1)))
    robot.advance()
    damped.append(robot.is_damped)
  assert damped == [True, True, False, False]


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


def limited(description: Description, state: RobotState, target: float) -> float:
  """Return a target after one at 0, within the limits of a robot."""
  return float(Safety(description, SafetyLimits()).limited(np.array([target]), np.zeros(1), state)[0])


def test_targets_stay_within_ranges_torques_and_steps() -> None:
  moving = replace(STATE, position=np.array([0.3]), velocity=np.array([0.5]))
  # Effort limit 5 at kp 20: a target more than 0.25 rad away asks for nothing more; kd shifts its centre.
  assert limited(DESCRIPTION, moving, 50.0) == pytest.approx(0.3 + 0.1 * 0.5 + 0.25)
  assert limited(DESCRIPTION, replace(STATE, position=np.array([1.95])), 50.0) <= 2.0
  slow = replace(DESCRIPTION, robot=replace(DESCRIPTION.robot, joints=(SLOW,)))
  # 0.02 s at 1 rad/s, and twice the reach of the servo, 0.05 / 20.
  assert limited(slow, replace(STATE, position=np.array([0.024])), 1.0) == pytest.approx(0.02 + 2.0 * 0.0025)


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
  assert safety.check_message(STATE) is None
  found = safety.check_message(replace(STATE, **({"sequence": 6} | change)))
  assert found == reason


def test_gains_grow_at_the_start(bundle: Bundle) -> None:
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
