"""The commands that documents show are those that exist."""

import contextlib
import io
import re
import shlex
import tomllib
from functools import cache
from pathlib import Path

import pytest
from mjlab import cli

ROOT = Path(__file__).parents[1]
# Another test runs the commands of tutorials.
TUTORIALS = ROOT / "docs" / "tutorials"
PATTERNS = ("README.md", "CONTRIBUTING.md", "packages/*/*.md", "tasks/*/*.md", "docs/**/*.md")
DOCUMENTS = sorted(path for pattern in PATTERNS for path in ROOT.glob(pattern) if path.parent != TUTORIALS)
SCRIPTS = tomllib.loads((ROOT / "packages/mjlab/pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]


def commands(document: Path) -> list[list[str]]:
  """Words of every line of the shell examples, which may go on after a backslash, without `uv run`."""
  blocks = re.findall(r"```(?:bash|sh)\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL)
  whole = [block.replace("\\\n", " ") for block in blocks]
  lines = [shlex.split(line, comments=True) for block in whole for line in block.splitlines()]
  return [words[2:] if words[:2] == ["uv", "run"] else words for words in lines if words]


def own_commands(document: Path) -> list[list[str]]:
  """Return the lines of a document that run a command of mjlab."""
  lines = [words[1:] if words[0] == "mjlab" else words for words in commands(document)]
  return [words for words in lines if words[0] in SCRIPTS]


@cache
def options(*command: str) -> str:
  # Some commands return after their help, others exit.
  with contextlib.redirect_stdout(io.StringIO()) as shown, contextlib.suppress(SystemExit):
    cli.main([*command, "--help"])
  return shown.getvalue()


@pytest.mark.parametrize(
  "document", [path for path in DOCUMENTS if own_commands(path)], ids=lambda path: str(path.relative_to(ROOT))
)
def test_shown_commands_have_the_tasks_and_options_of_their_help(document: Path) -> None:
  for words in own_commands(document):
    has_object = words[0] == "new" or (len(words) > 1 and words[1].startswith("Mjlab-"))
    help_text = options(*words[: 1 + has_object])
    for word in words:
      if word.startswith("--"):
        assert re.search(rf"(?<![\w.-]){re.escape(word)}(?![\w.-])", help_text), words
    if "--help" in words and words[-1] != "--help":
      assert words[-1] in help_text


def test_documents_show_how_to_train() -> None:
  assert "train" in [words[0] for words in own_commands(ROOT / "README.md")]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_and_commands_in_shell_examples_exist(document: Path) -> None:
  for words in commands(document):
    if words[0] == "python":
      assert (ROOT / words[1]).is_file(), words
    elif words[:3] == ["uv", "pip", "install"]:
      for folder in (word for word in words[3:] if word.startswith("./")):
        assert (ROOT / folder.partition("[")[0] / "pyproject.toml").is_file(), words
    elif words[0] in ("mjlab", "play", "demo", "export", "train", "list-envs"):
      assert words[0] in SCRIPTS, words
