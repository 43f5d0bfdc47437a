"""Signals that end a run after its iteration."""

import contextlib
import os
import signal
import threading
import time
from typing import Any, Self

_MESSAGE = b"\nStopping after this iteration; once more to quit at once.\n"
_LAST_WORD = b"\nStopped at once; progress since the last checkpoint is lost.\n"
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals of Ctrl-C, of schedulers, and of a closing terminal."""
# Launchers repeat a Ctrl-C that the terminal has sent to all processes; within this time it counts once [s].
_ECHO = 0.5


class StopSignals:
  """Context in which the first Ctrl-C, SIGTERM or SIGHUP only sets `received`; a second one ends the process at once.

  It has no effect outside the main thread, where Python allows no signal handlers.
  """

  def __init__(self) -> None:
    self.received: str | None = None
    """Name of the signal, such as "SIGINT"; None before one arrives."""
    self._received_at = 0.0
    self._previous: dict[signal.Signals, Any] = {}

  def __enter__(self) -> Self:
    if threading.current_thread() is threading.main_thread():
      for number in (getattr(signal, name) for name in SIGNALS if hasattr(signal, name)):
        if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
          self._previous[number] = signal.signal(number, self._on_signal)
    return self

  def __exit__(self, *_: object) -> None:
    for number, handler in self._previous.items():
      # None: the handler before ours was not set from Python.
      signal.signal(number, signal.SIG_DFL if handler is None else handler)
    self._previous.clear()

  def _on_signal(self, number: int, _frame: object) -> None:
    now = time.monotonic()
    if self.received is None:
      self.received = signal.Signals(number).name
      self._received_at = now
      _say(_MESSAGE)
    elif now - self._received_at > _ECHO:
      _say(_LAST_WORD)
      signal.signal(number, signal.SIG_DFL)
      os.kill(os.getpid(), number)


def _say(message: bytes) -> None:
  # A signal handler may not enter print() again; the terminal may be gone.
  with contextlib.suppress(OSError):
    os.write(2, message)
