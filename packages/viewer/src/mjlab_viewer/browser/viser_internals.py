"""Repairs of viser, and all uses of its private names.

Without these names, viser works without the repairs.

Its way to wake the thread that sends: viser 1.1 sets an `asyncio.Event` in the thread that writes a message, and then
asks the thread of the event loop to set it too. The first call is not safe: it goes through the waiters while the loop
may add one. Then the writer fails with "deque mutated during iteration", or the sender sleeps although there is a
message.

Its icons: viser 1.1 reads the list of an archive of 4,000 icons again for each icon.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import types
import zipfile
from typing import Any

from viser import _icons as icons
from viser.infra import _async_message_buffer as buffers

PRIVATE_NAMES = {
  "AsyncMessageBuffer": "it has the event, and `event_loop`, its loop",
  "message_event": "only the thread of the loop may set it",
  "_icons": "it opens the archive",
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


@functools.cache
def _archive(path: Any) -> contextlib.nullcontext[zipfile.ZipFile]:
  return contextlib.nullcontext(zipfile.ZipFile(path))


def read_icons_once() -> None:
  """Keep the archive of icons open, instead of reading its list for each icon."""
  if hasattr(icons, name := "zipfile"):
    setattr(icons, name, types.SimpleNamespace(ZipFile=_archive))
