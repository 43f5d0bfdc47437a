"""Values and presses of the page's inputs, brought to the thread that owns the environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import viser

Button: TypeAlias = "viser.GuiButtonHandle | viser.GuiButtonGroupHandle"


class Values:
  """Values of inputs, with an action for each change.

  They are read regularly, without viser's callbacks: the page shows its inputs before it reports its camera, and until
  then viser stores new values but calls nothing.
  """

  def __init__(self) -> None:
    self._watched: list[tuple[Callable[[], object], Callable[[], None]]] = []
    self._seen: list[object] = []

  def on_change(self, value: Callable[[], object], action: Callable[[], None]) -> None:
    """Call `action` after this value changed."""
    self._watched.append((value, action))
    self._seen.append(value())

  def read(self) -> None:
    """Call the actions of values that changed since the last call."""
    for row, (value, action) in enumerate(self._watched):
      now = value()
      if now != self._seen[row]:
        self._seen[row] = now
        action()


class Buttons:
  """Presses of buttons, with one action for each press.

  Before the page has reported its camera, viser stores the time of a press but calls nothing. Therefore these times are
  read too, in viser's own thread, where no press can come in between.
  """

  def __init__(self, server: viser.ViserServer) -> None:
    self._server = server
    self._presses: list[Callable[[], None]] = []

  def on_press(self, button: Button, action: Callable[[viser.ClientHandle | None], None]) -> None:
    """Call `action` at once, in viser's thread, with the client that pressed, if it is known."""
    seen = button.update_timestamp

    def press(client: viser.ClientHandle | None = None) -> None:
      nonlocal seen
      if button.update_timestamp != seen:
        seen = button.update_timestamp
        action(client)

    async def on_click(event: viser.GuiEvent) -> None:
      press(event.client)

    button.on_click(on_click)
    self._presses.append(press)

  def read(self) -> None:
    """Call the actions of presses that viser did not report."""
    self._server.get_event_loop().call_soon_threadsafe(self._look)

  def _look(self) -> None:
    for press in self._presses:
      press()
