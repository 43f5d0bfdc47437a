"""Releases of single members, and the rule that a changed public API is described."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import public_api
import pytest
import release

ROOT = Path(__file__).parents[1]
each_member = pytest.mark.parametrize("member", public_api.members(), ids=str)


def project(folder: Path) -> dict:
  return tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def requirements(folder: Path, name: str) -> list[str]:
  found = project(folder)
  listed = [*found["dependencies"], *(r for extra in found.get("optional-dependencies", {}).values() for r in extra)]
  return [requirement for requirement in listed if re.match(rf"{name}(?![\w-])", requirement)]


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
  """Return a copy of the workspace: projects, changelogs and sources of all members."""
  for folder in public_api.members().values():
    copy = tmp_path / folder.relative_to(ROOT)
    shutil.copytree(
      folder / "src", copy / "src", ignore=shutil.ignore_patterns("*.pt", "*.npz", "*.png", "__pycache__")
    )
    for name in ("pyproject.toml", "CHANGELOG.md", "api.txt"):
      shutil.copy(folder / name, copy / name)
  (tmp_path / "uv.lock").write_text("old")
  changelog = tmp_path / "packages/core/CHANGELOG.md"
  changelog.write_text(
    changelog.read_text().replace("## [Unreleased]\n", "## [Unreleased]\n\n### Added\n\n- A thing.\n")
  )
  return tmp_path


def contents(root: Path) -> dict[Path, bytes]:
  return {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}


@each_member
def test_a_changed_public_api_has_an_unreleased_entry(member: str) -> None:
  assert public_api.check(public_api.members()[member]) == ""


def test_a_changed_api_without_an_entry_is_refused_and_named(workspace: Path) -> None:
  terrain = workspace / "packages/terrain"
  text = (terrain / "CHANGELOG.md").read_text()
  (terrain / "CHANGELOG.md").write_text(text.replace(public_api.unreleased(terrain) or "\0", ""))
  assert not (
    set(public_api.public_api(terrain).splitlines()) ^ set((terrain / "api.txt").read_text().splitlines())
  ) or ("the public API has changed" in public_api.check(terrain))
  first, *rest = public_api.public_api(terrain).splitlines(keepends=True)
  (terrain / "api.txt").write_text("".join(rest))
  assert f"  + {first.strip()}" in public_api.check(terrain)
  (terrain / "CHANGELOG.md").write_text("## [Unreleased]\n\n### Added\n\n- A name.\n\n## [0.1.0]\n\n- All.\n")
  assert public_api.check(terrain) == ""


def test_the_public_api_has_inherited_and_assigned_members(tmp_path: Path) -> None:
  package = tmp_path / "src/thing"
  package.mkdir(parents=True)
  (package / "__init__.py").write_text(
    "from thing.gains import Gains\n\n__all__ = ['Gains', 'Config']\nclass Config:\n  a: int\n"
  )
  (package / "gains.py").write_text(
    "from thing import Config\n"
    "class _Base(Config):\n  stiffness: float\n  damping: float\n  def check(self): ...\n"
    "class Gains(_Base):\n  damping: int = 1\n  find = len\n"
  )
  assert public_api.public_api(tmp_path).splitlines() == [
    "thing.Config",
    "thing.Config.a: int",
    "thing.Gains(_Base)",
    "thing.Gains.check(self)",
    "thing.Gains.damping: int = 1",
    "thing.Gains.find = len",
    "thing.Gains.stiffness: float",
  ]


@pytest.mark.parametrize(("must_raise", "expected"), [(False, ">=0.2,<0.4"), (True, ">=0.3,<0.4")])
def test_a_minor_release_moves_version_changelog_and_dependents(
  workspace: Path, must_raise: bool, expected: str
) -> None:
  core = workspace / "packages/core"
  project_file = core / "pyproject.toml"
  project_file.write_text(re.sub(r'^version = ".*"', 'version = "0.2.0"', project_file.read_text(), flags=re.MULTILINE))
  checked: list[str] = []
  version = release.release(workspace, "core", "minor", must_raise=must_raise, verify=checked.append, date="2030-01-02")
  assert (version, project(core)["version"], checked) == ("0.3.0", "0.3.0", ["core"])
  text = (core / "CHANGELOG.md").read_text()
  assert "## [Unreleased]\n\n## [0.3.0] - 2030-01-02\n\n### Added\n\n- A thing.\n" in text
  assert public_api.unreleased(core) == ""
  assert (core / "api.txt").read_text() == public_api.public_api(core)
  for member, folder in public_api.members(workspace).items():
    wanted = requirements(ROOT / folder.relative_to(workspace), "mjlab-core")
    assert requirements(folder, "mjlab-core") == [f"mjlab-core{expected}"] * len(wanted), member
    assert [r for r in project(folder)["dependencies"] if not r.startswith("mjlab-core")] == [
      r for r in project(ROOT / folder.relative_to(workspace))["dependencies"] if not r.startswith("mjlab-core")
    ]


def test_a_release_that_fails_leaves_every_file_as_it_was(workspace: Path) -> None:
  before = contents(workspace)

  def broken(member: str) -> None:
    (workspace / "uv.lock").write_text("new")
    raise release.ReleaseError("its tests failed")

  with pytest.raises(release.ReleaseError, match="its tests failed"):
    release.release(workspace, "core", "minor", verify=broken)
  assert contents(workspace) == before


def test_a_release_without_an_entry_or_of_a_stranger_is_refused(workspace: Path) -> None:
  (workspace / "packages/core/CHANGELOG.md").write_text("## [Unreleased]\n\n## [0.2.0]\n\n- All.\n")
  for member, message in (("core", "nothing below Unreleased"), ("cor", "no such member: cor. There are actuators")):
    with pytest.raises(release.ReleaseError, match=message):
      release.release(workspace, member, "minor", verify=lambda member: None)


@pytest.mark.parametrize(
  ("text", "version", "must_raise", "expected"),
  [
    (">=0.2,<0.3", (0, 2, 1), False, ">=0.2,<0.3"),
    (">=0.2,<0.3", (0, 2, 1), True, ">=0.2.1,<0.3"),
    (">=0.2,<0.3", (0, 9, 0), False, ">=0.2,<0.10"),
    (">=0.9,<0.10", (0, 10, 0), True, ">=0.10,<0.11"),
    (">=0.2,<0.3", (1, 0, 0), False, ">=0.2,<2"),
    (">=1.4,<2", (1, 5, 0), False, ">=1.4,<2"),
  ],
)
def test_ranges_are_widened_or_raised(
  text: str, version: tuple[int, int, int], must_raise: bool, expected: str
) -> None:
  assert release.new_range(text, version, must_raise=must_raise) == expected


def test_a_range_of_another_form_is_refused() -> None:
  with pytest.raises(release.ReleaseError, match="==0"):
    release.new_range("==0.1.0", (0, 2, 0), must_raise=False)


def test_the_script_refuses_an_unknown_member_in_one_line() -> None:
  command = [sys.executable, ROOT / "tools/release.py", "unknown", "minor"]
  done = subprocess.run(command, capture_output=True, text=True, check=False)
  assert done.returncode == 1
  assert done.stderr.startswith("error: no such member: unknown")
