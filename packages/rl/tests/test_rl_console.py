import errno
import io
import os

import pytest
from mjlab_rl import Console, IterationReport


class Terminal(io.StringIO):
  def isatty(self) -> bool:
    return True


def report(iteration: int, reward: float | None = 1.5) -> IterationReport:
  return IterationReport(
    iteration=iteration,
    end=1000,
    total_steps=1,
    steps_per_second=215_400.0,
    collect_time=0.3,
    learn_time=0.1,
    elapsed=1.0,
    eta=3725.0,
    mean_reward=reward,
    mean_episode_length=None if reward is None else 812.4,
    scalars={"Loss/value": 0.123456789},
  )


def test_a_terminal_shows_one_line_that_is_overwritten() -> None:
  stream = Terminal()
  console = Console("normal", stream)
  console.show(report(0, reward=None))
  console.show(report(1))
  console.say("done")
  assert stream.getvalue() == (
    "\r\x1b[2K   1/1000  215k steps/s  no episode finished yet  ETA 1:02:05"
    "\r\x1b[2K   2/1000  215k steps/s  reward 1.50  episode 812 steps  ETA 1:02:05\ndone\n"
  )


def test_a_narrow_terminal_keeps_what_matters_most(monkeypatch: pytest.MonkeyPatch) -> None:
  for columns, line in (
    (60, "   2/1000  215k steps/s  reward 1.50  ETA 1:02:05"),
    (42, "   2/1000  215k steps/s  ETA 1:02:05"),
    (10, "   2/1000  ETA 1:02:05"),
  ):
    monkeypatch.setattr("shutil.get_terminal_size", lambda columns=columns: os.terminal_size((columns, 24)))
    stream = Terminal()
    Console("normal", stream).show(report(1))
    assert stream.getvalue() == "\r\x1b[2K" + line


@pytest.mark.parametrize("number", [errno.EIO, errno.EPIPE])
def test_a_terminal_or_a_reader_that_is_gone_stops_nothing(number: int) -> None:
  class Gone(Terminal):
    def write(self, text: str) -> int:
      raise OSError(number, os.strerror(number))

  console = Console("normal", Gone())
  console.show(report(0))
  console.say("done")


def test_a_file_gets_the_first_line_the_last_and_few_between() -> None:
  stream = io.StringIO()
  console = Console("normal", stream)
  for iteration in range(1000):
    console.show(report(iteration))
  assert [line.split()[0] for line in stream.getvalue().splitlines()] == ["1/1000", "1000/1000"]


@pytest.mark.parametrize(("verbosity", "shown"), [("verbose", True), ("normal", False)])
def test_all_values_are_shown_only_where_asked_for(verbosity: str, shown: bool) -> None:
  stream = io.StringIO()
  Console(verbosity, stream).show(report(5))  # pyright: ignore[reportArgumentType]  # ty: ignore[invalid-argument-type]
  assert ("Loss/value  0.12346" in stream.getvalue()) == shown


def test_quiet_says_nothing() -> None:
  stream = io.StringIO()
  console = Console("quiet", stream)
  console.say("hello")
  console.show(report(999))
  assert stream.getvalue() == ""
