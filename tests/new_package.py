"""Installation of packages from offline wheels into a folder."""

import os
import shutil
import subprocess
import sys
from pathlib import Path


def install(*packages: Path, into: Path) -> None:
  """Build the wheels of packages without network and install them into a folder, without their requirements."""
  uv = os.environ.get("UV") or shutil.which("uv")
  assert uv, "these tests build packages with uv"
  wheels = into.parent / f"{into.name}_wheels"
  for package in packages:
    subprocess.run([uv, "build", "--offline", "--quiet", "--wheel", "--out-dir", wheels, package], check=True)
  options = ["--offline", "--no-deps", "--quiet", "--python", sys.executable, "--target", str(into)]
  subprocess.run([uv, "pip", "install", *options, *map(str, sorted(wheels.glob("*.whl")))], check=True)


def run_tests(*packages: Path, installed: Path) -> None:
  """Run the tests of packages in a separate process, without the settings of this repository."""
  command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull]
  done = subprocess.run(
    [*command, *(str(package.resolve() / "tests") for package in packages)],
    env={**os.environ, "PYTHONPATH": str(installed)},
    cwd=installed,
    capture_output=True,
    text=True,
    check=False,
  )
  assert done.returncode == 0, done.stdout + done.stderr
