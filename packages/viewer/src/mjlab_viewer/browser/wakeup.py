"""Repair of viser's way to wake the thread that sends, and all uses of viser's private names.

viser 1.1 sets an `asyncio.Event` in the thread that writes a message, and then asks the thread of the event loop to set
it too. The first call is not safe: it goes through the waiters while the loop may add one. Then the writer fails with
"deque mutated during iteration", or the sender sleeps although there is a message. Without these names, viser does as
before.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

from viser.infra import _async_message_buffer as buffers

PRIVATE_NAMES = {
  "AsyncMessageBuffer": "it has the event, and `event_loop`, its loop",
  "message_event": "only the thread of the loop may set it",
}
"""Private names of viser that are used here, with the reason."""


class LoopEvent(asyncio.Event):
  """Event that only its loop sets; viser's other threads ask the loop to.

  Args:
    loop: The loop.
  """

  def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
    super().__init__()
    self._own_loop = loop

  def set(self) -> None:
    """Wake all waiters if the loop calls this; otherwise do nothing."""
    with contextlib.suppress(RuntimeError):
      if asyncio.get_running_loop() is self._own_loop:
        super().set()


def repair_wakeup() -> None:
  """Give all servers from now on an event that only their loop sets."""
  buffer: Any = getattr(buffers, "AsyncMessageBuffer", None)
  if buffer is not None and not hasattr(buffer, "message_event"):
    buffer.message_event = property(lambda self: self._loop_event, _set_event)


def _set_event(buffer: Any, event: asyncio.Event) -> None:
  del event
  buffer._loop_event = LoopEvent(buffer.event_loop)
