"""Run the quick tests with the oldest allowed third-party packages: `uv run python tools/check_oldest.py`.

Every package that a member requires directly is installed at the lowest version that its requirement allows, in an
environment of its own below `.cache`. The members come from this clone. Arguments go to pytest; without any, tests that
are slow or compile kernels are left out.
"""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

from public_api import ROOT, members

ENVIRONMENT = ROOT / ".cache" / "oldest"
# Old packages may use deprecated names of newer ones.
PYTEST = ["-m", "pytest", "--quiet", "-p", "no:cacheprovider", "-W", "ignore::DeprecationWarning"]
QUICK = ["-m", "not slow and not warp", "packages/core", "packages/managers", "packages/actuators", "packages/rl/tests"]
# Older versions of torch need more operations for the same call.
QUICK += ["-k", "not few_operations"]
QUICK += ["packages/mjlab/tests/test_mjlab_flags.py", "tests/test_all_flags.py", "tasks/cartpole"]


def requirements(root: Path = ROOT) -> list[str]:
  """Return the third-party requirements of all members, of their extras, and of their tests."""
  found = {"pytest>=9.0"}
  for folder in members(root).values():
    settings = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))
    project = settings["project"]
    groups = [
      project["dependencies"],
      *project.get("optional-dependencies", {}).values(),
      *settings.get("dependency-groups", {}).values(),
    ]
    found |= {entry for group in groups for entry in group if not entry.startswith("mjlab")}
  return sorted(found)


def call(*command: str | Path) -> None:
  subprocess.run([str(word) for word in command], cwd=ROOT, check=True)


def main() -> int:
  python = ENVIRONMENT / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
  call("uv", "venv", "--quiet", "--clear", "--python", sys.executable, ENVIRONMENT)
  listed = ENVIRONMENT / "requirements.txt"
  listed.write_text("".join(f"{entry}\n" for entry in requirements()), encoding="utf-8")
  install = ("uv", "pip", "install", "--quiet", "--python", python)
  call(*install, "--resolution", "lowest-direct", "-r", listed)
  call(*install, "--no-deps", *(word for folder in members().values() for word in ("-e", folder)))
  call("uv", "pip", "check", "--quiet", "--python", python)
  arguments = sys.argv[1:] or QUICK
  return subprocess.run([python, *PYTEST, *arguments], cwd=ROOT).returncode


if __name__ == "__main__":
  sys.exit(main())
