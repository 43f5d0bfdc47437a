"""A command in a process of its own, as somebody runs it, for tests: whatever it does, nobody waits for it for ever."""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import pytest

PATIENCE = 300.0
"""Limit for anything a command does [s]: far beyond what the busiest machine takes, below the time limit of a test."""


class Command:
  """A running command and what it has said; its two streams are one."""

  def __init__(self, process: subprocess.Popen[bytes], output: Path) -> None:
    self._process = process
    self._output = output

  @property
  def said(self) -> str:
    return self._output.read_text()

  @property
  def exit_code(self) -> int | None:
    return self._process.poll()

  @property
  def pid(self) -> int:
    return self._process.pid

  def wait_for(self, pattern: str, seconds: float = PATIENCE) -> re.Match[str]:
    """Waits until the command has said something; fails with what it said instead."""
    end = time.monotonic() + seconds
    while (found := re.search(pattern, self.said)) is None:
      if self.exit_code is not None and re.search(pattern, self.said) is None:
        pytest.fail(f"the command ended with exit code {self.exit_code} without saying {pattern!r}:\n{self.said}")
      if time.monotonic() > end:
        self._end(f"goes on: {pattern!r} was not said within {seconds:g} s")
      time.sleep(0.05)
    return found

  def wait_until(self, condition: Callable[[], object], seconds: float = PATIENCE) -> None:
    """Waits until a condition is true, such as that of a file that the command writes."""
    end = time.monotonic() + seconds
    while not condition():
      if self.exit_code is not None:
        pytest.fail(f"the command ended with exit code {self.exit_code}:\n{self.said}")
      if time.monotonic() > end:
        self._end(f"goes on, and the condition was not met within {seconds:g} s")
      time.sleep(0.05)

  def interrupt(self, seconds: float = PATIENCE) -> str:
    """Ctrl-C; returns what the command says from then to its end, which must be that of one that did its work."""
    before = len(self.said)
    self._process.send_signal(signal.SIGINT)
    try:
      code = self._process.wait(seconds)
    except subprocess.TimeoutExpired:
      self._end(f"goes on {seconds:g} s after Ctrl-C")
    assert code == 0, self.said
    return self.said[before:]

  def _end(self, why: str) -> NoReturn:
    """Fails with what the command said and where each of its threads stands."""
    self._process.send_signal(signal.SIGABRT)
    try:
      self._process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
      self._process.kill()
    pytest.fail(f"the command {why}:\n{self.said}")


@contextmanager
def running(
  code: str, *arguments: str, folder: Path | None = None, is_background: bool = False, **environment: str
) -> Generator[Command]:
  """Runs Python code in a folder with arguments.

  It is killed at the end if it still runs, so that a test that fails meanwhile does not wait for it. In the background
  it begins as a shell without job control starts what stands before an `&`: with Ctrl-C ignored.
  """
  call = [sys.executable, "-X", "faulthandler", "-uc", code, *arguments]
  # Else what the tests themselves were started with would be passed on.
  wanted = signal.SIG_IGN if is_background else signal.default_int_handler
  with tempfile.TemporaryDirectory() as elsewhere:
    output = Path(elsewhere) / "output"
    handler = signal.signal(signal.SIGINT, wanted)
    try:
      with output.open("wb") as file:
        process = subprocess.Popen(call, cwd=folder, stdout=file, stderr=file, env=os.environ | environment)
    finally:
      signal.signal(signal.SIGINT, handler)
    started = Command(process, output)
    try:
      yield started
    finally:
      process.kill()
      process.wait(PATIENCE)
      # Shown beside what failed.
      print(started.said)
