"""Gamepad commands, read by GLFW, which MuJoCo's viewer brings along."""

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mjlab_deploy.robot.runner import Runner

Reading = tuple[Sequence[float], Sequence[int]]
"""Axes from -1 to 1 and buttons of a gamepad, in GLFW's standard order."""
_DEAD_BAND = 0.1
# Axis of the stick and its sign for forward, left and turn to the left.
_STICKS = ((1, -1.0), (0, -1.0), (2, -1.0))
_STOP_BUTTON = 1


class Gamepad:
  """Gamepad that steers a runner: left stick forward and sideways, right stick turns, button B stops it.

  Args:
    read: Returns the present reading; None while no gamepad is connected.
  """

  def __init__(self, read: Callable[[], Reading | None]) -> None:
    self._read = read
    self._steers = False

  def apply(self, runner: Runner) -> None:
    """Write the sticks into the runner's first command, as shares of its range; released sticks give zero once."""
    if (reading := self._read()) is None:
      return
    axes, buttons = reading
    if buttons[_STOP_BUTTON]:
      runner.stop()
    commands = runner.description.commands
    sticks = np.array([sign * axes[axis] for axis, sign in _STICKS])
    sticks[np.abs(sticks) < _DEAD_BAND] = 0.0
    if not commands or not (self._steers or sticks.any()):
      return
    self._steers = bool(sticks.any())
    values = runner.command[commands[0].input]
    for column, (stick, (low, high)) in enumerate(zip(sticks, commands[0].ranges.values(), strict=False)):
      values[column] = stick * (high if stick > 0.0 else -low)


def connected_gamepad() -> Gamepad | None:
  """Return the first gamepad, which may also be connected later; None without GLFW or a screen."""
  try:
    glfw: Any = importlib.import_module("glfw")
  except ImportError:
    return None
  if not glfw.init():
    return None

  def read() -> Reading | None:
    for number in range(glfw.JOYSTICK_1, glfw.JOYSTICK_LAST + 1):
      if glfw.joystick_is_gamepad(number) and (state := glfw.get_gamepad_state(number)) is not None:
        return list(state.axes), list(state.buttons)
    return None

  return Gamepad(read)
