"""Tests of atomic writes and of names from files."""

import os
import subprocess
import sys
import unicodedata
from pathlib import Path

import pytest
from mjlab_core.io.files import AtomicWrite, printable, remove_leftovers, safe_name


def _names(folder: Path) -> list[str]:
  return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("inside", ["", "assets"], ids=["file", "folder"])
def test_a_target_is_replaced_only_when_the_new_one_is_whole(inside: str, tmp_path: Path) -> None:
  target = tmp_path / "new" / "model.pt"

  def write(place: Path, text: str) -> None:
    (place / inside).parent.mkdir(parents=True, exist_ok=True)
    (place / inside).write_text(text)

  for content in ("first", "second"):
    with AtomicWrite(target) as temporary:
      assert (temporary.parent, temporary.suffix) == (target.parent, target.suffix)
      write(temporary, content)
      assert content == "second" or not target.exists()
  half = AtomicWrite(target)
  write(half.temporary, "half")
  with pytest.raises(ZeroDivisionError), half:
    _ = 1 / 0
  assert (target / inside).read_text() == "second"
  assert _names(target.parent) == ["model.pt"]


def test_data_and_name_are_synced_before_and_after_the_rename(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  """A rename may reach the disk before the data that it names, so a power cut would leave an empty checkpoint."""
  log: list[str] = []
  sync, replace = os.fsync, os.replace
  monkeypatch.setattr(os, "fsync", lambda handle: (log.append("sync"), sync(handle)))
  monkeypatch.setattr(os, "replace", lambda old, new: (log.append("rename"), replace(old, new)))
  with AtomicWrite(tmp_path / "x.json") as temporary:
    temporary.write_text("{}")
  assert log == ["sync", "rename", "sync"]


def test_leftovers_of_ended_processes_are_removed_and_nothing_else(tmp_path: Path) -> None:
  code = (
    "import os, sys; from mjlab_core.io.files import AtomicWrite\n"
    "AtomicWrite(sys.argv[1]).temporary.write_text('half')\n"
    "AtomicWrite(sys.argv[2]).temporary.mkdir()\n"
    "os._exit(9)"
  )
  subprocess.run([sys.executable, "-c", code, tmp_path / "model_50.pt", tmp_path / "scene"], check=False)
  assert len(_names(tmp_path)) == 2
  kept = [".hidden.tmp", "model_50.pt", ".model_50.pt.elsewhere.1-0.tmp", ".x.tmp"]
  for name in kept:
    (tmp_path / name).write_text("kept")
  with AtomicWrite(tmp_path / "running.pt") as temporary:
    temporary.write_text("now")
    assert len(remove_leftovers(tmp_path)) == 2
    assert temporary.exists()
  assert _names(tmp_path) == sorted([*kept, "running.pt"])
  # A process of another host cannot be looked up; a file that it has not touched for two days is left over.
  os.utime(tmp_path / kept[2], (0, 0))
  assert [path.name for path in remove_leftovers(tmp_path)] == [kept[2]]
  assert remove_leftovers(tmp_path / "missing") == []


@pytest.mark.parametrize(
  ("text", "expected"),
  [
    ("dance1_subject2", "dance1_subject2"),
    ("Fußgänger-2.5", "Fußgänger-2.5"),
    ("../../x", "x"),
    ("/etc/passwd", "etc_passwd"),
    ("C:\\Windows\\x", "C__Windows_x"),
    ("a/../b", "a_b"),
    ("-rf *", "rf_"),
    (".bashrc", "bashrc"),
    ("a\x1b[31mred\nb", "a_31mred_b"),
    ("x\x00.npz", "x_.npz"),
    ("\u202egnp.exe", "_gnp.exe"),
    ("\ud800", "_"),
    ("", "unnamed"),
    ("..", "unnamed"),
    ("///", "unnamed"),
    ("é" * 300, "é" * 60),
  ],
)
def test_a_safe_name_is_one_visible_path_component(text: str, expected: str, tmp_path: Path) -> None:
  """Class of mistakes: a name from a file chooses the folder that is written to."""
  name = safe_name(text)
  assert name == expected
  assert safe_name(name) == name
  (tmp_path / f"{name}.npz").touch()
  assert [path.parent for path in tmp_path.rglob("*.npz")] == [tmp_path]


def test_printed_text_has_one_line_and_no_control_characters() -> None:
  """Class of mistakes: escape bytes of a file reach the terminal, or a line break makes one message two."""
  hostile = "".join(map(chr, range(0x300))) + "\u2028\u202e\ufeff"
  line = printable(hostile, limit=2000)
  assert not [character for character in line if unicodedata.category(character)[0] == "C"]
  assert printable("two\nlines\tand \x1b[31mred") == "two lines and [31mred"
  assert printable(ValueError("x" * 600)) == "x" * 497 + "..."
