"""`demo [--task NAME] [flags]`: a policy that comes with the package, in the browser."""

from dataclasses import dataclass
from importlib.resources import as_file

from mjlab_core import UsageError
from mjlab_core.names import check_name

from mjlab.cli import _play
from mjlab.cli.shared._command_line import CommandLine, take
from mjlab.demos import shipped


@dataclass(kw_only=True)
class Arguments:
  """Flags of the command; those of `play` are added."""

  task: str | None = None
  """Policy to show; None: the first of those that ship."""


_NOTES = """\
All flags of `play TASK` work too, such as:
  --port 8080        Port of the page; the next free one if it is taken.
  --host 127.0.0.1   Address to listen on; 0.0.0.0 lets other machines connect.
  --num-envs 8       Number of robots.
  --video FILE.mp4   Write a film instead.

policies that ship: """


def run(words: list[str]) -> int:
  """Show a trained robot in the browser.

  It walks or follows a clip, or is an arm that lifts a cube. The control `Manual` gives commands and moves the goal.
  Nothing is downloaded.
  """
  policies = shipped()
  form = CommandLine("demo", "", Arguments, notes=_NOTES + ", ".join(policies))
  if form.wants_help(words, run):
    return 0
  name, flags = take(words, "--task")
  name = next(iter(policies)) if name is None else check_name("demo", name, policies)
  if flags and not flags[0].startswith("-"):
    raise UsageError(f"'{flags[0]}': not a flag; --task selects the policy: {', '.join(policies)}")
  if not any(word.partition("=")[0] in ("--viewer", "--video") for word in flags):
    flags = ["--viewer", "browser", *flags]
  with as_file(policies[name]) as directory:
    from mjlab_rl.bundles.bundle_policy import task_of_bundle

    return _play.run([task_of_bundle(directory), "--checkpoint", str(directory), *flags])
