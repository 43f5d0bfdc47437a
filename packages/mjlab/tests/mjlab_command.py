"""Commands in separate processes, with a limit of the time that a test waits for them."""

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
"""Limit of the time that a test waits [s]: above that of the busiest machine, below the time limit of a test."""


class Command:
  """Running command and its output; its two streams are one."""

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
    """Wait until the command has printed a pattern, and return the match."""
    self.wait_until(lambda: re.search(pattern, self.said), seconds, f"{pattern!r} was not printed")
    found = re.search(pattern, self.said)
    assert found is not None
    return found

  def wait_until(self, condition: Callable[[], object], seconds: float = PATIENCE, problem: str = "no result") -> None:
    """Wait until a condition is true; fail with the output if it is false at the end of the command or of the time."""
    end = time.monotonic() + seconds
    while not condition():
      if self.exit_code is not None and not condition():
        pytest.fail(f"the command ended with exit code {self.exit_code}, {problem}:\n{self.said}")
      if time.monotonic() > end:
        self._end(f"continues: {problem} within {seconds:g} s")
      time.sleep(0.05)

  def interrupt(self, seconds: float = PATIENCE) -> str:
    """Press Ctrl-C; return the output from then to the end, which must be exit code 0."""
    before = len(self.said)
    self._process.send_signal(signal.SIGINT)
    try:
      code = self._process.wait(seconds)
    except subprocess.TimeoutExpired:
      self._end(f"continues {seconds:g} s after Ctrl-C")
    assert code == 0, self.said
    return self.said[before:]

  def _end(self, why: str) -> NoReturn:
    """Fail with the output of the command and the stacks of its threads."""
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
  """Run Python code with arguments in a folder.

  The process is killed at the end if it still runs, so that a failing test does not wait for it. In the background it
  starts with Ctrl-C ignored, as a shell without job control starts a command before an `&`.
  """
  call = [sys.executable, "-X", "faulthandler", "-uc", code, *arguments]
  # Otherwise the process inherits the handler of the tests.
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
      # Shown beside the failure.
      print(started.said)
