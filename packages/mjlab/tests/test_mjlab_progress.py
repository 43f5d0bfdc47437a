import os
import pty
import select
import subprocess
import sys

import pytest

WORK = """
import sys
from mjlab.cli.shared._progress import progress_bar
with progress_bar("evaluating", 4) as show:
  for done in range(1, 4):
    show(done, f"{done} episodes")
    print("result", done)
print("the end", file=sys.stderr)
"""


def on_a_terminal(code: str) -> tuple[str, str]:
  """Standard output of a program, and its errors as a terminal of 80 columns gets them."""
  terminal, theirs = pty.openpty()
  size = {"TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
  process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=theirs, env=os.environ | size)
  os.close(theirs)
  shown = b""
  while True:
    select.select([terminal], [], [])
    try:
      part = os.read(terminal, 4096)
    except OSError:  # Linux says so where macOS returns nothing.
      break
    if not part:
      break
    shown += part
  os.close(terminal)
  output, _ = process.communicate()
  assert process.returncode == 0
  return output.decode(), shown.decode()


def test_a_terminal_shows_a_bar_with_remaining_time_and_results_stay_on_their_own_stream() -> None:
  output, shown = on_a_terminal(WORK)
  assert output == "result 1\nresult 2\nresult 3\n"
  assert "evaluating" in shown
  assert "75%" in shown
  assert "3 episodes" in shown
  assert "ETA" in shown
  # The bar is gone when the work is done.
  assert shown.rpartition("\x1b[2K")[2].strip() == "the end"


INTERRUPTED = """
import signal, sys
from mjlab.cli import main
class Interrupt:
  def find_spec(self, name, path=None, target=None):
    if name == "trimesh.path":
      sys.meta_path.remove(self)
      signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
  "line", ["visualize-terrain flat", "play Mjlab-Cartpole-Balance --agent zero --viewer browser"]
)
def test_ctrl_c_while_a_page_is_imported_ends_the_command(line: str) -> None:
  done = subprocess.run(
    [sys.executable, "-c", INTERRUPTED, *line.split()], capture_output=True, text=True, timeout=120, check=False
  )
  assert (done.returncode, done.stdout.count("open http")) == (130, 0), done.stderr
