"""Tests of commands end, whatever the command does."""

import pytest
from mjlab_command import Command, running

STANDING = "print('begun'); import time; time.sleep(1000)"


def test_a_test_that_fails_does_not_wait_for_its_command() -> None:
  started: list[Command] = []

  def fail() -> None:
    with running(STANDING) as process:
      started.append(process)
      process.wait_for("begun")
      raise ZeroDivisionError

  with pytest.raises(ZeroDivisionError):
    fail()
  assert started[0].exit_code is not None


@pytest.mark.parametrize(
  ("code", "action", "message"),
  [
    (STANDING, lambda process: process.wait_for("ready", 1.0), "'ready' was not printed within 1 s:.*in <module>"),
    ("print('begun'); exit(3)", lambda process: process.wait_for("ready"), r"exit code 3, 'ready' was not .*begun"),
    (
      f"import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); {STANDING}",
      lambda process: process.interrupt(1.0),
      "continues 1 s after Ctrl-C",
    ),
  ],
  ids=["nothing printed", "ended", "not interrupted"],
)
def test_a_command_that_does_not_do_its_work_is_a_failure_with_its_output(code, action, message: str) -> None:
  with running(code) as process:
    process.wait_for("begun")
    with pytest.raises(pytest.fail.Exception, match=f"(?s){message}"):
      action(process)
