"""The tutorials of the site: their files are written, their programs and commands run, in order."""

import re
import runpy
import shlex
import signal
import sys
from pathlib import Path

import pytest
from mjlab import cli, registry
from mjlab_deploy import command as deploy

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("[0-9]*.md"))
BLOCK = re.compile(r"```(python|bash|xml|csv)\n(.*?)```", re.DOTALL)
FILE = re.compile(r"(?:# |<!-- )(mine/[\w.]+)")
# These commands wait for a person.
WATCHED = {"play", "demo", "tensorboard"}


def run_command(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
  """Run `uv run COMMAND ...` in this process."""
  # The performance of a policy does not matter here.
  line = re.sub(r"(--agent\.max-iterations) \d+", r"\1 2", line)
  words = shlex.split(line, comments=True)
  if words[:2] != ["uv", "run"] or WATCHED & set(words[2:5]) or (words[2] == "mjlab-deploy" and "--viewer" in words):
    return
  name, *arguments = words[2:]
  if name == "mjlab-deploy":
    assert deploy.main(arguments) == 0, line
  elif name == "python":
    monkeypatch.setattr(registry, "_registered", {})
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as ended:
      runpy.run_path(arguments[0], run_name="__main__")
    assert ended.value.code == 0, line
  else:
    assert cli.main(arguments if name == "mjlab" else [name, *arguments]) == 0, line


@pytest.mark.slow
@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_everything_that_a_tutorial_shows_runs(tutorial: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.chdir(tmp_path)
  monkeypatch.syspath_prepend(str(tmp_path / "mine"))
  for folder in ("packages", "tests"):
    (tmp_path / folder).symlink_to(ROOT / folder)
  (tmp_path / "mine").mkdir()
  for other in TUTORIALS:  # later tutorials use files of earlier ones
    for _, code in BLOCK.findall(other.read_text(encoding="utf-8")):
      if found := FILE.match(code):
        (tmp_path / found[1]).write_text(code, encoding="utf-8")
  known = set(sys.modules)
  # The launcher of several processes leaves its signal handlers behind.
  handlers = {
    number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
  }
  names: dict[str, object] = {"__name__": "tutorial"}
  try:
    for language, code in BLOCK.findall(tutorial.read_text(encoding="utf-8")):
      if language == "bash":
        for line in code.replace("\\\n", " ").splitlines():
          run_command(line, monkeypatch)
      elif language == "python" and not FILE.match(code):
        exec(compile(code, str(tutorial), "exec"), names)
  finally:
    for number, handler in handlers.items():
      signal.signal(number, handler)
    for name in set(sys.modules) - known:
      if (getattr(sys.modules[name], "__file__", None) or "").startswith(str(tmp_path)):
        del sys.modules[name]
