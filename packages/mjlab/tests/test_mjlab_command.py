"""What tests of commands stand on: whatever a command does, its test ends."""

import pytest
from mjlab_command import Command, running

STANDING = "print('begun'); import time; time.sleep(1000)"


def test_a_test_that_fails_does_not_wait_for_the_command_that_it_started() -> None:
  started: list[Command] = []

  def failing() -> None:
    with running(STANDING) as process:
      started.append(process)
      process.wait_for("begun")
      raise ZeroDivisionError

  with pytest.raises(ZeroDivisionError):
    failing()
  assert started[0].exit_code is not None


def test_a_command_that_does_not_say_what_is_waited_for_is_a_failure_that_tells_where_it_stands() -> None:
  with running(STANDING) as process:
    process.wait_for("begun")
    with pytest.raises(pytest.fail.Exception, match=r"(?s)'ready' was not said within 1 s:.*line 1 in <module>"):
      process.wait_for("ready", 1.0)


def test_a_command_that_ends_early_is_a_failure_that_tells_what_it_said() -> None:
  without = pytest.raises(pytest.fail.Exception, match=r"(?s)exit code 3 without saying 'ready':.*begun")
  with running("print('begun'); exit(3)") as process, without:
    process.wait_for("ready")


def test_a_command_that_goes_on_after_ctrl_c_is_a_failure() -> None:
  with running(f"import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); {STANDING}") as process:
    process.wait_for("begun")
    with pytest.raises(pytest.fail.Exception, match="goes on 1 s after Ctrl-C"):
      process.interrupt(1.0)
