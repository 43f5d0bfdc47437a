"""A gamepad steers a run, and a plot shows its joints."""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from mjlab_deploy import Bundle
from mjlab_deploy.command import main
from mjlab_deploy.robot.gamepad import Gamepad, connected_gamepad
from mjlab_deploy.simulation.simulated_run import SimulatedRun

BUTTONS = [0] * 15


def test_sticks_set_shares_of_the_range_and_a_button_stops(bundle: Bundle) -> None:
  run = SimulatedRun(bundle, command=[0.3])
  value = run.runner.command["command/angle"]
  reading: Any = None
  gamepad = Gamepad(lambda: reading)
  gamepad.apply(run.runner)
  # A stick at rest is not exactly at zero, and does not replace the command of the keyboard.
  reading = ([0.02, -0.05, 0.0, 0.0, -1.0, -1.0], BUTTONS)
  gamepad.apply(run.runner)
  np.testing.assert_allclose(value, 0.3)
  # Up is negative.
  for axis, wanted in ((-1.0, 0.5), (0.5, -0.25), (0.0, 0.0)):
    reading = ([0.0, axis, 0.0, 0.0, -1.0, -1.0], BUTTONS)
    gamepad.apply(run.runner)
    np.testing.assert_allclose(value, wanted)
  reading = ([0.0] * 6, [0, 1, *BUTTONS[2:]])
  gamepad.apply(run.runner)
  assert run.runner.reason == "stopped by the operator"


def glfw(starts: bool) -> SimpleNamespace:
  """Return the functions of GLFW that read gamepads; the second device is one."""
  state = SimpleNamespace(axes=(0.0, -1.0, 0.0, 0.0, -1.0, -1.0), buttons=bytes(15))
  return SimpleNamespace(
    JOYSTICK_1=0,
    JOYSTICK_LAST=3,
    init=lambda: starts,
    joystick_is_gamepad=lambda number: number == 1,
    get_gamepad_state={1: state}.get,
  )


def test_the_first_gamepad_of_glfw_is_read(bundle: Bundle, monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setitem(sys.modules, "glfw", glfw(starts=False))
  assert connected_gamepad() is None
  monkeypatch.setitem(sys.modules, "glfw", glfw(starts=True))
  gamepad = connected_gamepad()
  assert gamepad is not None
  run = SimulatedRun(bundle)
  gamepad.apply(run.runner)
  np.testing.assert_allclose(run.runner.command["command/angle"], 0.5)


def test_a_plot_shows_targets_and_positions(bundle: Bundle, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  folder, picture = bundle.folder, tmp_path / "joints.png"
  assert main(["run", str(folder), "--seconds", "1.5", "--command", "0.4", "--plot", str(picture)]) == 0
  assert f"wrote {picture}" in capsys.readouterr().out
  pixels = 255.0 * imread(picture)[..., :3]
  for colour in ((31, 119, 180), (255, 127, 14)):
    assert (np.abs(pixels - colour).max(axis=2) < 20).sum() > 50
  assert main(["run", str(folder), "--seconds", "0.1", "--plot", str(tmp_path / "joints.xyz")]) == 1
  assert "joints.xyz: Format 'xyz' is not supported" in capsys.readouterr().err
