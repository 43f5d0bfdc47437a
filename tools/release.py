"""Release of one member: `uv run python tools/release.py MEMBER major|minor|patch`.

It bumps the member's version, dates the Unreleased section of its changelog, writes its public API to `api.txt`, widens
the ranges of members that require it, updates the lock, builds the wheel and checks it alone. With `--raise`, members
that require it need at least the new version. If a step fails, all files are put back. Commit and tag are left to you.
"""

import argparse
import datetime as dt
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

from public_api import ROOT, members, public_api, unreleased

Version = tuple[int, int, int]


class ReleaseError(Exception):
  """Release that cannot be made; the message says why."""


def bumped(version: Version, part: str) -> Version:
  """Return the next version of a part: "major", "minor" or "patch"."""
  major, minor, patch = version
  return {"major": (major + 1, 0, 0), "minor": (major, minor + 1, 0), "patch": (major, minor, patch + 1)}[part]


def limit(version: Version) -> str:
  """Return the first version that need not be compatible: before 1.0 the next minor one, then the next major one."""
  return f"{version[0] + 1}" if version[0] else f"0.{version[1] + 1}"


def lowest(version: Version) -> str:
  """Return a version as a lower bound, without a trailing zero."""
  return ".".join(map(str, version if version[2] else version[:2]))


def new_range(text: str, version: Version, *, must_raise: bool) -> str:
  """Return a range that accepts a new version: `>=0.2,<0.3` becomes `>=0.2,<0.4`, or `>=0.3,<0.4` if raised."""
  found = re.fullmatch(r">=([\d.]+),<([\d.]+)", text)
  if found is None:
    raise ReleaseError(f"range '{text}' is not of the form >=X.Y,<X.Z")
  upper = max(found[2], limit(version), key=_numbers)
  return f">={lowest(version) if must_raise else found[1]},<{upper}"


def _numbers(text: str) -> tuple[int, ...]:
  return tuple(int(part) for part in text.split("."))


def dated(changelog: str, version: str, date: str) -> str:
  """Return a changelog whose Unreleased section is that of a version, below a new empty one."""
  return changelog.replace("## [Unreleased]\n", f"## [Unreleased]\n\n## [{version}] - {date}\n", 1)


def release(
  root: Path,
  member: str,
  part: str,
  *,
  must_raise: bool = False,
  verify: Callable[[str], None],
  date: str | None = None,
) -> str:
  """Prepare a release below `root` and return the new version; put all files back if anything fails.

  Args:
    root: Folder of the workspace.
    member: Member to release.
    part: "major", "minor" or "patch".
    must_raise: Dependents require at least the new version.
    verify: Function of the member that updates the lock and checks the wheel; it raises ReleaseError.
    date: Day of the release; None: today.
  """
  folders = members(root)
  if member not in folders:
    raise ReleaseError(f"no such member: {member}. There are {', '.join(folders)}")
  folder = folders[member]
  if not unreleased(folder):
    raise ReleaseError(f"{folder.name}/CHANGELOG.md has nothing below Unreleased")
  project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
  major, minor, patch = _numbers(project["version"])
  version = bumped((major, minor, patch), part)
  text = ".".join(map(str, version))

  before: dict[Path, str] = {}

  def write(path: Path, content: str) -> None:
    before.setdefault(path, path.read_text(encoding="utf-8") if path.exists() else "")
    path.write_text(content, encoding="utf-8")

  try:
    if (root / "uv.lock").exists():
      write(root / "uv.lock", (root / "uv.lock").read_text(encoding="utf-8"))
    own = folder / "pyproject.toml"
    write(own, own.read_text(encoding="utf-8").replace(f'version = "{project["version"]}"', f'version = "{text}"', 1))
    changelog = folder / "CHANGELOG.md"
    today = date or dt.datetime.now(dt.UTC).date().isoformat()
    write(changelog, dated(changelog.read_text(encoding="utf-8"), text, today))
    write(folder / "api.txt", public_api(folder))
    requirement = re.compile(rf'"{re.escape(project["name"])}((?:\[[\w,-]*\])?)(>=[^"]*)"')
    for other in folders.values():
      path = other / "pyproject.toml"
      content = path.read_text(encoding="utf-8")
      widened = requirement.sub(
        lambda found: f'"{project["name"]}{found[1]}{new_range(found[2], version, must_raise=must_raise)}"', content
      )
      if widened != content:
        write(path, widened)
    verify(member)
  except BaseException:
    for path, content in before.items():
      path.write_text(content, encoding="utf-8")
    raise
  return text


def verify(member: str) -> None:
  """Update the lock, build the wheel of a member and test it alone. Raises ReleaseError."""
  for command in (["uv", "lock", "--quiet"], [sys.executable, "tools/check_wheels.py", member]):
    if subprocess.run(command, cwd=ROOT).returncode:
      raise ReleaseError(f"{' '.join(command)} failed; all files are as before")


def main() -> int:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("member", metavar="MEMBER", help=", ".join(members()))
  parser.add_argument("part", choices=("major", "minor", "patch"))
  parser.add_argument("--raise", dest="must_raise", action="store_true", help="dependents require the new version")
  arguments = parser.parse_args()
  try:
    version = release(ROOT, arguments.member, arguments.part, must_raise=arguments.must_raise, verify=verify)
  except ReleaseError as error:
    print(f"error: {error}", file=sys.stderr)
    return 1
  name = "mjlab" if arguments.member == "mjlab" else f"mjlab-{arguments.member}"
  print(f'{name} {version} is ready: git commit -am "Release {name} {version}" && git tag {name}-{version}')
  return 0


if __name__ == "__main__":
  sys.exit(main())
