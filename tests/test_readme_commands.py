"""The commands that documents show are those that exist."""

import contextlib
import io
import re
import shlex
import tomllib
from functools import cache
from pathlib import Path

import pytest
from mjlab.cli import train

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted(
  [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *ROOT.glob("packages/*/*.md"),
    *ROOT.glob("tasks/*/*.md"),
    *ROOT.glob("docs/**/*.md"),
  ]
)
SCRIPTS = tomllib.loads((ROOT / "packages/mjlab/pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]


# A test of their own runs the commands of tutorials.
DOCUMENTS = [path for path in DOCUMENTS if path.parent != ROOT / "docs" / "tutorials"]


def commands(document: Path) -> list[list[str]]:
  """Words of every line of the shell examples, which may go on after a backslash, without `uv run`."""
  blocks = re.findall(r"```(?:bash|sh)\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL)
  whole = [block.replace("\\\n", " ") for block in blocks]
  lines = [shlex.split(line, comments=True) for block in whole for line in block.splitlines()]
  return [words[2:] if words[:2] == ["uv", "run"] else words for words in lines if words]


def train_commands() -> list[tuple[str, str, list[str]]]:
  """(document, task, rest of the line) of every training command shown."""
  return [
    (str(document.relative_to(ROOT)), words[1], words[2:])
    for document in DOCUMENTS
    for words in commands(document)
    if words[0] == "train"
  ]


@cache
def options(task: str) -> str:
  with contextlib.redirect_stdout(io.StringIO()) as shown:
    assert train([task, "--help"]) == 0
  return shown.getvalue()


@pytest.mark.parametrize(("document", "task", "rest"), train_commands())
def test_training_command_names_a_task_and_its_options(document: str, task: str, rest: list[str]) -> None:
  for word in rest:
    if word.startswith("--"):
      assert re.search(rf"(?<![\w.-]){re.escape(word)}(?![\w.-])", options(task)), word
  if "--help" in rest and rest[-1] != "--help":
    assert rest[-1] in options(task)


def test_documents_show_how_to_train() -> None:
  assert "README.md" in {document for document, _, _ in train_commands()}


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
