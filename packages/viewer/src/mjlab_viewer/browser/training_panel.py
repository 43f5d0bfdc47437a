"""Progress of a training on its page, and the button that stops it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

import viser

from mjlab_viewer.browser.inputs import Buttons

_BARS = "▁▂▃▄▅▆▇█"
_WIDTH = 40
"""Rewards in the small curve."""


class TrainingPanel:
  """Iteration, reward with a small curve, episode length, speed, remaining time and terms of a training.

  Args:
    server: Server of the page.
    on_stop: Function that makes the training save and stop; called once, in a thread of the server.
  """

  def __init__(self, server: viser.ViserServer, on_stop: Callable[[], None]) -> None:
    self._rewards: deque[float] = deque(maxlen=_WIDTH)
    self._terms: dict[str, float] = {}
    self._text = server.gui.add_markdown("The first iteration is running.")
    self._on_stop = on_stop
    self._stop = server.gui.add_button("Save and stop", icon=viser.Icon.PLAYER_STOP)
    self.buttons = Buttons(server)
    """The button, read by the viewer."""
    self.buttons.on_press(self._stop, lambda _: self._press())

  def show(
    self,
    *,
    iteration: int,
    end: int,
    reward: float | None,
    episode_length: float | None,
    steps_per_second: float,
    eta: str,
    terms: Mapping[str, float],
  ) -> None:
    """Show the state after an iteration.

    Args:
      iteration: Iterations done.
      end: Iterations in all.
      reward: Mean return of episodes; None before one has ended.
      episode_length: Mean length of episodes [steps]; None before one has ended.
      steps_per_second: Environment steps of all worlds per second.
      eta: Remaining time.
      terms: Means over episodes by name, such as reward terms and success; of a missing name the last value stays.
    """
    lines = [f"**Iteration {iteration} of {end}**, {steps_per_second:,.0f} steps/s, ETA {eta}"]
    if reward is None or episode_length is None:
      lines.append("No episode has ended yet.")
    else:
      self._rewards.append(reward)
      lines.append(f"Reward **{reward:.2f}**, episode {episode_length:.0f} steps")
      lines.append(sparkline(self._rewards))
    self._terms |= terms
    if self._terms:
      rows = "\n".join(f"| {name.replace('_', ' ')} | {value:.4g} |" for name, value in self._terms.items())
      lines.append(f"| term | mean of an episode |\n|---|---|\n{rows}")
    self._text.content = "\n\n".join(lines)

  def _press(self) -> None:
    if not self._stop.disabled:
      self._stop.disabled = True
      self._stop.label = "Stopping after this iteration"
      self._on_stop()


def sparkline(values: deque[float]) -> str:
  """Return a small curve of letters, from the lowest value to the highest."""
  low, high = min(values), max(values)
  scale = (len(_BARS) - 1) / (high - low) if high > low else 0.0
  return "".join(_BARS[round((value - low) * scale)] for value in values)
