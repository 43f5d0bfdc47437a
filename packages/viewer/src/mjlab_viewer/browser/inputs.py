"""Inputs of the page, with their actions."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import viser

Button: TypeAlias = "viser.GuiButtonHandle | viser.GuiButtonGroupHandle"


class Inputs:
  """Values and buttons of a part of the page, with an action for each change and for each press.

  The page shows its inputs before it reports its camera. Until then viser stores new values and times of presses, but
  calls nothing. Therefore both are read regularly.
  """

  def __init__(self, server: viser.ViserServer) -> None:
    self._server = server
    self._watched: list[tuple[Callable[[], object], Callable[[], None]]] = []
    self._seen: list[object] = []
    self._presses: list[Callable[[], None]] = []

  def on_change(self, value: Callable[[], object], action: Callable[[], None]) -> None:
    """Call `action` in `read`, after this value changed."""
    self._watched.append((value, action))
    self._seen.append(value())

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
    """Call the actions of values that changed since the last call, and of presses that viser did not report."""
    for row, (value, action) in enumerate(self._watched):
      now = value()
      if now != self._seen[row]:
        self._seen[row] = now
        action()
    # In viser's thread, no press can come in between.
    for press in self._presses:
      self._server.get_event_loop().call_soon_threadsafe(press)
