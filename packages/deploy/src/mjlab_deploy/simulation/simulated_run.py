"""A policy in MuJoCo C through the messages of a robot, with or without a window."""

import importlib
import time
from collections.abc import Sequence

import numpy as np

from mjlab_deploy.arrays import Arrays
from mjlab_deploy.bundle import Bundle
from mjlab_deploy.errors import DeployError
from mjlab_deploy.robot.gamepad import connected_gamepad
from mjlab_deploy.robot.runner import Runner
from mjlab_deploy.robot.safety import SafetyLimits
from mjlab_deploy.simulation.loopback import RATE, LoopbackRobot

_STAND_TIME = 1.0
_PUSH_EVERY, _PUSH = 3.0, 0.5
# Keys of GLFW: which column of the first command they change, and by how much of its range.
_KEYS = {265: (0, 0.1), 264: (0, -0.1), 263: (1, 0.1), 262: (1, -0.1), 44: (2, 0.1), 46: (2, -0.1)}
_STOP_KEY = 32


class SimulatedRun:
  """The loopback robot of a bundle and the runner that drives it.

  Args:
    bundle: The bundle.
    latency: Delay of messages in each direction [s].
    pushes: Push a floating robot now and then.
    command: Values of the first command.

  Raises:
    DeployError: The policy cannot be run, or takes no such command.
  """

  def __init__(
    self,
    bundle: Bundle,
    *,
    latency: float = 0.0,
    pushes: bool = False,
    command: Sequence[float] = (),
  ) -> None:
    self.robot = LoopbackRobot(bundle, delay=round(latency * RATE))
    # A message is `latency` old when it arrives.
    limits = SafetyLimits(stale_after=SafetyLimits().stale_after + 2.0 * latency)
    self.robot.watchdog += 2.0 * latency
    self.runner = Runner(bundle, self.robot, limits, stand_time=_STAND_TIME)
    if command:
      values = next(iter(self.runner.command.values()), np.empty(0))
      if len(command) != len(values):
        raise DeployError(f"the policy's command has {len(values)} numbers, got {len(command)}")
      values[:] = command
    self._pushes, self._next_push = pushes and bundle.description.robot.is_floating, _STAND_TIME + _PUSH_EVERY
    self._rng = np.random.default_rng(0)
    self._rows: list[Arrays] = []

  def advance(self) -> None:
    """Advance by one message."""
    robot, runner = self.robot, self.runner
    if self._pushes and robot.time >= self._next_push:
      robot.data.qvel[:2] += self._rng.uniform(-_PUSH, _PUSH, 2)
      self._next_push += _PUSH_EVERY
    robot.advance()
    if runner.reason == "not started" and robot.read() is not None:
      runner.start()
    runner.tick(robot.time)
    if (state := robot.read()) is not None:
      row = {"time": np.array(state.time), "position": state.position, "velocity": state.velocity}
      row |= {"target": runner.targets.copy(), "is_policy": np.array(float(runner.phase == "policy"))}
      self._rows.append(row | {name.replace("/", "_"): value.copy() for name, value in runner.command.items()})

  def run(self, seconds: float) -> None:
    """Run as fast as possible, until the time is over or the runner returns to damping."""
    while self.robot.time < seconds:
      self.advance()
      if self.runner.phase == "damping" and self.runner.reason != "not started":
        return

  def watch(self, seconds: float | None = None) -> None:
    """Run in real time in MuJoCo's viewer, with keys and a gamepad, until it is closed or the time is over."""
    viewer = importlib.import_module("mujoco.viewer")
    gamepad = connected_gamepad()
    start = time.monotonic()
    with viewer.launch_passive(self.robot.model, self.robot.data, key_callback=self.press) as window:
      while window.is_running() and (seconds is None or self.robot.time < seconds):
        while self.robot.time < time.monotonic() - start:
          self.advance()
        if gamepad is not None:
          gamepad.apply(self.runner)
        window.sync()

  def press(self, key: int) -> None:
    """Take a key: arrows and comma and dot change the command, the space bar stops."""
    if key == _STOP_KEY:
      self.runner.stop()
    commands = self.runner.description.commands
    if key in _KEYS and commands:
      column, share = _KEYS[key]
      ranges = list(commands[0].ranges.values())
      if column < len(ranges):
        low, high = ranges[column]
        values = self.runner.command[commands[0].input]
        values[column] = np.clip(values[column] + share * (high - low), low, high)

  def summary(self) -> str:
    """Return the result in one line."""
    if self.runner.phase == "damping":
      return f"damping after {self.robot.time:.2f} s: {self.runner.reason}"
    log = self.log()
    error = np.abs(log["position"] - log["target"])[log["is_policy"] > 0]
    mean = float(error.mean()) if error.size else 0.0
    return f"ran {self.robot.time:.1f} s; joints are {mean:.3f} rad from their targets on average"

  def log(self) -> Arrays:
    """Return times, measured and commanded joints and commands, one row per message."""
    return {name: np.stack([row[name] for row in self._rows]) for name in (self._rows or [{}])[0]}
