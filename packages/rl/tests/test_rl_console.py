import errno
import io
import os
import re
import sys
from typing import Any

import pytest
from mjlab_rl import Console, IterationReport
from rl_learners import Terminal


@pytest.fixture(autouse=True)
def _size(monkeypatch: pytest.MonkeyPatch) -> None:
  for name, value in (("TERM", "xterm"), ("COLUMNS", "100"), ("LINES", "30")):
    monkeypatch.setenv(name, value)


SCALARS = {
  "Loss/value": 0.123456789,
  "Perf/total_fps": 215_400.0,
  "Episode_Metrics/height": 0.3,
  "Episode_Reward/track_velocity": 1.25,
  "Episode_Reward/energy": -0.5,
}


def report(iteration: int, reward: float | None = 1.5) -> IterationReport:
  episodes = {} if reward is None else {"Train/mean_reward": reward, "Train/mean_episode_length": 812.4}
  return IterationReport(
    iteration=iteration, end=1000, total_steps=1, elapsed=1.0, eta=3725.0, scalars=SCALARS | episodes
  )


def screen(stream: io.StringIO) -> list[str]:
  """The text on a terminal after what was written; knows the two commands that move the cursor up or clear a line."""
  lines, row = [""], 0
  for part in re.split(r"(\x1b\[[0-9;?]*[A-Za-z]|\r|\n)", stream.getvalue()):
    if part == "\n":
      row += 1
      lines += [""] * (row - len(lines) + 1)
    elif part.endswith("A") and part.startswith("\x1b"):
      row -= int(part[2:-1])
    elif part == "\x1b[2K":
      lines[row] = ""
    elif part != "\r" and not part.startswith("\x1b"):
      lines[row] += part
  return [line.rstrip() for line in lines]


def test_a_terminal_shows_progress_speed_and_all_terms_in_place() -> None:
  stream = Terminal()
  console = Console("normal", stream)
  with console.live():
    console.show(report(0, reward=None))
    console.say("saved model_1.pt")
    print("watch at [::1]", file=sys.stdout)
    console.show(report(999))
  console.say("done")
  shown = screen(stream)
  # Messages stand above the display, which is there once.
  assert shown[:2] == ["saved model_1.pt", "watch at [::1]"]
  assert shown[2].split() == ["1000/1000", "━" * 40, "100", "%", "ETA", "1:02:05"]
  assert shown[3] == "215k steps/s  reward 1.50  episode 812 steps"
  assert [" ".join(line.split()) for line in shown[4:]] == [
    "reward terms metrics loss",
    "track_velocity 1.25 height 0.3 value 0.1235",
    "energy -0.5",
    "done",
    "",
  ]


def test_a_display_higher_than_the_terminal_is_cut_until_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setenv("LINES", "4")
  stream = Terminal()
  console = Console("normal", stream)
  with console.live():
    console.show(report(999))
    assert len(screen(stream)) == 4
  assert screen(stream)[4].split() == ["energy", "-0.5"]


def test_a_terminal_that_cannot_move_its_cursor_gets_plain_lines(monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setenv("TERM", "dumb")
  stream = Terminal()
  Console("normal", stream).show(report(1))
  assert stream.getvalue() == "   2/1000  215k steps/s  reward 1.50  episode 812 steps  ETA 1:02:05\n"


@pytest.mark.parametrize("number", [errno.EIO, errno.EPIPE])
def test_a_closed_terminal_or_pipe_does_not_end_the_training(number: int) -> None:
  class Gone(Terminal):
    def write(self, text: str) -> int:
      raise OSError(number, os.strerror(number))

  console = Console("normal", Gone())
  with console.live():
    console.show(report(0))
    console.say("done")


def test_a_file_gets_the_first_line_the_last_and_few_between() -> None:
  stream = io.StringIO()
  console = Console("normal", stream)
  for iteration in range(1000):
    console.show(report(iteration))
  assert [line.split()[0] for line in stream.getvalue().splitlines()] == ["1/1000", "1000/1000"]


@pytest.mark.parametrize(("verbosity", "lines"), [("quiet", 0), ("normal", 2), ("verbose", 9)])
def test_verbosity_sets_the_amount_of_output(verbosity: Any, lines: int) -> None:
  stream = io.StringIO()
  console = Console(verbosity, stream)
  console.say("hello")
  console.show(report(999))
  shown = stream.getvalue()
  assert len(shown.splitlines()) == lines
  assert (re.search(r"Loss/value +0\.12346\n", shown) is not None) == (verbosity == "verbose")
