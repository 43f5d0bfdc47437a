"""Tests of every member's wheel, installed alone: `uv run python tools/check_wheels.py [MEMBER ...]`.

Each member gets an empty environment with its wheel, what the wheel requires, pytest, and its `test` dependency group;
siblings come from this clone and only where they are required. Its tests must pass there, its module must come from the
wheel, and packages that it promises to work without must be absent.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
MEMBERS = {
  path.parent.name: path.parent
  for path in sorted([*ROOT.glob("packages/*/pyproject.toml"), *ROOT.glob("tasks/*/pyproject.toml")])
}
WARP = ("warp", "mujoco_warp")
# Modules that must not even be installed beside a member.
ABSENT = {
  "core": ("mujoco", "scipy", *WARP),
  "deploy": ("torch", "onnx", *WARP),
  "terrain": ("torch", *WARP),
  "dr": WARP,
  "actuators": WARP,
  "sysid": WARP,
  "managers": ("mujoco", *WARP),
  "motions": WARP,
  "rl": WARP,
}
# Size of all that a member installs, without compiled bytecode [bytes].
LARGEST = {"deploy": 200e6}
# Imports the module and everything in it that needs no argument, without looking at what else is installed.
PROBE = """
import importlib.util, sys
import {module}
assert "site-packages" in {module}.__file__, f"{module} was imported from {{{module}.__file__}}, not from its wheel"
for name in {module}.__all__:
  getattr({module}, name)
present = [name for name in {absent!r} if importlib.util.find_spec(name)]
assert not present, f"installed beside it, but it must work without: {{', '.join(present)}}"
"""


class CheckError(Exception):
  """One member did not pass; the message says which step, and what it printed."""


def module_of(member: str) -> str:
  return "mjlab" if member == "mjlab" else f"mjlab_{member}"


def call(step: str, command: list[str | Path], cwd: Path = ROOT, show: bool = False) -> None:
  """Run a command, quietly unless `show` or it fails. Raises CheckError."""
  environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
  output = None if show else subprocess.PIPE
  run = subprocess.run(
    [str(word) for word in command],
    cwd=cwd,
    env=environment,
    stdin=subprocess.DEVNULL,
    stdout=output,
    stderr=None if show else subprocess.STDOUT,
    text=True,
  )
  if run.returncode:
    raise CheckError(f"{step} failed with exit code {run.returncode}\n{run.stdout or ''}".rstrip())


def build(folder: Path) -> dict[str, Path]:
  """Build the wheels of all members; returns them by module, since any member may require any other."""
  call("building the wheels", ["uv", "build", "--quiet", "--all-packages", "--wheel", "--out-dir", folder])
  return {wheel.name.partition("-")[0]: wheel for wheel in folder.glob("*.whl")}


def check(member: str, wheels: dict[str, Path], folder: Path, with_tests: bool) -> None:
  """Install one member in a new environment below `folder` and test it there. Raises CheckError."""
  project = tomllib.loads((MEMBERS[member] / "pyproject.toml").read_text(encoding="utf-8"))
  module, environment = module_of(member), folder / member
  # A member is never taken from an index, where another project may own its name.
  constraints = folder / "constraints.txt"
  constraints.write_text("".join(f"{name.replace('_', '-')} @ {path.as_uri()}\n" for name, path in wheels.items()))
  python = environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
  install = ["uv", "pip", "install", "--quiet", "--python", python, "--constraint", constraints]

  call("making an environment", ["uv", "venv", "--quiet", "--python", sys.executable, environment])
  call("installing the wheel", [*install, project["project"]["name"]])
  probe = PROBE.format(module=module, absent=ABSENT.get(member, ()))
  call("importing it alone", [python, "-I", "-c", probe], cwd=folder)
  packages = [path for path in environment.rglob("site-packages/**/*") if path.is_file() and path.suffix != ".pyc"]
  size = sum(path.stat().st_size for path in packages)
  if size > LARGEST.get(member, float("inf")):
    raise CheckError(f"it installs {size / 1e6:.0f} MB, more than {LARGEST[member] / 1e6:.0f} MB")
  if with_tests:
    extra = project.get("dependency-groups", {}).get("test", [])
    call("installing what its tests need", [*install, "pytest", *extra])
    tests = MEMBERS[member] / "tests"
    # -P keeps the clone off the path; only what is installed can be imported.
    call("its tests", [python, "-P", "-m", "pytest", "--quiet", "--durations=0", "-p", "no:cacheprovider", tests])


def main() -> int:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("members", nargs="*", metavar="MEMBER", help=f"default: all ({', '.join(MEMBERS)})")
  parser.add_argument("--no-tests", action="store_true", help="only install and import")
  arguments = parser.parse_args()
  unknown = [member for member in arguments.members if member not in MEMBERS]
  if unknown:
    parser.error(f"no such member: {', '.join(unknown)}. There are {', '.join(MEMBERS)}")
  failed = []
  # Beside the clone's own environment, where uv can usually link files of its cache instead of copying gigabytes.
  cache = ROOT / ".cache"
  cache.mkdir(exist_ok=True)
  with tempfile.TemporaryDirectory(prefix="wheels-", dir=cache) as temporary:
    folder = Path(temporary)
    wheels = build(folder / "wheels")
    for member in arguments.members or MEMBERS:
      start = time.monotonic()
      try:
        check(member, wheels, folder, with_tests=not arguments.no_tests)
        verdict = "ok"
      except CheckError as failure:
        failed.append(member)
        verdict = f"FAILED: {failure}"
      print(f"{member:<12} {time.monotonic() - start:6.1f} s  {verdict}", flush=True)
      shutil.rmtree(folder / member, ignore_errors=True)
  if failed:
    print(f"failed: {', '.join(failed)}", flush=True)
  return 1 if failed else 0


if __name__ == "__main__":
  sys.exit(main())
