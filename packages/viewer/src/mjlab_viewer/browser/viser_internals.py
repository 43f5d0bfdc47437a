"""Repairs of viser, and all uses of its private names.

The requirement is bounded to the `TESTED` minors. Another viser works without the repairs.

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
import importlib
import types
import zipfile
from typing import Any

import viser

TESTED = ("1.0", "1.1")
PRIVATE_NAMES = {
  "viser.infra._async_message_buffer.AsyncMessageBuffer": "it has the event, and `event_loop`, its loop",
  "viser._icons.zipfile": "it opens the archive of icons for each of them",
}
"""Private names of viser that are used here, with the reason."""


def _owner_of(name: str) -> Any:
  """Return the private module that has a name; None if viser is of another minor, or has no such module."""
  module = next(path for path in PRIVATE_NAMES if path.endswith(f".{name}")).rpartition(".")[0]
  is_tested = viser.__version__.rpartition(".")[0] in TESTED
  with contextlib.suppress(ImportError):
    return importlib.import_module(module) if is_tested else None
  return None


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
  """Give all later servers an event that only their own loop sets."""
  buffer: Any = getattr(_owner_of("AsyncMessageBuffer"), "AsyncMessageBuffer", None)
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
  if hasattr(icons := _owner_of("zipfile"), name := "zipfile"):
    setattr(icons, name, types.SimpleNamespace(ZipFile=_archive))
