"""Slider that moves the page through time."""

from __future__ import annotations

import viser

from mjlab_viewer.browser.inputs import Inputs
from mjlab_viewer.playback import Playback
from mjlab_viewer.replay import Replay

HISTORY = 10.0
"""Time that a user can go back while paused [s]."""


class TimeLine:
  """Slider of time: the seconds back from now of a simulation that is paused, or the time of each moment of a replay.

  Moving it pauses a replay at that moment, and Play goes on from there. In a simulation, Play returns to now.

  Args:
    gui: Place for the slider.
    playback: Steps the environment.
    inputs: Inputs that are read in the thread that owns the environment.
  """

  def __init__(self, gui: viser.GuiApi, playback: Playback, inputs: Inputs) -> None:
    self._playback, env = playback, playback.env
    self._replay = env if isinstance(env, Replay) else None
    if self._replay is None:
      self.slider = gui.add_slider(
        "Seconds back",
        min=0.0,
        max=HISTORY,
        step=min(0.05, env.step_dt),
        initial_value=0.0,
        disabled=True,
        hint="While paused",
      )
    else:
      end = max(self._replay.num_steps - 1, 1) * env.step_dt
      self.slider = gui.add_slider("Time [s]", min=0.0, max=end, step=env.step_dt, initial_value=0.0)
      inputs.on_change(lambda: self.slider.value, self._moved)
    self._shown = 0.0

  @property
  def seconds_back(self) -> float:
    """Age of the moment to show [s]; 0 unless a simulation is paused."""
    return float(self.slider.value) if self._replay is None and self._playback.paused else 0.0

  def to_now(self) -> None:
    """Return to the present of a simulation."""
    if self._replay is None:
      self.slider.value = 0.0

  def update(self) -> None:
    """Show the present time of a replay; let a simulation be looked back at only while it is paused."""
    if self._replay is None:
      self.slider.disabled = not self._playback.paused
      return
    now = self._replay.at * self._replay.step_dt
    # Otherwise the user has moved it since it was read.
    if self.slider.value == self._shown and now != self._shown:
      self.slider.value = self._shown = now

  def _moved(self) -> None:
    if self._replay is None or self.slider.value == self._shown:
      return
    replay, self._shown = self._replay, float(self.slider.value)
    moment = round(self._shown / replay.step_dt)

    def go() -> None:
      self._playback.pause()
      replay.show(moment)

    self._playback.request(go)
