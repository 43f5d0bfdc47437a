"""Progress of a training on its page, and the button that stops it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import viser

from mjlab_viewer.browser.inputs import Inputs

_POINTS = 200
"""Greatest number of rewards in the small curve."""


class TrainingPanel:
  """Iteration, reward with a small curve, episode length, speed, remaining time and terms of a training.

  Args:
    server: Server of the page.
    on_stop: Function that makes the training save and stop; called once, in a thread of the server.
  """

  def __init__(self, server: viser.ViserServer, on_stop: Callable[[], None]) -> None:
    self._rewards: list[float] = []
    self._terms: dict[str, float] = {}
    self._text = server.gui.add_markdown("The first iteration is running.")
    self._curve = server.gui.add_html("", visible=False)
    self._table = server.gui.add_markdown("", visible=False)
    self._on_stop = on_stop
    self._stop = server.gui.add_button("Save and stop", icon=viser.Icon.PLAYER_STOP)
    self.inputs = Inputs(server)
    """The button, read by the viewer."""
    self.inputs.on_press(self._stop, lambda _: self._press())

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
      self._curve.content, self._curve.visible = sparkline(self._rewards), True
    self._text.content = "\n\n".join(lines)
    self._terms |= terms
    if self._terms:
      rows = "\n".join(f"| {name.replace('_', ' ')} | {value:.4g} |" for name, value in self._terms.items())
      self._table.content, self._table.visible = f"| term | mean of an episode |\n|---|---|\n{rows}", True

  def _press(self) -> None:
    if not self._stop.disabled:
      self._stop.disabled = True
      self._stop.label = "Stopping after this iteration"
      self._on_stop()


def sparkline(values: Sequence[float]) -> str:
  """Return a small curve as SVG, from the lowest value to the highest; of many values, some."""
  shown = [*values[:: len(values) // _POINTS + 1], values[-1]]
  low, high = min(shown), max(shown)
  across, up = 100.0 / (len(shown) - 1), 100.0 / (high - low) if high > low else 0.0
  points = " ".join(f"{i * across:.4g},{(high - value) * up:.4g}" for i, value in enumerate(shown))
  style = "width: calc(100% - 1.5em); height: 3.5em; margin: 0 .75em"
  line = 'fill="none" stroke="#228be6" stroke-width="1.5" vector-effect="non-scaling-stroke"'
  drawing = f'<polyline points="{points}" {line}/>'
  return f'<svg viewBox="0 -4 100 108" preserveAspectRatio="none" style="{style}">{drawing}</svg>'
