"""`demo [--task walk|lift] [flags]`: a policy that comes with the package, in the browser."""

from importlib.resources import as_file, files

from mjlab_core import unknown

from mjlab.cli import _play
from mjlab.cli._errors import UsageError

_POLICIES = {"walk": "demo_policy", "lift": "demo_policy_lift"}

_HELP = """\
usage: demo [flags]

Shows a Unitree Go1 that walks, or a YAM that lifts a cube, in the browser; `By hand` gives commands and moves the goal.
Nothing is downloaded.

  --task walk        What to show: walk or lift.

Other flags are those of `play TASK`, such as:
  --port 8080        Port of the page, the next free one if it is taken.
  --host 127.0.0.1   Address to listen on; 0.0.0.0 lets other machines in.
  --num-envs 8       Robots.
  --video FILE.mp4   Write a film instead.
"""


def run(arguments: list[str]) -> int:
  """Show it; returns the exit code."""
  if "-h" in arguments or "--help" in arguments:
    print(_HELP, end="")
    return 0
  shown, others = _task(arguments)
  if others and not others[0].startswith("-"):
    raise UsageError(f"'{others[0]}': not a flag; --task {' or '.join(_POLICIES)} says what to show")
  with as_file(files("mjlab") / _POLICIES[shown]) as directory:
    from mjlab_rl import load_run

    return _play.run([load_run(directory).task, "--checkpoint", str(directory), *_shown(others)])


def _task(arguments: list[str]) -> tuple[str, list[str]]:
  """What is to be shown, and the other arguments."""
  words = [part for word in arguments for part in (word.split("=", 1) if word.startswith("--task=") else [word])]
  if "--task" not in words:
    return "walk", words
  at = words.index("--task")
  shown = words[at + 1] if at + 1 < len(words) else ""
  if shown not in _POLICIES:
    raise UsageError(unknown("demo", shown, list(_POLICIES)))
  return shown, words[:at] + words[at + 2 :]


def _shown(arguments: list[str]) -> list[str]:
  """The same, in the browser unless told otherwise."""
  if any(word.partition("=")[0] in ("--viewer", "--video") for word in arguments):
    return arguments
  return ["--viewer", "browser", *arguments]
