"""`demo [flags]`: a policy that comes with the package, in the browser."""

from importlib.resources import as_file, files

from mjlab.cli import _play

_HELP = """\
usage: demo [flags]

Shows a Unitree Go1 that walks, in the browser; `By hand` gives it commands. Nothing is downloaded.

Flags are those of `play TASK`, such as:
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
  with as_file(files("mjlab") / "demo_policy") as directory:
    from mjlab_rl import load_run

    return _play.run([load_run(directory).task, "--checkpoint", str(directory), *_shown(arguments)])


def _shown(arguments: list[str]) -> list[str]:
  """The same, in the browser unless told otherwise."""
  if any(word.partition("=")[0] in ("--viewer", "--video") for word in arguments):
    return arguments
  return ["--viewer", "browser", *arguments]
