"""`demo [--task walk|lift] [flags]`: a policy that comes with the package, in the browser."""

import dataclasses
from importlib.resources import as_file, files
from typing import Literal

from mjlab_core import UsageError, unknown

from mjlab.cli import _play
from mjlab.cli._command_line import CommandLine

_POLICIES = {"walk": "demo_policy", "lift": "demo_policy_lift"}


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """Flags of the command; those of `play` are added."""

  task: Literal["walk", "lift"] = "walk"
  """Policy to show."""


_LINE = CommandLine(
  name="demo",
  words="",
  purpose=(
    "Shows a walking Unitree Go1, or a YAM that lifts a cube, in the browser. The control `Manual` gives commands and "
    "moves the goal. Nothing is downloaded."
  ),
  arguments=Arguments,
  notes="""\
All flags of `play TASK` work too, such as:
  --port 8080        Port of the page; the next free one if it is taken.
  --host 127.0.0.1   Address to listen on; 0.0.0.0 lets other machines connect.
  --num-envs 8       Number of robots.
  --video FILE.mp4   Write a film instead.""",
)


def run(words: list[str]) -> int:
  """Show the policy; return the exit code."""
  if _LINE.wants_help(words):
    return 0
  task, flags = _task(words)
  if flags and not flags[0].startswith("-"):
    raise UsageError(f"'{flags[0]}': not a flag; --task {' or '.join(_POLICIES)} selects the policy")
  if not any(word.partition("=")[0] in ("--viewer", "--video") for word in flags):
    flags = ["--viewer", "browser", *flags]
  with as_file(files("mjlab") / _POLICIES[task]) as directory:
    from mjlab_rl import load_run

    return _play.run([load_run(directory).task, "--checkpoint", str(directory), *flags])


def _task(words: list[str]) -> tuple[str, list[str]]:
  """Return the value of `--task`, and the other words."""
  words = [part for word in words for part in (word.split("=", 1) if word.startswith("--task=") else [word])]
  if "--task" not in words:
    return "walk", words
  at = words.index("--task")
  task = words[at + 1] if at + 1 < len(words) else ""
  if task not in _POLICIES:
    raise UsageError(unknown("demo", task, list(_POLICIES)))
  return task, words[:at] + words[at + 2 :]
